"""Systematic resampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.particle_filter.particles import Particles


def systematic_indices(weights: FloatArray, rng: np.random.Generator, count: int | None = None) -> NDArray[np.int64]:
    """Indices drawn in proportion to weights with one random number (Kitagawa 1996).

    Particle i is drawn floor(count w_i) or ceil(count w_i) times.

    Args:
        weights: (N,), summing to 1.
        count: of indices; None for N.
    """
    count = len(weights) if count is None else count
    positions = (rng.uniform() + np.arange(count)) / count
    cumulative = np.cumsum(weights)
    indices = np.searchsorted(cumulative, positions * cumulative[-1], side="right")
    # The last position can round up to the sum itself, beyond every particle.
    return np.asarray(np.minimum(indices, np.flatnonzero(weights)[-1]), dtype=np.int64)


def resample(
    particles: Particles, ess_fraction: float, rng: np.random.Generator, count: int | None = None
) -> Particles:
    """Redraw the particles when their effective sample size is under a fraction of their number.

    Args:
        count: of particles that are wanted; they are redrawn where there are more or fewer. None keeps the number.
    """
    count = len(particles) if count is None else count
    if count == len(particles) and particles.effective_sample_size >= ess_fraction * count:
        return particles
    chosen = systematic_indices(particles.weights, rng, count)
    return Particles(particles.poses[chosen], particles.log_scale[chosen], np.full(count, -np.log(count)))
