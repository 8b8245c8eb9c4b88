"""The error distribution of poses that are measured frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, rotation_angle

_DEGREES_OF_FREEDOM = 4.0  # of the t distribution: regressed poses have outliers
_FIT_ROUNDS = 50
_DIMENSIONS = 6
_LEAST_POSITION_SD_M, _LEAST_ROTATION_SD_RAD = 1e-3, 1e-3


@dataclass(frozen=True)
class PoseError:
    """The error of measured poses: a t distribution, equal along all axes.

    Attributes:
        position_sd_m, rotation_sd_rad: its scales per axis.
    """

    position_sd_m: float
    rotation_sd_rad: float

    @classmethod
    def fit(cls, measured: FloatArray, truth: FloatArray) -> PoseError:
        """The maximum-likelihood scales of N >= 1 errors, by expectation-maximisation (Lange et al. 1989).

        Args:
            measured, truth: ``T_world_camera``, (N, 4, 4).
        """
        offset = measured[:, :3, 3] - truth[:, :3, 3]
        angle = rotation_angle(np.swapaxes(measured[:, :3, :3], 1, 2) @ truth[:, :3, :3])
        squares = np.stack([np.sum(offset**2, axis=1), angle**2]) / 3.0
        variances = squares.mean(axis=1)
        floor = np.array([_LEAST_POSITION_SD_M, _LEAST_ROTATION_SD_RAD]) ** 2
        for _ in range(_FIT_ROUNDS):
            variances = np.maximum(variances, floor)
            distance = 3.0 * np.sum(squares / variances[:, None], axis=0)
            weights = (_DEGREES_OF_FREEDOM + _DIMENSIONS) / (_DEGREES_OF_FREEDOM + distance)
            variances = np.mean(weights * squares, axis=1)
        position_sd_m, rotation_sd_rad = np.sqrt(np.maximum(variances, floor))
        return cls(float(position_sd_m), float(rotation_sd_rad))

    def log_likelihood(self, measured: FloatArray, poses: FloatArray) -> FloatArray:
        """Log-likelihood of a measured pose (4, 4) at each pose (N, 4, 4), (N,) nats up to a constant."""
        offset = poses[:, :3, 3] - measured[:3, 3]
        angle = rotation_angle(measured[:3, :3].T @ poses[:, :3, :3])
        distance = np.sum(offset**2, axis=1) / self.position_sd_m**2 + angle**2 / self.rotation_sd_rad**2
        nats = -0.5 * (_DEGREES_OF_FREEDOM + _DIMENSIONS) * np.log1p(distance / _DEGREES_OF_FREEDOM)
        return np.asarray(nats)
