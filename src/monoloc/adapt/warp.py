"""View synthesis: forward warping of colour and depth from posed frames to another pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import cv2
import numpy as np
from numpy.typing import NDArray

import monoloc._core as _core
from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.geometry import FloatArray, invert, transform

_FINE = 2  # supersampling factor: points are drawn at this multiple of the view's size, then averaged
_DEPTH_JUMP = 0.1  # relative; pixels next to a larger jump lie on neither surface and are dropped
_SAME_SURFACE = 0.05  # relative; points at most this much farther than the nearest lie on the same surface


@dataclass(frozen=True)
class ColoredPoints:
    """Points seen in one frame: positions, (N, 3) float64, world frame, metres; colours, (N, 3) uint8 RGB."""

    points: FloatArray
    colors: NDArray[np.uint8]


def points_of(
    color: NDArray[np.uint8], depth_m: NDArray[np.float32], rays: FloatArray, T_world_camera: FloatArray
) -> ColoredPoints:
    """Back-project the pixels of a frame that have depth.

    Args:
        color: (H, W, 3) uint8 RGB.
        depth_m: (H, W) metres, 0 where there is none.
        rays: (H, W, 3) ray directions of the pixels with z = 1, camera frame.
        T_world_camera: (4, 4).
    """
    usable = (depth_m > 0.0) & ~at_discontinuity(depth_m, _DEPTH_JUMP)
    points = rays[usable] * depth_m[usable, None]
    return ColoredPoints(transform(T_world_camera, points), color[usable])


def forward_warp(
    sources: Sequence[ColoredPoints], T_world_camera: FloatArray, camera: Camera
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Render the view of a camera at another pose; each pixel shows the nearest surface.

    A pixel takes the colour of the nearest point and the mean depth of all points on the surface. The minimum depth
    is biased towards the camera, because every point has sensor noise and its frame's pose error: by 0.6 % in a real
    room.

    Args:
        sources: points of at least one frame.
        T_world_camera: pose of the view, (4, 4).
        camera: intrinsics of the view.

    Returns:
        Colour (h, w, 3) uint8 RGB, with holes inpainted from their borders, and depth (h, w) float32 metres, 0 in
        holes.
    """
    fine = camera.resized(camera.width * _FINE, camera.height * _FINE)
    lens, sight = lens_array(fine), np.array(fine.sight)
    points = np.concatenate([source.points for source in sources])
    colors = np.concatenate([*(source.colors for source in sources), np.zeros((1, 3), dtype=np.uint8)])
    front = np.empty((fine.height, fine.width), dtype=np.uint32)
    depth_m = np.empty((fine.height, fine.width), dtype=np.float32)
    is_fisheye = camera.distortion_model == "fisheye"
    # A point covers four pixels, so that surfaces stay closed when the camera moves closer to them.
    _core.draw_points(points, invert(T_world_camera), lens, is_fisheye, sight, _SAME_SURFACE, front, depth_m)
    image = np.take(colors, np.minimum(front, len(points)), axis=0)
    return _averaged(image, depth_m, camera)


def lens_array(camera: Camera) -> FloatArray:
    """Focal lengths, principal point and coefficients as the kernel takes them, (12,): 0 for those a model lacks."""
    lens = np.zeros(12)
    values = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    lens[: len(values)] = values
    return lens


def _averaged(
    image: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Downsample a supersampled view, depth 0 in holes, to the camera's size; inpaint holes in the colour."""
    size = (camera.width, camera.height)
    known = (depth_m > 0.0).astype(np.float32)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(image * known[..., None], size, interpolation=cv2.INTER_AREA)
    color = np.asarray(total / np.maximum(share, 1e-6)[..., None] + 0.5, dtype=np.uint8)
    holes = (share == 0.0).astype(np.uint8)
    return np.asarray(cv2.inpaint(color, holes, 2.0, cv2.INPAINT_NS), dtype=np.uint8), halved(depth_m)


def halved(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Downsample depth by two, (2 h, 2 w) -> (h, w), metres, 0 where there is none.

    Of each four pixels, take the mean of those on the nearest surface; their minimum is biased towards the camera.
    """
    depth_m = np.where(depth_m > 0.0, depth_m, np.float32(np.inf))
    corners = [depth_m[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    farthest = (1.0 + _SAME_SURFACE) * reduce(np.minimum, corners)
    total, count = np.zeros(farthest.shape, dtype=np.float32), np.zeros(farthest.shape, dtype=np.float32)
    for corner in corners:
        on_surface = np.isfinite(corner) & (corner <= farthest)
        total += np.where(on_surface, corner, np.float32(0.0))
        count += on_surface
    return np.asarray(total / np.maximum(count, np.float32(1.0)), dtype=np.float32)
