"""Reading depth images where they can be trusted: between surfaces they hold neither."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.camera import Camera


def at_discontinuity(depth_m: ArrayLike, relative: float) -> NDArray[np.bool_]:
    """Pixels beside a jump in depth: (H, W) m, 0 where there is none -> (H, W).

    Args:
        relative: a 4-neighbour this much farther, as a share of the nearer depth, makes a jump. Pixels without
            depth make none.
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
    relative: float,
) -> NDArray[np.float64]:
    """Depth at pixels of one image of a camera, from a depth image of another size of the same camera.

    Args:
        pixels: (N, 2) in ``camera``'s image.
        relative: a pixel whose four depth neighbours differ by more than this share of the nearest gets none.

    Returns:
        (N,) metres, outside those of the nearest border; 0 where a neighbour has no depth, and on depth edges.
    """
    scale = np.array([depth_camera.width / camera.width, depth_camera.height / camera.height])
    xy = (pixels + 0.5) * scale - 0.5
    xy = np.clip(xy, 0.0, np.array([depth_camera.width - 1, depth_camera.height - 1]))
    x0 = np.minimum(xy[:, 0].astype(np.int64), depth_camera.width - 2)
    y0 = np.minimum(xy[:, 1].astype(np.int64), depth_camera.height - 2)
    fx, fy = xy[:, 0] - x0, xy[:, 1] - y0
    corners = np.stack([depth_m[y0, x0], depth_m[y0, x0 + 1], depth_m[y0 + 1, x0], depth_m[y0 + 1, x0 + 1]], axis=1)
    weights = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=1)
    depth = np.sum(weights * corners, axis=1)
    nearest, farthest = corners.min(axis=1), corners.max(axis=1)
    usable = (nearest > 0.0) & (farthest <= (1.0 + relative) * nearest)
    return np.asarray(np.where(usable, depth, 0.0), dtype=np.float64)
