"""NumPy twin of the bundle adjustment: readable reference implementation for tests.

Gauss-Newton, with the points eliminated by the Schur complement. Tests check that ``monoloc._core`` gives the same
results.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, hat, invert, se3_exp

_HUBER = 2.0  # standard deviations beyond which the loss of a residual is linear
_DAMPING = 1e-4  # relative to the diagonal; only against rounding, as the priors make the problem well posed


def adjust_window(
    poses: FloatArray,
    points: FloatArray,
    rays: FloatArray,
    log_depth: FloatArray,
    ray_sd: float,
    log_depth_sd: float,
    iterations: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As :func:`monoloc.odometry.window.adjust`, of the arrays of a window."""
    count, frames = len(points), len(poses)
    of_corners = np.zeros((count, 3, 3))
    for _ in range(iterations):
        J_pose, J_point, residual = linearise(poses, points, rays, log_depth, ray_sd, log_depth_sd)
        # Matrix products, because einsum would not use them for these sums.
        by_corner = J_point[:, :, :2].reshape(count, 2 * frames, 3)
        of_corners = by_corner.swapaxes(1, 2) @ by_corner
        by_point = J_point.reshape(count, 3 * frames, 3).swapaxes(1, 2)
        information = by_point @ by_point.swapaxes(1, 2)
        damped = information * (1.0 + _DAMPING * np.eye(3)) + 1e-9 * np.eye(3)
        gradient_point = (by_point @ residual.reshape(count, 3 * frames, 1))[..., 0]
        by_pose = J_pose.transpose(1, 3, 0, 2).reshape(frames, 6, 3 * count)
        H_pose = by_pose @ by_pose.swapaxes(1, 2)
        gradient_pose = (by_pose @ residual.swapaxes(0, 1).reshape(frames, 3 * count, 1)).reshape(-1)
        products = [J_pose[..., r, :, None] * J_point[..., r, None, :] for r in range(3)]
        cross = (products[0] + products[1] + products[2]).reshape(count, 6 * frames, 3)
        inverse = np.linalg.inv(damped)
        reduced = cross @ inverse  # (N, 6W, 3)
        H = np.zeros((6 * frames, 6 * frames))
        for frame in range(frames):
            block = slice(6 * frame, 6 * frame + 6)
            H[block, block] = H_pose[frame] * (1.0 + _DAMPING * np.eye(6))
        H -= np.tensordot(reduced, cross, axes=([0, 2], [0, 2]))
        right = gradient_pose - np.tensordot(reduced, gradient_point, axes=([0, 2], [0, 1]))
        step = np.zeros(6 * frames)
        step[6:] = -np.linalg.solve(H[6:, 6:] + 1e-6 * np.eye(6 * frames - 6), right[6:])
        point_step = -np.einsum("nij,nj->ni", inverse, gradient_point + np.tensordot(cross, step, axes=(1, 0)))
        poses = poses @ se3_exp(step.reshape(frames, 6))
        points = points + point_step
    return poses, points, of_corners


def linearise(
    poses: FloatArray, points: FloatArray, rays: FloatArray, log_depth: FloatArray, ray_sd: float, log_depth_sd: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened Jacobians with respect to pose twists (N, W, 3, 6) and points (N, W, 3, 3), residuals (N, W, 3)."""
    T_camera_r = invert(poses)
    R = T_camera_r[:, :3, :3]
    local = np.einsum("wij,nj->nwi", R, points) + T_camera_r[:, :3, 3]
    z = np.maximum(local[..., 2], 0.05)
    image = local[..., :2] / z[..., None]
    ray_residual = (image - rays) / ray_sd
    depth_residual = (np.log(z) - log_depth) / log_depth_sd
    residual = np.concatenate([ray_residual, depth_residual[..., None]], axis=-1)
    J_local = np.zeros((*z.shape, 3, 3))
    J_local[..., 0, 0] = J_local[..., 1, 1] = 1.0 / z / ray_sd
    J_local[..., :2, 2] = -image / z[..., None] / ray_sd
    J_local[..., 2, 2] = 1.0 / z / log_depth_sd
    weight = _weights(residual)
    J_local *= weight[..., None]
    residual = np.where(weight > 0.0, residual * weight, 0.0)
    # After right multiplication of the pose by exp(rho, phi), the point is at x - rho + x cross phi in the camera.
    J_pose = np.concatenate([-J_local, J_local @ hat(local)], axis=-1)
    J_point = J_local @ R
    return J_pose, J_point, residual


def _weights(residual: FloatArray) -> NDArray[np.float64]:
    """Square roots of Huber's weights, (N, W, 3); 0 for missing observations."""
    observed = np.isfinite(residual)
    clean = np.where(observed, residual, 0.0)
    norm = np.linalg.norm(clean[..., :2], axis=-1, keepdims=True)
    weight = np.ones(residual.shape)
    weight[..., :2] = np.sqrt(_HUBER / np.maximum(norm, _HUBER))
    weight[..., 2:] = np.sqrt(_HUBER / np.maximum(np.abs(clean[..., 2:]), _HUBER))
    return np.where(observed, weight, 0.0)
