"""Pose of a camera from the landmarks that it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import (
    FloatArray,
    hat,
    invert,
    ray_jacobian,
    se3_exp,
    se3_log,
    transform,
)
from monoloc.landmarks.features import Keypoints

PRIOR_COVARIANCE = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2
"""Covariance of a prior pose, (6, 6), where no belief states one."""

LEAST_LANDMARKS = 15
"""Number of landmarks that determine a pose."""

_KERNEL_SDS = (24.0, 12.0, 6.0, 3.0, 3.0, 3.0)  # standard deviations at which a landmark's weight is a quarter
_LEAST_VARIANCE = 1e-8  # of a prior, m^2 and rad^2: a start may be stated as exact
_UNOBSERVABLE_SD = 0.3  # m or rad: a direction that landmarks constrain no better is not determined
_NEAREST_M = 0.05  # depth of a landmark
# Narrower: the pose is known, but for what the focal length does to it.
_FOCAL_KERNEL_SDS = (12.0, 6.0, 3.0, 3.0, 3.0)
_SHIFT_SD_M, _TURN_SD_RAD, _FOCAL_SD = 0.5, 0.1, 0.2  # of what a wrong focal length does to a pose, and of its log
_AGREE_WEIGHT = 0.25  # of a landmark that agrees
_NO_INDICES, _NO_FLAGS = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)


@dataclass(frozen=True)
class LandmarkPose:
    """Pose of a camera from landmarks.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of its twist (rho, phi) in the camera's frame, from the corners' localisation error alone.
        points: (M, 3) of the landmarks that agree with it, world frame, metres.
        log_focal: logarithm of true over stated focal length under which the landmarks fit best; 0 where they tell
            nothing of it.
        log_focal_sd: its standard deviation, by the corners' localisation error alone.
    """

    pose: FloatArray
    covariance: FloatArray
    points: FloatArray
    log_focal: float = 0.0
    log_focal_sd: float = math.inf


@dataclass(frozen=True)
class LandmarkMeasurement:
    """What an image shows of the landmarks that should be in view.

    Attributes:
        expected: number of landmarks in view of a camera at the prior.
        found: number of these that agree with one pose near the prior.
        pose: that pose; None where too few agree, or where they leave a direction undetermined.
        visible: (E,) int64, indices in the room's landmarks of those in view; empty where it is not known which of
            them were found.
        is_found: (E,) bool, whether each of these agrees.
    """

    expected: int = 0
    found: int = 0
    pose: LandmarkPose | None = None
    visible: NDArray[np.int64] = field(default_factory=lambda: _NO_INDICES)
    is_found: NDArray[np.bool_] = field(default_factory=lambda: _NO_FLAGS)


class LandmarkLocalizer(Protocol):
    """Measures poses by landmarks; :class:`monoloc.landmarks.orb_localizer.OrbLandmarkLocalizer` is one."""

    def measure(self, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """Landmarks in an image (H, W, 3) uint8 RGB, near a prior.

        Args:
            prior: ``T_world_camera``, (4, 4), and its covariance, (6, 6).

        Returns:
            Its pose is the measurement alone, without the prior, since the filter fuses both.
        """
        ...

    def relocalize(self, color: NDArray[np.uint8]) -> LandmarkPose | None:
        """Pose from an image (H, W, 3) uint8 RGB, without a prior; None where too few landmarks agree.

        It must be strict: this pose overrules the scan.
        """
        ...


class NoLandmarks:
    """For a room without landmarks."""

    def measure(self, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        return LandmarkMeasurement()

    def relocalize(self, color: NDArray[np.uint8]) -> LandmarkPose | None:
        return None


def pose_from_matches(
    points: FloatArray, seen: Keypoints, camera: Camera, prior: FloatArray, covariance: FloatArray
) -> tuple[NDArray[np.bool_], LandmarkPose | None]:
    """Pose of a camera that sees points (M, 3), world frame, as M keypoints, of which some are wrong matches.

    Gauss-Newton with Geman-McClure weights that start wide (Yang et al., *Graduated Non-Convexity for Robust Spatial
    Perception*, 2020) rejects wrong matches with the help of the prior. The pose returned is the measurement without
    the prior, since the filter fuses both.

    Returns:
        Which points agree, (M,) bool, and the pose: None where these are too few, or where they leave a direction
        undetermined.
    """
    rays, sd = seen.rays(camera)
    pose: FloatArray = prior
    information = np.asarray(np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(6)), dtype=np.float64)
    for kernel_sd in _KERNEL_SDS:
        normal, gradient, _ = _normal_equations(pose, points, rays, sd, kernel_sd)
        offset = se3_log(invert(prior) @ pose)
        pose = pose @ se3_exp(-np.linalg.solve(normal + information, gradient + information @ offset))
    normal, gradient, weights = _normal_equations(pose, points, rays, sd, _KERNEL_SDS[-1])
    agree = weights > _AGREE_WEIGHT
    if int(agree.sum()) < LEAST_LANDMARKS or np.linalg.eigvalsh(normal)[0] < 1.0 / _UNOBSERVABLE_SD**2:
        return agree, None
    spread = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    focal = _log_focal(pose, points, rays, sd)
    return agree, LandmarkPose(pose @ se3_exp(-spread @ gradient), spread, points[agree], *focal)


def _log_focal(pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Logarithm of true over stated focal length, and its standard deviation, from landmarks (M, 3) seen as rays.

    The residuals of a wrong focal length grow with the radius; a step along the view takes up a part of them. So pose
    and focal length are estimated together, again from a wide kernel, since those that agreed with a wrong focal
    length are near the centre.
    """
    start, log_focal = pose, 0.0
    information = np.diag(np.repeat([_SHIFT_SD_M, _TURN_SD_RAD, _FOCAL_SD], [3, 3, 1]) ** -2)
    for kernel_sd in _FOCAL_KERNEL_SDS:
        seen = rays * np.exp(-log_focal)  # a ray is a pixel over the focal length
        residuals, jacobian = _residuals(pose, points, seen, sd)
        columns = np.concatenate([jacobian, (seen / sd)[..., None]], axis=2).reshape(-1, 7)
        weighted = columns * np.repeat(_weights(residuals, kernel_sd), 2)[:, None]
        normal = weighted.T @ columns + information
        offset = np.append(se3_log(invert(start) @ pose), log_focal)
        step = -np.linalg.solve(normal, weighted.T @ residuals.ravel() + information @ offset)
        pose, log_focal = pose @ se3_exp(step[:6]), log_focal + float(step[6])
    return log_focal, float(np.sqrt(np.linalg.inv(normal)[6, 6]))


def _normal_equations(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, kernel_sd: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrix (6, 6) and gradient (6,) of the pose's twist, and weights (M,) of the points.

    A weight is a quarter at a residual of ``kernel_sd`` standard deviations.
    """
    residuals, jacobian = _residuals(pose, points, rays, sd)
    weights = _weights(residuals, kernel_sd)
    flat = jacobian.reshape(-1, 6)
    weighted = flat * np.repeat(weights, 2)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel(), weights


def _weights(residuals: FloatArray, kernel_sd: float) -> FloatArray:
    """Geman-McClure weights (M,) of residuals (M, 2) in standard deviations."""
    return np.asarray((1.0 + np.sum(residuals**2, axis=1) / kernel_sd**2) ** -2)


def _residuals(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (M, 2) in standard deviations, and their derivative by the pose's twist, (M, 2, 6)."""
    local = transform(invert(pose), points)
    local[:, 2] = np.maximum(local[:, 2], _NEAREST_M)
    return (local[:, :2] / local[:, 2:] - rays) / sd, _jacobian(local) / sd[..., None]


def _jacobian(local: FloatArray) -> FloatArray:
    """Derivative of rays' x and y by the camera's twist, (M, 2, 6), for points (M, 3) in its frame."""
    by_point = ray_jacobian(local)
    return np.concatenate([-by_point, by_point @ hat(local)], axis=2)
