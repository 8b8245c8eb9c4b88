"""Triangulation of landmarks: corners that several frames saw in the same place."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.geometry import FloatArray, invert, ray_jacobian, transform
from monoloc.io.recording import Recording
from monoloc.landmarks.features import KeypointDetector, Keypoints, match_descriptors
from monoloc.landmarks.landmark_map import Landmarks

_RADIUS_PX = 6.0  # matching radius around the projection of a landmark lifted in another frame
DEPTH_SD = 0.01
"""Relative standard deviation of a sensor's depth."""

_HUBER, _STEPS = 2.0, 5
_NEAREST_M, _LEAST_INFORMATION = 1e-3, 1e-6  # for a point behind a camera; for a point on a single ray
_AGREE_SD = 2.5  # standard deviations; half of a landmark's corners must lie within them
_PER_FRAME = (400, 300, 250, 200, 150, 100)  # landmarks that a frame should have; the first that gives few enough
_MOST_LANDMARKS = 7500  # 330 kB


@dataclass(frozen=True)
class Corners:
    """Keypoints of one frame and their depth, (N,) metres, 0 where there is none."""

    keypoints: Keypoints
    depth_m: FloatArray


def corners_of(
    recording: Recording,
    frames: NDArray[np.int64],
    detect: KeypointDetector,
    depth_of: Callable[[int], NDArray[np.float32]],
) -> Iterator[Corners]:
    """Corners of some frames, one frame after the other.

    Args:
        detect: for the recording's camera.
        depth_of: returns a frame's depth, (H, W) metres, 0 where there is none.
    """
    for index in frames.tolist():
        keypoints = detect(recording.color(index))
        pixels = keypoints.pixels.astype(np.float32)
        yield Corners(keypoints, sample_depth(pixels, detect.camera, depth_of(index), recording.camera))


def landmarks_of(corners: list[Corners], camera: Camera, poses: FloatArray, depth_sd: float = DEPTH_SD) -> Landmarks:
    """Map the landmarks of frames of one camera: corners that at least two frames saw.

    Args:
        corners: corners of each frame.
        camera: intrinsics of the images in which corners were detected.
        poses: (N, 4, 4) ``T_world_camera`` of the frames.
        depth_sd: relative standard deviation of the corners' depth.
    """
    seen = _gathered(corners, camera, poses)
    points, is_one_place = _placed(seen, poses, depth_sd)
    chosen = _chosen(seen, is_one_place, len(corners))
    return Landmarks(points[chosen].astype(np.float32), _descriptors(seen, chosen))


@dataclass(frozen=True)
class _Observations:
    """L candidate landmarks, and O corners matched to them.

    Attributes:
        points: (L, 3) initial positions, lifted from one frame, world frame, metres.
        landmark, frame: (O,) landmark and frame index of each corner.
        rays: (O, 2) normalised image coordinates.
        sd: (O, 2) standard deviations of the rays.
        depth_m: (O,) metres, 0 where there is none.
        descriptors: (O, 32).
    """

    points: FloatArray
    landmark: NDArray[np.int64]
    frame: NDArray[np.int64]
    rays: FloatArray
    sd: FloatArray
    depth_m: FloatArray
    descriptors: NDArray[np.uint8]


def _gathered(corners: list[Corners], camera: Camera, poses: FloatArray) -> _Observations:
    """Match corners to known landmarks frame by frame; unmatched corners with depth start new landmarks."""
    points, known = np.zeros((0, 3)), np.zeros((0, 32), np.uint8)
    rows = []
    for index, (each, pose) in enumerate(zip(corners, poses, strict=True)):
        keypoints = each.keypoints
        local = transform(invert(pose), points)
        visible = np.flatnonzero(camera.in_sight(local))
        expected = camera.project(local[visible])
        which, again = match_descriptors(
            expected, known[visible], keypoints.pixels, keypoints.descriptors, _RADIUS_PX
        )
        fresh = np.setdiff1d(np.flatnonzero(each.depth_m > 0.0), again)
        corner = np.concatenate([again, fresh])
        landmark = np.concatenate([visible[which], len(points) + np.arange(len(fresh))])
        rays, sd = keypoints.rays(camera)
        columns = (rays, sd, each.depth_m, keypoints.descriptors)
        rows.append((landmark, np.full(len(corner), index), *(column[corner] for column in columns)))
        lifted = np.column_stack([rays[fresh], np.ones(len(fresh))]) * each.depth_m[fresh, None]
        points = np.concatenate([points, transform(pose, lifted)])
        known = np.concatenate([known, keypoints.descriptors[fresh]])
    return _Observations(points, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def _placed(seen: _Observations, poses: FloatArray, depth_sd: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Robust maximum-likelihood positions of landmarks, (L, 3), and whether half of their corners agree, (L,).

    Gauss-Newton on the rays of a landmark's corners and the logarithm of their depth, with Huber weights.
    """
    T_camera_world = invert(poses)[seen.frame]
    R_camera_world = T_camera_world[:, :3, :3]
    has_depth = seen.depth_m > 0.0
    log_depth = np.log(np.where(has_depth, seen.depth_m, 1.0))
    scale = np.column_stack([1.0 / seen.sd, has_depth / depth_sd])
    points = seen.points.copy()
    for _ in range(_STEPS):
        local = np.einsum("oij,oj->oi", R_camera_world, points[seen.landmark]) + T_camera_world[:, :3, 3]
        local[:, 2] = np.maximum(local[:, 2], _NEAREST_M)
        z = local[:, 2]
        offset = np.concatenate([local[:, :2] / z[:, None] - seen.rays, (np.log(z) - log_depth)[:, None]], axis=1)
        jacobian = np.zeros((len(z), 3, 3))
        jacobian[:, :2], jacobian[:, 2, 2] = ray_jacobian(local), 1.0 / z
        residuals, jacobian = scale * offset, scale[..., None] * jacobian @ R_camera_world
        weights = np.minimum(1.0, _HUBER / np.maximum(np.abs(residuals), _HUBER))
        normal, gradient = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(normal, seen.landmark, np.einsum("oij,oi,oik->ojk", jacobian, weights, jacobian))
        np.add.at(gradient, seen.landmark, np.einsum("oij,oi->oj", jacobian, weights * residuals))
        points -= np.linalg.solve(normal + _LEAST_INFORMATION * np.eye(3), gradient[..., None])[..., 0]
    agree = np.bincount(seen.landmark, np.linalg.norm(residuals[:, :2], axis=1) < _AGREE_SD, len(points))
    return points, agree >= 0.5 * np.bincount(seen.landmark, minlength=len(points))


def _chosen(seen: _Observations, is_one_place: NDArray[np.bool_], frames: int) -> NDArray[np.int64]:
    """Indices of the landmarks that most frames saw, at least two, until each frame has enough.

    More landmarks give more exact poses; the largest rooms get fewer a frame, so that the map stays small.
    """
    counts = np.bincount(seen.landmark, minlength=len(is_one_place))
    order = np.argsort(seen.landmark, kind="stable")
    saw = np.split(seen.frame[order], np.cumsum(counts)[:-1])
    candidates = np.flatnonzero(is_one_place & (counts >= 2))
    by_count = candidates[np.argsort(-counts[candidates], kind="stable")].tolist()
    for per_frame in _PER_FRAME:
        has = np.zeros(frames, dtype=np.int64)
        chosen = []
        for index in by_count:
            if np.any(has[saw[index]] < per_frame):
                has[saw[index]] += 1
                chosen.append(index)
        if len(chosen) <= _MOST_LANDMARKS:
            break
    return np.array(sorted(chosen), dtype=np.int64)


def _descriptors(seen: _Observations, chosen: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Descriptors of C landmarks, (C, 32): the bitwise majority of their corners' descriptors."""
    number = np.full(len(seen.points), -1)
    number[chosen] = np.arange(len(chosen))
    row = number[seen.landmark]
    votes = np.zeros((len(chosen), 256), dtype=np.int32)
    bits = np.unpackbits(seen.descriptors[row >= 0], axis=1).astype(np.int8)
    np.add.at(votes, row[row >= 0], 2 * bits - 1)
    return np.packbits(votes >= 0, axis=1)
