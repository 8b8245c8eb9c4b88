"""The scan: a few hundred points of a depth image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera


def scan_from_depth(
    depth_m: NDArray[np.float32],
    camera: Camera,
    count: int,
    rng: np.random.Generator,
    max_depth_m: float = 8.0,
    edge_ratio: float = 1.15,
) -> NDArray[np.float32]:
    """Points in the camera's frame, spread evenly over the usable pixels.

    Pixels on depth edges are left out: interpolation across an occlusion makes points in mid-air.

    Args:
        depth_m: (h, w) float32, 0 where there is none.
        camera: its intrinsics.
        count: number of points; all usable pixels if there are fewer.
        max_depth_m: farther pixels are left out.
        edge_ratio: a pixel is on an edge when a neighbour's depth differs by more than this ratio.

    Returns:
        (P, 3) float32 metres, P <= count; P = 0 when no pixel is usable.
    """
    usable = (depth_m > 0.0) & (depth_m <= max_depth_m) & ~depth_edges(depth_m, edge_ratio)
    candidates = np.flatnonzero(usable)
    if len(candidates) > count:
        # One from each of `count` runs of neighbouring pixels: even over the image, different every frame.
        bounds = np.linspace(0.0, len(candidates), count + 1)
        candidates = candidates[(bounds[:-1] + rng.uniform(size=count) * np.diff(bounds)).astype(np.int64)]
    rows, columns = np.divmod(candidates, depth_m.shape[1])
    rays = camera.rays(np.stack([columns, rows], axis=1))
    return np.asarray(rays * depth_m.ravel()[candidates, None], dtype=np.float32)


def depth_edges(depth_m: NDArray[np.float32], ratio: float) -> NDArray[np.bool_]:
    """Pixels with a 4-neighbour nearer or farther by more than a ratio: (h, w) -> (h, w).

    Pixels without depth (0) make no edge.
    """
    with np.errstate(divide="ignore"):
        log_depth = np.where(depth_m > 0.0, np.log(depth_m), np.nan)
    threshold = np.log(ratio)
    edges = np.zeros(depth_m.shape, dtype=np.bool_)
    along_x = np.abs(np.diff(log_depth, axis=1)) > threshold
    along_y = np.abs(np.diff(log_depth, axis=0)) > threshold
    edges[:, 1:] |= along_x
    edges[:, :-1] |= along_x
    edges[1:] |= along_y
    edges[:-1] |= along_y
    return edges
