"""Correction of a depth image's scale and tilt by corners whose depth parallax has refined.

From where a small network has seen no view, its depth is tilted: too near on one side and too far on the other, over
long segments of a flight. A tilt looks like a rotation and a sideways step, and no map can tell these apart. Corners
tracked over a baseline can.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray
from monoloc.odometry.motion import Motion

_HUBER = 1.5  # standard deviations beyond which a corner counts linearly
_ITERATIONS = 4
_LEAST_CORNERS = 10


class ScaleTiltConfig(BaseModel):
    """Priors on a depth image's scale and tilt, and the noise of the corners that measure them.

    Attributes:
        scale_sd: standard deviation of the log-scale from frame to frame; the filter estimates its slow part.
        tilt_sd: standard deviation of the change of log-depth over a unit of image coordinate (at z = 1).
        corner_sd: standard deviation of the difference of log-depth between corner and image, in addition to the
            corner's own.
        max_corner_log_depth_sd: corners whose stated standard deviation is above this are left out.
        effective_corners: number of independent corners that they count as, since their errors are correlated.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scale_sd: float = Field(0.02, gt=0.0, le=10.0)
    tilt_sd: float = Field(0.02, gt=0.0, le=10.0)
    corner_sd: float = Field(0.05, gt=0.0, le=10.0)
    max_corner_log_depth_sd: float = Field(0.15, gt=0.0, le=10.0)
    effective_corners: float = Field(20.0, gt=0.0, le=1e6)


def correct_scale_and_tilt(depth: DepthPrediction, motion: Motion, config: ScaleTiltConfig) -> DepthPrediction:
    """Depth times ``exp(a + b x + c y)``, with normalised image coordinates x, y, fitted to refined corners.

    a, b, c are the maximum a posteriori under Huber's loss and the priors of the settings; with too few corners the
    depth is returned as it is.

    Args:
        depth: (h, w) of the frame.
        motion: its corners are in the same camera frame and, up to an error of scale, in the same units.
    """
    camera = depth.camera
    known = (motion.log_depth_sd < config.max_corner_log_depth_sd) & (motion.points[:, 2] > 0.1)
    points, sd = motion.points[known], motion.log_depth_sd[known]
    pixels = camera.project(points).astype(np.float32)
    nearest = np.rint(pixels)
    inside = np.all((nearest >= 0) & (nearest < (camera.width, camera.height)), axis=1)
    points, sd, pixels = points[inside], sd[inside], pixels[inside]
    if len(points) < _LEAST_CORNERS:
        return depth
    predicted = sample_depth(pixels, camera, depth.depth_m, camera)
    usable = predicted > 0.0
    if usable.sum() < _LEAST_CORNERS:
        return depth
    difference = np.log(points[usable, 2] / predicted[usable])
    design = np.column_stack([np.ones(usable.sum()), points[usable, :2] / points[usable, 2:]])
    a, b, c = _fit(design, difference, np.hypot(sd[usable], config.corner_sd), config)
    rays = camera.pixel_rays()
    factor = np.exp(a + b * rays[..., 0] + c * rays[..., 1]).astype(np.float32)
    return replace(depth, depth_m=depth.depth_m * factor)


def _fit(design: FloatArray, difference: FloatArray, sd: FloatArray, config: ScaleTiltConfig) -> FloatArray:
    """Iteratively reweighted least squares with a Gaussian prior about zero; (N, 3), (N,), (N,) -> (3,)."""
    prior = np.diag(1.0 / np.square([config.scale_sd, config.tilt_sd, config.tilt_sd]))
    share = min(1.0, config.effective_corners / len(difference))
    plane: FloatArray = np.zeros(3)
    for _ in range(_ITERATIONS):
        off = np.abs(difference - design @ plane) / sd
        weight = share / sd**2 * np.minimum(1.0, _HUBER / np.maximum(off, 1e-9))
        weighted = design * weight[:, None]
        plane = np.asarray(np.linalg.solve(weighted.T @ design + prior, weighted.T @ difference), np.float64)
    return plane
