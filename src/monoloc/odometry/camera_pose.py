"""Pose of a camera that sees corners of known places, of which some are wrong.

Sources: Fischler & Bolles 1981 (RANSAC); Lepetit et al. 2009 (EPnP).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

import monoloc._core as _core
from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, make_pose, so3_exp, transform
from monoloc.odometry.odometry_config import OdometryConfig

_PRIOR_INFORMATION = 1e-6 * np.eye(6)  # against a singular matrix alone
# Pixels at which a corner's weight is a quarter, step by step: in a fit by all corners, and in one by those that
# agree, which count alike.
_ALL_PX, _AGREEING_PX = np.array([6.0, 3.0, 3.0, 3.0]), np.full(4, 1e3)
_NEAREST_M = 0.05  # depth of a corner, at least
# Neighbouring corners have similar errors, for one because their depth has: a pose counts as one of so many
# independent corners. In 1651 steps of ten rooms, 12 fit single steps best.
_INDEPENDENT_CORNERS = 25


def solve_pose(
    points: FloatArray, pixels: NDArray[np.float32], camera: Camera, config: OdometryConfig
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]] | None:
    """Pose of a camera that sees points (N, 3) of frame r at pixels (N, 2); None where too few agree.

    Returns:
        ``T_r_camera``, (4, 4); the covariance of its twist in the camera's frame, (6, 6), by the residuals; and
        indices of the points that agree, (n,).
    """
    if len(points) < config.min_inliers:
        return None
    seen, K, distortion = camera.for_pnp(pixels)
    ok, rotation, translation, inliers = cv2.solvePnPRansac(
        points,
        seen,
        K,
        distortion,
        iterationsCount=100,
        reprojectionError=config.reprojection_px,
        confidence=0.999,
        flags=cv2.SOLVEPNP_EPNP,
    )
    if not ok or inliers is None:
        return None
    chosen = inliers.ravel().astype(np.int64)
    T_r_camera = invert(make_pose(so3_exp(rotation.ravel()), translation.ravel()))
    is_fisheye = camera.distortion_model == "fisheye"
    if is_fisheye:
        # Where depth errs, EPnP's pose is at times one with which few corners agree.
        T_r_camera = _fit(points, pixels, camera, T_r_camera, _ALL_PX)
        chosen = _agreeing(points, pixels, camera, T_r_camera, config.reprojection_px)
    if len(chosen) < max(config.min_inliers, config.min_inlier_share * len(points)):
        return None
    if is_fisheye:
        T_r_camera = _fit(points[chosen], pixels[chosen], camera, T_r_camera, _AGREEING_PX)
    else:
        refined = cv2.solvePnPRefineLM(points[chosen], seen[chosen], K, distortion, rotation, translation)
        T_r_camera = invert(make_pose(so3_exp(refined[0].ravel()), refined[1].ravel()))
    if not np.all(np.isfinite(T_r_camera)):
        return None
    return T_r_camera, _covariance(points[chosen], pixels[chosen], camera, T_r_camera), chosen


# OpenCV's solvers know no fisheye, so they take its corners at z = 1, where a pixel at the edge spans several times
# as much as one at the centre. What follows compares pixels.


def _agreeing(
    points: FloatArray, pixels: NDArray[np.float32], camera: Camera, T_r_camera: FloatArray, most_px: float
) -> NDArray[np.int64]:
    """Indices of the points that a camera sees within so many pixels of where they were found."""
    local = transform(invert(T_r_camera), points)
    ahead = np.flatnonzero(camera.in_sight(local))
    error_px = np.linalg.norm(camera.project(local[ahead]) - pixels[ahead], axis=1)
    return np.asarray(ahead[error_px < most_px], dtype=np.int64)


def _fit(
    points: FloatArray, pixels: NDArray[np.float32], camera: Camera, start: FloatArray, kernel_px: FloatArray
) -> FloatArray:
    """The pose ``T_r_camera`` (4, 4) at which points (N, 3) are seen nearest to where they were found.

    Args:
        kernel_px: (S,) of each step, errors at which a point's weight is a quarter.
    """
    rays = camera.rays(pixels)[:, :2]
    fit = _core.fit_pose(points, rays, camera.ray_spread(rays), start, _PRIOR_INFORMATION, kernel_px, _NEAREST_M)
    return fit[0]


def _covariance(
    points: FloatArray, pixels: NDArray[np.float32], camera: Camera, T_r_camera: FloatArray
) -> FloatArray:
    """Covariance (6, 6) of a pose that was fitted to points (N, 3) and pixels (N, 2), whose errors are correlated.

    Its shape is that of the view: in front of a flat surface, a turn and a sideways step look alike.
    """
    rays = camera.rays(pixels)[:, :2]
    spread = camera.ray_spread(rays)
    _, information, _, _ = _core.fit_pose(
        points, rays, spread, T_r_camera, _PRIOR_INFORMATION, _AGREEING_PX[:1], _NEAREST_M
    )
    variance_px = np.mean((camera.project(transform(invert(T_r_camera), points)) - pixels) ** 2)
    shared = max(1.0, len(points) / _INDEPENDENT_CORNERS)
    return np.asarray(shared * variance_px * np.linalg.inv(information), dtype=np.float64)
