"""The scan: a few hundred points of a depth image, or corners whose depth parallax has refined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.depth_image import at_discontinuity
from monoloc.depth.predictor import DepthPrediction
from monoloc.odometry.motion import Motion

_LEAST_WEIGHT, _MOST_WEIGHT = 0.25, 4.0  # so that no point dominates and none is wasted
# Farther points are not used: outliers of the ray likelihood have depths of 0.15 m to 8 m.
_MAX_DEPTH_M = 8.0
_ENOUGH_CORNERS = 80  # their errors are correlated: they count as twenty by default


@dataclass(frozen=True)
class Scan:
    """Points to compare with the map.

    Attributes:
        points: (P, 3) float32, camera's frame, metres.
        weights: (P,) float32, positive, 1 on average.
    """

    points: NDArray[np.float32]
    weights: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)


def scan_from_depth(
    depth: DepthPrediction,
    count: int,
    rng: np.random.Generator,
    error_power: float = 0.0,
    max_depth_m: float = _MAX_DEPTH_M,
    depth_jump: float = 0.15,
) -> Scan:
    """A scan of points spread evenly over the usable pixels.

    Pixels at depth discontinuities are left out: interpolation across an occlusion makes points in mid-air.

    Args:
        depth: of one frame.
        count: number of points; all usable pixels if there are fewer.
        error_power: a point's weight is the inverse of the error that the network states, to this power.
        max_depth_m: farther pixels are left out.
        depth_jump: pixels beside a larger relative jump of depth are left out.

    Returns:
        P <= count points; P = 0 when no pixel is usable.
    """
    depth_m, camera = depth.depth_m, depth.camera
    usable = (depth_m > 0.0) & (depth_m <= max_depth_m) & ~at_discontinuity(depth_m, depth_jump)
    candidates = np.flatnonzero(usable)
    if len(candidates) > count:
        # One from each of `count` runs of neighbouring pixels: even over the image, different every frame.
        bounds = np.linspace(0.0, len(candidates), count + 1)
        candidates = candidates[(bounds[:-1] + rng.uniform(size=count) * np.diff(bounds)).astype(np.int64)]
    rays = camera.pixel_rays().reshape(-1, 3)[candidates]
    points = np.asarray(rays * depth_m.ravel()[candidates, None], dtype=np.float32)
    if depth.log_error is None or error_power == 0.0 or len(points) == 0:
        return uniform_scan(points)
    return Scan(points, _weights(depth.log_error.ravel()[candidates], error_power))


def scan_from_corners(motion: Motion, max_log_depth_sd: float) -> Scan:
    """Tracked corners in front of the camera whose log-depth has a standard deviation below ``max_log_depth_sd``.

    Up to 8 m away, and every n-th of them if there are many, so that 60 to 120 remain.
    """
    z = motion.points[:, 2]
    chosen = np.flatnonzero((motion.log_depth_sd < max_log_depth_sd) & (z > 0.0) & (z <= _MAX_DEPTH_M))
    chosen = chosen[:: max(1, round(len(chosen) / _ENOUGH_CORNERS))]
    return uniform_scan(np.asarray(motion.points[chosen], dtype=np.float32))


def uniform_scan(points: NDArray[np.float32]) -> Scan:
    """A scan of points (P, 3) with equal weights."""
    return Scan(points, np.ones(len(points), dtype=np.float32))


EMPTY_SCAN = uniform_scan(np.zeros((0, 3), dtype=np.float32))


def _weights(log_error: NDArray[np.float32], power: float) -> NDArray[np.float32]:
    weights = np.exp(-power * (log_error - np.median(log_error)))
    weights = np.clip(weights, _LEAST_WEIGHT, _MOST_WEIGHT)
    return np.asarray(weights / weights.mean(), dtype=np.float32)
