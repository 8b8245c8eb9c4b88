"""Whether errors of poses are as large as their covariances and states say.

A *silent* error is one that the state does not announce: the frame is *tracking* or *map-changed*, and its position
is far off, or far outside its own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.evaluation.trajectory import checked_array, checked_pair
from monoloc.geometry import FloatArray, invert, se3_log

FAR_M = 0.30
"""Distance beyond which a position is of no use to a drone in a room."""

CHI2_6_QUANTILE_95, CHI2_6_QUANTILE_99 = 12.591587, 16.811894
"""Quantiles of the chi-squared distribution with 6 degrees of freedom."""

CHI2_3_BEYOND_3_5_SIGMA = 17.881723
"""Quantile of the chi-squared distribution with 3 degrees of freedom whose tail is as small as that of a Gaussian
beyond 3.5 standard deviations to either side, 0.047 %."""

# Variances below this (1 micrometre, 1 microradian, squared) are rounding: poses in files have no more digits.
_VARIANCE_FLOOR = 1e-12


@dataclass(frozen=True)
class Consistency:
    """Errors of N poses, as they are and normalised by their covariances.

    Attributes:
        position_m: (N,) distance between the two camera centres, metres.
        pose_nees: (N,) normalised squared error of the pose, chi-squared with 6 degrees of freedom if the covariance
            is true; a NEES (Bar-Shalom et al. 2001).
        position_nees: (N,) the same of the position alone, with 3 degrees of freedom.
    """

    position_m: FloatArray
    pose_nees: FloatArray
    position_nees: FloatArray

    def of(self, frames: NDArray[np.bool_]) -> Consistency:
        """That of some of the frames, a mask (N,)."""
        return Consistency(self.position_m[frames], self.pose_nees[frames], self.position_nees[frames])

    @property
    def coverage_95(self) -> float:
        """Share of frames whose error lies inside the covariance's 95 % ellipsoid; 0.95 is consistent."""
        return float(np.mean(self.pose_nees <= CHI2_6_QUANTILE_95))

    @property
    def coverage_99(self) -> float:
        """Share of frames whose error lies inside the covariance's 99 % ellipsoid; 0.99 is consistent."""
        return float(np.mean(self.pose_nees <= CHI2_6_QUANTILE_99))

    @property
    def is_far(self) -> NDArray[np.bool_]:
        """(N,) frames whose position is more than :data:`FAR_M` off."""
        return self.position_m > FAR_M

    @property
    def is_beyond_covariance(self) -> NDArray[np.bool_]:
        """(N,) frames whose position lies outside its ellipsoid of 3.5 standard deviations."""
        return self.position_nees > CHI2_3_BEYOND_3_5_SIGMA


def consistency(estimated: ArrayLike, truth: ArrayLike, covariances: ArrayLike) -> Consistency:
    """Compare errors with covariances.

    The error is the twist ``(rho, phi)`` of ``invert(T_world_estimated) @ T_world_truth``. If a covariance has no
    extent along a direction, any error along it lies outside every ellipsoid.

    Args:
        estimated: estimated ``T_world_camera``, (N, 4, 4).
        truth: true ``T_world_camera``, (N, 4, 4), same world.
        covariances: (N, 6, 6) in the tangent space of the estimated camera, order (rho, phi), m and rad.

    Raises:
        ValueError: as :func:`monoloc.evaluation.trajectory.pose_errors`, or covariances of another shape, not finite,
            or not symmetric and positive semidefinite.
    """
    T_world_estimated, T_world_truth = checked_pair(estimated, truth)
    Sigma = checked_array("covariances", covariances, (len(T_world_truth), 6, 6))
    T_estimated_truth = invert(T_world_estimated) @ T_world_truth
    return Consistency(
        position_m=np.linalg.norm(T_world_estimated[:, :3, 3] - T_world_truth[:, :3, 3], axis=-1),
        pose_nees=_normalised_squared(se3_log(T_estimated_truth), Sigma),
        position_nees=_normalised_squared(T_estimated_truth[:, :3, 3], Sigma[:, :3, :3]),
    )


def _normalised_squared(errors: FloatArray, Sigma: FloatArray) -> FloatArray:
    """Squared Mahalanobis length of errors (N, D) under covariances (N, D, D): (N,)."""
    right = is_covariance(Sigma)
    if not right.all():
        raise ValueError(
            f"covariances must be symmetric and positive semidefinite, got frame {int(np.argmin(right))}"
        )
    variances, axes = np.linalg.eigh(Sigma)
    along_axes = (np.swapaxes(axes, -1, -2) @ errors[..., None])[..., 0]
    return np.asarray(np.sum(along_axes**2 / np.maximum(variances, _VARIANCE_FLOOR), axis=-1))


def is_covariance(Sigma: FloatArray) -> NDArray[np.bool_]:
    """Whether finite matrices (..., D, D) are symmetric and positive semidefinite, apart from rounding: (...)."""
    rounding = 1e-6 * np.abs(Sigma).max(axis=(-1, -2)) + _VARIANCE_FLOOR
    asymmetry = np.abs(Sigma - np.swapaxes(Sigma, -1, -2)).max(axis=(-1, -2))
    return np.asarray((np.linalg.eigvalsh(Sigma)[..., 0] >= -rounding) & (asymmetry <= rounding))
