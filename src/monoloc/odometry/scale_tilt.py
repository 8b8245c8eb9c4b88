"""Depth levelled on corners: what parallax says of its scale and tilt, before it becomes a scan.

Seen from a new place, a room's depth comes out of a small network tilted: too near on one side, too far on the other,
over whole stretches of a flight. A tilt reads as a turn and a step aside, and no map tells them apart; corners that
were followed over a baseline do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray
from monoloc.odometry.visual import Motion

_HUBER = 1.5  # standard deviations beyond which a corner counts linearly
_ITERATIONS = 4
_FEWEST = 10  # corners; fewer say nothing
_DEPTH_JUMP = 0.15  # share of the depth; where the image jumps by more, it says nothing of a corner there


class LevelConfig(BaseModel):
    """What is believed of a depth image's scale and tilt, and of the corners that show them.

    Attributes:
        scale_sd: standard deviation of the log-scale beyond the filter's own, which is slow.
        tilt_sd: standard deviation of the change of log-depth over a unit of image coordinate (at z = 1).
        corner_sd: standard deviation of the difference of log-depth between corner and image, beyond what the corner
            states.
        corner_doubt: corners whose stated standard deviation is above this are left out.
        effective_corners: as how many independent ones they count: their errors go together.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scale_sd: float = Field(0.02, gt=0.0)
    tilt_sd: float = Field(0.02, gt=0.0)
    corner_sd: float = Field(0.05, gt=0.0)
    corner_doubt: float = Field(0.15, gt=0.0)
    effective_corners: float = Field(20.0, gt=0.0)


def level(depth: DepthPrediction, motion: Motion, config: LevelConfig) -> DepthPrediction:
    """Depth times ``exp(a + b x + c y)``, with image coordinates x, y at z = 1, as refined corners demand.

    The most likely a, b, c under Huber's loss and the priors of the settings; depth as it is for too few corners.

    Args:
        depth: (h, w) of the frame.
        motion: whose corners are in the same frame and, but for an error of scale, in the same units.
    """
    camera = depth.camera
    known = (motion.log_depth_sd < config.corner_doubt) & (motion.points[:, 2] > 0.1)
    points, sd = motion.points[known], motion.log_depth_sd[known]
    pixels = camera.project(points).astype(np.float32)
    nearest = np.rint(pixels)
    inside = np.all((nearest >= 0) & (nearest < (camera.width, camera.height)), axis=1)
    points, sd, pixels = points[inside], sd[inside], pixels[inside]
    if len(points) < _FEWEST:
        return depth
    predicted = sample_depth(pixels, camera, depth.depth_m, camera, _DEPTH_JUMP)
    usable = predicted > 0.0
    if usable.sum() < _FEWEST:
        return depth
    difference = np.log(points[usable, 2] / predicted[usable])
    ground = np.column_stack([np.ones(usable.sum()), points[usable, :2] / points[usable, 2:]])
    a, b, c = _fit(ground, difference, np.hypot(sd[usable], config.corner_sd), config)
    rays = camera.pixel_rays()
    factor = np.exp(a + b * rays[..., 0] + c * rays[..., 1]).astype(np.float32)
    return replace(depth, depth_m=depth.depth_m * factor)


def _fit(ground: FloatArray, difference: FloatArray, sd: FloatArray, config: LevelConfig) -> FloatArray:
    """Iteratively reweighted least squares with a Gaussian prior about zero; (N, 3), (N,), (N,) -> (3,)."""
    prior = np.diag(1.0 / np.square([config.scale_sd, config.tilt_sd, config.tilt_sd]))
    share = min(1.0, config.effective_corners / len(difference))
    plane: FloatArray = np.zeros(3)
    for _ in range(_ITERATIONS):
        off = np.abs(difference - ground @ plane) / sd
        weight = share / sd**2 * np.minimum(1.0, _HUBER / np.maximum(off, 1e-9))
        weighted = ground * weight[:, None]
        plane = np.asarray(np.linalg.solve(weighted.T @ ground + prior, weighted.T @ difference), np.float64)
    return plane
