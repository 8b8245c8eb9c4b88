"""Images of the calibration board as a known camera sees it."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board import COLUMNS, ROWS, Board
from monoloc.camera import Camera
from monoloc.geometry import FloatArray, make_pose, so3_exp

_SUPERSAMPLE = 2
_MARGIN_SQUARES = 1.0  # of white paper around the pattern


@cache
def _print(square_px: int) -> NDArray[np.uint8]:
    margin = round(_MARGIN_SQUARES * square_px)
    size = (COLUMNS * square_px + 2 * margin, ROWS * square_px + 2 * margin)
    return np.asarray(Board().charuco.generateImage(size, marginSize=margin, borderBits=1))


@cache
def _fine_rays(camera: Camera) -> NDArray[np.float32]:
    """Rays of the supersampled image, (3, N); between pixels they are linear to within 1e-3 pixels."""
    size = (_SUPERSAMPLE * camera.width, _SUPERSAMPLE * camera.height)
    rays = np.asarray(cv2.resize(camera.pixel_rays(), size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    return np.ascontiguousarray(rays.reshape(-1, 3).T)


def board_image(
    camera: Camera, board: Board, T_camera_board: FloatArray, rng: np.random.Generator, blur_px: float = 0.7
) -> NDArray[np.uint8]:
    """Grey image (H, W) of the printed board before a grey wall, with blur and noise, by inverse mapping."""
    # A ray is a multiple of H (x, y, 1) for the point (x, y) where it meets the board's plane.
    H = np.column_stack([T_camera_board[:3, :2], T_camera_board[:3, 3]])
    x, y, scale = np.linalg.inv(H).astype(np.float32) @ _fine_rays(camera)
    square_px = 64
    px_per_m = square_px / (board.square_mm / 1000.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = (
            np.where(scale > 0.0, axis / scale * px_per_m + (_MARGIN_SQUARES * square_px - 0.5), -1e6).astype(
                np.float32
            )
            for axis in (x, y)
        )
    shape = (_SUPERSAMPLE * camera.height, _SUPERSAMPLE * camera.width)
    image = cv2.remap(_print(square_px), u.reshape(shape), v.reshape(shape), cv2.INTER_LINEAR, borderValue=(110.0,))
    image = cv2.GaussianBlur(
        cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA), (0, 0), blur_px
    )
    noisy = 20.0 + 0.8 * image + rng.normal(scale=2.0, size=image.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def board_poses(
    camera: Camera, board: Board, count: int, rng: np.random.Generator, tilt_deg: float = 35.0
) -> FloatArray:
    """``T_camera_board`` (count, 4, 4) of views all over the image.

    The board faces the camera, tilted from that by up to ``tilt_deg``; without a tilt, it is parallel to the image.
    """
    width_m, height_m = (length / 1000.0 for length in board.size_mm)
    middle = make_pose(np.eye(3), np.array([-width_m / 2.0, -height_m / 2.0, 0.0]))
    poses = []
    for index in range(count):
        # Places on a grid that covers the image, in turn.
        column, row = index % 4, index // 4 % 3
        place = np.array([(column + 0.5) / 4.0, (row + 0.5) / 3.0]) + rng.uniform(-0.08, 0.08, 2)
        ray = camera.rays(place * [camera.width, camera.height])
        direction = ray / np.linalg.norm(ray)
        share = rng.uniform(0.25, 0.5)  # of the image's width that the board takes near the axis
        distance_m = width_m * camera.focal_px / (share * camera.width)
        axis = np.append(rng.normal(size=2), 0.0)
        tilt = so3_exp(np.deg2rad(rng.uniform(0.4, 1.0) * tilt_deg) * axis / np.linalg.norm(axis))
        roll = so3_exp([0.0, 0.0, rng.uniform(-0.5, 0.5)])
        poses.append(
            make_pose((_facing(direction) @ tilt if tilt_deg else np.eye(3)) @ roll, distance_m * direction) @ middle
        )
    return np.stack(poses)


def _facing(direction: FloatArray) -> FloatArray:
    """The rotation that turns z to a direction by the shortest way."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine = float(np.linalg.norm(axis))
    return np.eye(3) if sine < 1e-9 else so3_exp(axis / sine * np.arctan2(sine, direction[2]))
