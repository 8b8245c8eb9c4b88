"""Views of a room that nobody took: colour and depth of posed frames, moved forward to another pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth_image import at_discontinuity
from monoloc.geometry import FloatArray, invert, transform

_FINE = 2  # points are drawn at this many times the view's size and averaged down
_DEPTH_JUMP = 0.1  # pixels beside a larger one lie on neither surface and are left behind
_LEAST_DEPTH_M = 0.1


@dataclass(frozen=True)
class ColoredPoints:
    """What one frame saw: (N, 3) float64 points in the world and their colours, (N, 3) uint8 RGB."""

    points: FloatArray
    colors: NDArray[np.uint8]


def points_of(
    color: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, T_world_camera: FloatArray
) -> ColoredPoints:
    """The pixels of a frame that have depth, as points.

    Args:
        color: (H, W, 3) uint8 RGB.
        depth_m: (H, W), 0 where there is none.
        camera: of both.
        T_world_camera: (4, 4).
    """
    usable = (depth_m > 0.0) & ~at_discontinuity(depth_m, _DEPTH_JUMP)
    points = camera.pixel_rays()[usable] * depth_m[usable, None]
    return ColoredPoints(transform(T_world_camera, points), color[usable])


def forward_warp(
    sources: Sequence[ColoredPoints], T_world_camera: FloatArray, camera: Camera
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """What a camera at another pose would see of them; the nearest point wins in every pixel.

    Args:
        sources: at least one.
        T_world_camera: (4, 4) of the view.
        camera: of the view.

    Returns:
        Colour (h, w, 3) uint8, with holes painted from their borders, and depth (h, w) float32 metres, 0 in holes.
    """
    fine = camera.resized(camera.width * _FINE, camera.height * _FINE)
    points = transform(invert(T_world_camera), np.concatenate([source.points for source in sources]))
    colors = np.concatenate([source.colors for source in sources])
    ahead = points[:, 2] > _LEAST_DEPTH_M
    points, colors = points[ahead], colors[ahead]
    # Far points first: of those that fall on one pixel, the one drawn last is the nearest.
    order = np.argsort(-points[:, 2])
    points, colors = points[order], colors[order]
    corner = np.floor(fine.project(points)).astype(np.int64)
    nearest = np.full((fine.height, fine.width), np.inf, dtype=np.float32)
    image = np.zeros((fine.height, fine.width, 3), dtype=np.uint8)
    for offset in ((0, 0), (0, 1), (1, 0), (1, 1)):
        # A point covers the four pixels about it, so that surfaces that come closer do not fall apart.
        u, v = corner[:, 0] + offset[0], corner[:, 1] + offset[1]
        inside = (u >= 0) & (u < fine.width) & (v >= 0) & (v < fine.height)
        u, v = u[inside], v[inside]
        drawn = np.full_like(nearest, np.inf)
        paint = np.zeros_like(image)
        drawn[v, u] = points[inside, 2]
        paint[v, u] = colors[inside]
        closer = drawn < nearest
        nearest[closer], image[closer] = drawn[closer], paint[closer]
    return _averaged(image, nearest, camera)


def _averaged(
    image: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """A fine view, depth infinite in holes, at the camera's size; holes in colour painted over."""
    grid = depth_m.reshape(camera.height, _FINE, camera.width, _FINE).transpose(0, 2, 1, 3)
    blocks = grid.reshape(camera.height, camera.width, -1)
    nearest = blocks.min(axis=2)
    depth = np.where(np.isfinite(nearest), _mean_near(blocks, nearest), 0.0).astype(np.float32)
    size = (camera.width, camera.height)
    known = np.isfinite(depth_m).astype(np.float32)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(image * known[..., None], size, interpolation=cv2.INTER_AREA)
    color = np.asarray(total / np.maximum(share, 1e-6)[..., None] + 0.5, dtype=np.uint8)
    holes = (share == 0.0).astype(np.uint8)
    return np.asarray(cv2.inpaint(color, holes, 2.0, cv2.INPAINT_NS), dtype=np.uint8), depth


def _mean_near(blocks: NDArray[np.float32], nearest: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean of what lies on the nearest surface of every block, (h, w, n) -> (h, w): the minimum would be too near."""
    on_surface = blocks <= (1.0 + _DEPTH_JUMP / 2.0) * nearest[..., None]
    total = np.where(on_surface & np.isfinite(blocks), blocks, 0.0).sum(axis=2)
    return np.asarray(total / np.maximum(1, (on_surface & np.isfinite(blocks)).sum(axis=2)))
