"""Sampling of depth images; values at depth discontinuities belong to neither surface and are avoided."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.camera import Camera

_EDGE = 0.15  # of the depth: next to a larger jump, a corner's depth is ambiguous


def at_discontinuity(depth_m: ArrayLike, relative: float) -> NDArray[np.bool_]:
    """Mark pixels at depth discontinuities: (H, W) metres, 0 where there is no depth -> (H, W) bool.

    Args:
        depth_m: (H, W) metres, 0 where there is none.
        relative: two 4-neighbours form a discontinuity if their depths differ by more than this share of the nearer
            depth. Pixels without depth form none.
    """
    depth = np.asarray(depth_m)
    marked = np.zeros(depth.shape, dtype=np.bool_)
    for axis in (0, 1):
        a, b = (depth[:-1], depth[1:]) if axis == 0 else (depth[:, :-1], depth[:, 1:])
        jump = (np.abs(a - b) > relative * np.minimum(a, b)) & (a > 0.0) & (b > 0.0)
        if axis == 0:
            marked[:-1] |= jump
            marked[1:] |= jump
        else:
            marked[:, :-1] |= jump
            marked[:, 1:] |= jump
    return marked


def sample_depth(
    pixels: NDArray[np.float32],
    camera: Camera,
    depth_m: NDArray[np.float32],
    depth_camera: Camera,
    relative: float = _EDGE,
) -> NDArray[np.float64]:
    """Interpolate depth at pixels of an image from a depth image of the same pose and any intrinsics.

    Args:
        pixels: (N, 2) pixel coordinates in ``camera``'s image.
        camera: intrinsics of that image.
        depth_m: (H, W) metres, 0 where there is none.
        depth_camera: intrinsics of the depth image.
        relative: a pixel gets no depth if its four depth neighbours differ by more than this share of the nearest.

    Returns:
        (N,) metres; 0 where a neighbour has no depth, at depth edges, and where the depth image does not show the
        pixel. Pixels outside the image take the depth of the nearest border.
    """
    border = np.array([camera.width - 0.5, camera.height - 0.5], dtype=np.float32)
    xy = _in_depth_image(np.clip(pixels, np.float32(-0.5), border), camera, depth_camera)
    last = np.array([depth_camera.width - 1, depth_camera.height - 1])
    is_shown = np.all((xy > -1.0) & (xy < last + 1.0), axis=1)
    xy = np.clip(xy, 0.0, last)
    x0 = np.minimum(xy[:, 0].astype(np.int64), depth_camera.width - 2)
    y0 = np.minimum(xy[:, 1].astype(np.int64), depth_camera.height - 2)
    fx, fy = xy[:, 0] - x0, xy[:, 1] - y0
    corners = np.stack([depth_m[y0, x0], depth_m[y0, x0 + 1], depth_m[y0 + 1, x0], depth_m[y0 + 1, x0 + 1]], axis=1)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    depth = np.sum(weights * corners, axis=1)
    nearest, farthest = corners.min(axis=1), corners.max(axis=1)
    usable = is_shown & (nearest > 0.0) & (farthest <= (1.0 + relative) * nearest)
    return np.asarray(np.where(usable, depth, 0.0), dtype=np.float64)


def where_known(depth_m: NDArray[np.float32], depth_camera: Camera, camera: Camera) -> NDArray[np.bool_]:
    """Where a camera's image (H, W) has depth, as far as a depth image (h, w) of the same field of view shows it."""
    shape = camera.height, camera.width
    if depth_m.all() or not _is_resized(camera, depth_camera):
        return np.ones(shape, dtype=np.bool_)
    known = (depth_m > 0.0).astype(np.uint8)
    return np.asarray(cv2.resize(known, shape[::-1], interpolation=cv2.INTER_NEAREST) > 0)


def _in_depth_image(pixels: NDArray[np.float32], camera: Camera, depth_camera: Camera) -> NDArray[np.float64]:
    """Pixels (N, 2) of an image, as those of a depth image; infinite where it does not show them."""
    if _is_resized(camera, depth_camera):
        scale = np.array([depth_camera.width / camera.width, depth_camera.height / camera.height])
        return np.asarray((pixels + 0.5) * scale - 0.5)
    rays = camera.rays(pixels)
    return np.where(depth_camera.in_sight(rays)[:, None], depth_camera.project(rays), np.inf)


@lru_cache(8)  # the two cameras of a flight are compared several times a frame
def _is_resized(camera: Camera, other: Camera) -> bool:
    """Whether another camera is that of the same image at another size, or every n-th pixel of it."""
    at_its_size = camera.resized(other.width, other.height)
    lens, other_lens = ((each.distortion_model, each.distortion) for each in (camera, other))
    return lens == other_lens and np.allclose(at_its_size.matrix, other.matrix, rtol=0.0, atol=0.5)
