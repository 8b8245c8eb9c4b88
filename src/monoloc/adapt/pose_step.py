"""Effect of depth errors on the pose: the step by which a scan moves the camera away from its true pose.

A depth image whose errors resemble a camera motion biases the pose, however small the error of each pixel is. Errors
that do not resemble a motion hardly matter. To first order the step is linear in the errors, so a loss can penalise
it at the cost of one matrix product per view.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.geometry import FloatArray

_DEPTH_SD = 0.08  # of log-depth: typical error of a small network after tuning
_SURFACE_SD_M = 0.03  # across a surface, in a map of a few hundred components
_INDEPENDENT = 30.0  # effective points per image: errors within an image are correlated
_PRIOR_SD = 0.1  # of the pose without the scan, m and rad
_DEPTH_JUMP = 0.2  # of log-depth, between a pixel's two neighbours; a larger one separates two surfaces
_LEAST_COSINE = 0.15  # between ray and normal
_MOST_ERROR = 0.3  # of log-depth; as in the filter, a larger error has no larger effect
_ROUNDING = 1e-6  # m^2, under the root: a norm has no gradient at zero


def pose_steps(depth_m: NDArray[np.float32], rays: FloatArray, prior_sd: float = _PRIOR_SD) -> Tensor:
    """Matrices that map a view's log-depth errors to a camera step: (V, h, w), (h, w, 3) -> (V, 6, h * w).

    Let a surface with normal n be seen at x. A camera motion (v, w) changes the log-depth along a ray fixed in the
    camera by ``-(n . v + (x cross n) . w) / (n . x)``. The step is one Gauss-Newton step: least squares over the
    pixels, weighted by the inverse variance of depth and map surface. As odometry does, a prior constrains the
    directions that the image leaves free.

    Args:
        depth_m: (V, h, w) true depth, metres, 0 where there is none.
        rays: (h, w, 3) directions of the pixels with z = 1, camera frame.
        prior_sd: standard deviation of the pose without the scan, m and rad.

    Returns:
        Rows are a twist in the camera's frame, metres and radians. Columns of unusable pixels are zero.
    """
    return torch.from_numpy(np.stack([_pose_step(depth, rays, prior_sd).astype(np.float32) for depth in depth_m]))


def _pose_step(depth_m: NDArray[np.float32], rays: FloatArray, prior_sd: float) -> FloatArray:
    points = rays * depth_m[..., None].astype(np.float64)
    normals = np.zeros_like(points)
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    normals[1:-1, 1:-1] = np.cross(across, down)
    length, distance = np.linalg.norm(normals, axis=-1), np.linalg.norm(points, axis=-1)
    towards = np.einsum("ijk,ijk->ij", normals, points)
    cosine = np.abs(towards) / np.maximum(length * distance, 1e-12)
    usable = _is_one_surface(depth_m) & (cosine > _LEAST_COSINE)
    step = np.zeros((6, depth_m.size))
    chosen = np.flatnonzero(usable)
    if len(chosen) == 0:
        return step
    n, x = normals.reshape(-1, 3)[chosen], points.reshape(-1, 3)[chosen]
    jacobian = -np.hstack([n, np.cross(x, n)]) / towards.ravel()[chosen, None]
    along_m = distance.ravel()[chosen] * cosine.ravel()[chosen]
    weight = _INDEPENDENT / len(chosen) / (_DEPTH_SD**2 + (_SURFACE_SD_M / along_m) ** 2)
    weighted = jacobian * weight[:, None]
    step[:, chosen] = np.linalg.solve(jacobian.T @ weighted + prior_sd**-2.0 * np.eye(6), weighted.T)
    return step


def _is_one_surface(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mask (h, w) of pixels whose four neighbours have depth and lie on the same surface."""
    known = depth_m > 0.0
    log_depth = np.log(np.where(known, depth_m, 1.0))
    inner = known.copy()
    inner[[0, -1]] = inner[:, [0, -1]] = False
    for axis in (0, 1):
        before, after = np.roll(known, 1, axis), np.roll(known, -1, axis)
        jump = np.abs(np.roll(log_depth, 1, axis) - np.roll(log_depth, -1, axis))
        inner &= before & after & (jump < _DEPTH_JUMP)
    return inner


def pose_twists(log_depth: Tensor, depth_m: Tensor, steps: Tensor) -> Tensor:
    """Camera steps that a prediction's errors would cause, (B, 6) twists in the camera's frame.

    Args:
        log_depth: (B, 1, h, w) predicted log-depth.
        depth_m: (B, 1, h, w) true depth, metres, 0 where there is none.
        steps: (B, 6, h * w) from :func:`pose_steps` for the same depth.
    """
    error = torch.where(depth_m > 0.0, log_depth - depth_m.clamp(min=1e-3).log(), 0.0)
    return (steps @ error.clamp(-_MOST_ERROR, _MOST_ERROR).flatten(1)[..., None])[..., 0]


def pose_step_loss(log_depth: Tensor, depth_m: Tensor, steps: Tensor) -> Tensor:
    """Mean norm of :func:`pose_twists`; one radian counts as one metre."""
    twists = pose_twists(log_depth, depth_m, steps)
    return (twists.square().sum(1) + _ROUNDING).sqrt().mean()
