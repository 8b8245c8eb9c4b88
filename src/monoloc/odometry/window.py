"""Bundle adjustment of the last few keyframes, which combines parallax with predicted depth.

Gauss-Newton, with the points eliminated by the Schur complement (Triggs et al., *Bundle Adjustment - A Modern
Synthesis*, 2000). Each observation has three residuals: two of the corner's position, and one of the logarithm of its
predicted depth. The depth residual determines the scale and the depth of corners without parallax. The position
residuals determine the shape once there is a baseline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, hat, invert, se3_exp

_HUBER = 2.0  # standard deviations beyond which the loss of a residual is linear
_DAMPING = 1e-4  # relative to the diagonal; only against rounding, as the priors make the problem well posed


@dataclass(frozen=True)
class Window:
    """W keyframes that observe N corners, in an arbitrary common frame r.

    Attributes:
        poses: ``T_r_camera``, (W, 4, 4); the first is fixed.
        points: (N, 3) corners in r.
        rays: (N, W, 2) observed image coordinates at z = 1 of each corner in each keyframe; NaN if not observed.
        log_depth: (N, W) logarithm of predicted depth at these observations; NaN if unknown.
    """

    poses: FloatArray
    points: FloatArray
    rays: FloatArray
    log_depth: FloatArray

    @classmethod
    def empty(cls) -> Window:
        return cls(np.zeros((0, 4, 4)), np.zeros((0, 3)), np.zeros((0, 0, 2)), np.zeros((0, 0)))

    def select(self, chosen: NDArray[Any]) -> Window:
        """The window restricted to some corners."""
        return Window(self.poses, self.points[chosen], self.rays[chosen], self.log_depth[chosen])

    def with_keyframe(
        self, T_r_camera: FloatArray, new_points: FloatArray, rays: FloatArray, log_depth: FloatArray, most: int
    ) -> Window:
        """Add a keyframe that observes all N corners and M new ones, and drop the oldest keyframes.

        Args:
            T_r_camera: pose of the keyframe, (4, 4).
            new_points: (M, 3) new corners in r, which no other keyframe observes.
            rays, log_depth: (N + M, 2) and (N + M,) observations in the keyframe.
            most: maximum number of keyframes, at least 1.
        """
        poses = np.concatenate([self.poses, T_r_camera[None]])[-most:]
        previous, known = len(poses) - 1, len(self.points)
        all_rays = np.full((len(rays), previous + 1, 2), np.nan)
        all_log_depth = np.full((len(rays), previous + 1), np.nan)
        if previous:
            all_rays[:known, :previous] = self.rays[:, -previous:]
            all_log_depth[:known, :previous] = self.log_depth[:, -previous:]
        all_rays[:, previous], all_log_depth[:, previous] = rays, log_depth
        return Window(poses, np.concatenate([self.points, new_points]), all_rays, all_log_depth)


def adjust(
    window: Window, ray_sd: float, log_depth_sd: float, iterations: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Find the poses and points that maximise the likelihood of the window's observations.

    Args:
        window: observations and initial values.
        ray_sd: standard deviation of a corner's image coordinates at z = 1 (pixels over focal length).
        log_depth_sd: standard deviation of predicted log-depth.
        iterations: number of Gauss-Newton steps.

    Returns:
        Poses (W, 4, 4), points (N, 3), and the information (inverse covariance) (N, 3, 3) of each point from its
        observed positions, given the poses. The information excludes predicted depth, because its error is the same
        in all keyframes.
    """
    poses, points = window.poses.copy(), window.points.copy()
    count, frames = len(points), len(poses)
    of_corners = np.zeros((count, 3, 3))
    for _ in range(iterations):
        J_pose, J_point, residual = _linearise(window, poses, points, ray_sd, log_depth_sd)
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


def _linearise(
    window: Window, poses: FloatArray, points: FloatArray, ray_sd: float, log_depth_sd: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened Jacobians with respect to pose twists (N, W, 3, 6) and points (N, W, 3, 3), residuals (N, W, 3)."""
    T_camera_r = invert(poses)
    R = T_camera_r[:, :3, :3]
    local = np.einsum("wij,nj->nwi", R, points) + T_camera_r[:, :3, 3]
    z = np.maximum(local[..., 2], 0.05)
    image = local[..., :2] / z[..., None]
    ray_residual = (image - window.rays) / ray_sd
    depth_residual = (np.log(z) - window.log_depth) / log_depth_sd
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
