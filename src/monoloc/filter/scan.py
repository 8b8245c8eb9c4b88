"""The scan: a few hundred points of a depth image, and the corners that parallax has measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth_image import at_discontinuity
from monoloc.odometry import Motion


def scan_from_depth(
    depth_m: NDArray[np.float32],
    camera: Camera,
    count: int,
    rng: np.random.Generator,
    max_depth_m: float = 8.0,
    depth_jump: float = 0.15,
) -> NDArray[np.float32]:
    """Points in the camera's frame, spread evenly over the usable pixels.

    Pixels on depth edges are left out: interpolation across an occlusion makes points in mid-air.

    Args:
        depth_m: (h, w) float32, 0 where there is none.
        camera: its intrinsics.
        count: number of points; all usable pixels if there are fewer.
        max_depth_m: farther pixels are left out.
        depth_jump: pixels beside a relative jump above this are left out.

    Returns:
        (P, 3) float32 metres, P <= count; P = 0 when no pixel is usable.
    """
    usable = (depth_m > 0.0) & (depth_m <= max_depth_m) & ~at_discontinuity(depth_m, depth_jump)
    candidates = np.flatnonzero(usable)
    if len(candidates) > count:
        # One from each of `count` runs of neighbouring pixels: even over the image, different every frame.
        bounds = np.linspace(0.0, len(candidates), count + 1)
        candidates = candidates[(bounds[:-1] + rng.uniform(size=count) * np.diff(bounds)).astype(np.int64)]
    rows, columns = np.divmod(candidates, depth_m.shape[1])
    rays = camera.rays(np.stack([columns, rows], axis=1))
    return np.asarray(rays * depth_m.ravel()[candidates, None], dtype=np.float32)


def scan_from_corners(motion: Motion, log_depth_sd: float, max_depth_m: float = 8.0) -> NDArray[np.float32]:
    """Tracked corners whose depth is known better than ``log_depth_sd``: (P, 3) float32, camera's frame."""
    chosen = (motion.log_depth_sd < log_depth_sd) & (motion.points[:, 2] <= max_depth_m)
    return np.asarray(motion.points[chosen], dtype=np.float32)
