"""Particles: weighted hypotheses of pose and depth scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, se3_exp


@dataclass(frozen=True)
class Particles:
    """N weighted hypotheses.

    Attributes:
        poses: ``T_world_camera``, (N, 4, 4).
        log_scale: (N,) natural logarithm of true depth over predicted depth.
        log_weights: (N,), normalised: their exponentials sum to 1.
    """

    poses: FloatArray
    log_scale: FloatArray
    log_weights: FloatArray

    def __len__(self) -> int:
        return len(self.log_weights)

    @property
    def weights(self) -> FloatArray:
        return np.exp(self.log_weights)

    @property
    def effective_sample_size(self) -> float:
        """1 / sum(w^2), between 1 and N (Kong et al. 1994)."""
        return float(1.0 / np.sum(self.weights**2))


def normalised(log_weights: FloatArray) -> FloatArray:
    """Log-weights shifted so that their exponentials sum to 1, without overflow."""
    peak = np.max(log_weights)
    return np.asarray(log_weights - (peak + np.log(np.sum(np.exp(log_weights - peak)))))


def scatter(
    pose: FloatArray,
    count: int,
    position_sd_m: float,
    rotation_sd_rad: float,
    log_scale_sd: float,
    rng: np.random.Generator,
) -> Particles:
    """Particles around a pose, each axis independent and Gaussian.

    Args:
        pose: ``T_world_camera``, (4, 4).
        position_sd_m, rotation_sd_rad: standard deviation per axis.
        log_scale_sd: standard deviation of the depth's log-scale about 0.
    """
    twists = rng.standard_normal((count, 6)) * np.repeat([position_sd_m, rotation_sd_rad], 3)
    return Particles(
        poses=pose @ se3_exp(twists),
        log_scale=rng.standard_normal(count) * log_scale_sd,
        log_weights=np.full(count, -np.log(count)),
    )
