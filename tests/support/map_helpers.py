"""Mixtures, particles and motions for the tests of map and filter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import se3_exp, so3_exp
from monoloc.map.mixture import GaussianMixture
from monoloc.odometry.motion import Motion

FloatArray = NDArray[np.float64]


def make_mixture(components: int, seed: int = 0, extent_m: float = 1.5) -> GaussianMixture:
    """Flat components in random directions, as surfaces give."""
    rng = np.random.default_rng(seed)
    rotations = so3_exp(rng.normal(size=(components, 3)))
    sigmas = np.array([0.2, 0.12, 0.015]) * rng.uniform(0.7, 1.4, (components, 3))
    covariances = (rotations * sigmas[:, None, :] ** 2) @ rotations.swapaxes(-1, -2)
    covariances = 0.5 * (covariances + covariances.swapaxes(-1, -2))
    weights = rng.uniform(0.5, 1.5, components)
    return GaussianMixture(weights / weights.sum(), rng.uniform(-extent_m, extent_m, (components, 3)), covariances)


def make_particles(count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Poses (count, 4, 4) a few centimetres and degrees about the identity, and log-scales (count,)."""
    poses = se3_exp(rng.normal(size=(count, 6)) * np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02]))
    return poses, rng.normal(0.0, 0.03, count)


def motion_of(delta: FloatArray) -> Motion:
    """A motion ``T_previous_current`` of which no corner is known."""
    return Motion(delta)


def nats_with_outliers(log_density: FloatArray, share: float, volume_m3: float) -> FloatArray:
    """``log((1 - eps) M + eps / V)`` of log M."""
    return np.log((1.0 - share) * np.exp(log_density) + share / volume_m3)
