"""What errors of depth do to a pose: the step that a scan would make the camera take from where it truly stands.

Held against the map, a depth image whose errors happen to look like a motion of the camera moves the pose, however
small they are at each pixel; errors that do not look like one hardly matter. To first order the step is linear in the
errors, so it can be learned against: one product of matrices a view.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.geometry import FloatArray

_DEPTH_SD = 0.08  # of log-depth, as small networks err once they are tuned
_SURFACE_SD_M = 0.03  # across a surface: what a map of a few hundred components knows of it
_INDEPENDENT = 30.0  # points that an image is worth, for its errors go together
_PRIOR_SD = 0.1  # of what is known of a pose without the scan, m and rad
_DEPTH_JUMP = 0.2  # of log-depth from one pixel to the next but one; beyond it there are two surfaces
_LEAST_COSINE = 0.15  # between ray and normal
_MOST_ERROR = 0.3  # of log-depth; more of it moves a pose no farther, as in the filter
_ROUNDING = 1e-6  # m^2: a length has no gradient at zero


def pose_steps(depth_m: NDArray[np.float32], rays: FloatArray, prior_sd: float = _PRIOR_SD) -> Tensor:
    """Matrices that take a view's errors of log-depth to the camera's step: (V, h, w), (h, w, 3) -> (V, 6, h * w).

    Where a surface with normal n is seen at x, a motion (v, w) of the camera changes the logarithm of the depth along
    a ray that stands still by ``-(n . v + (x cross n) . w) / (n . x)``. The step is the Gauss-Newton one: least
    squares over the pixels, weighted by what depth and surfaces may err by, with a prior that holds what an image
    does not tell, as odometry does.

    Args:
        depth_m: true depth, 0 where there is none.
        rays: of its pixels, camera frame, with z = 1.
        prior_sd: how far a pose may be off that the scan does not tell, m and rad.

    Returns:
        Rows are a twist in the camera's frame, metres and radians; columns of pixels that tell nothing are zero.
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
    """Pixels whose four neighbours are known and on the same surface, (h, w)."""
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
    """The steps that a prediction's errors would cause, (B, 6) twists in the camera's frame.

    Args:
        log_depth: (B, 1, h, w) predicted.
        depth_m: (B, 1, h, w) true depth, 0 where there is none.
        steps: (B, 6, h * w), of :func:`pose_steps` for the same depth.
    """
    error = torch.where(depth_m > 0.0, log_depth - depth_m.clamp(min=1e-3).log(), 0.0)
    return (steps @ error.clamp(-_MOST_ERROR, _MOST_ERROR).flatten(1)[..., None])[..., 0]


def pose_step_loss(log_depth: Tensor, depth_m: Tensor, steps: Tensor) -> Tensor:
    """Mean length of :func:`pose_twists`, a radian counted as a metre."""
    twists = pose_twists(log_depth, depth_m, steps)
    return (twists.square().sum(1) + _ROUNDING).sqrt().mean()
