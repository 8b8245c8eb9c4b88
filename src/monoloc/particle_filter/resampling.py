"""Systematic resampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.particle_filter.particles import Particles


def systematic_indices(weights: FloatArray, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices drawn in proportion to weights with one random number (Kitagawa 1996).

    Particle i is drawn floor(N w_i) or ceil(N w_i) times.

    Args:
        weights: (N,), summing to 1.
    """
    count = len(weights)
    positions = (rng.uniform() + np.arange(count)) / count
    cumulative = np.cumsum(weights)
    indices = np.searchsorted(cumulative, positions * cumulative[-1], side="right")
    # The last position can round up to the sum itself, beyond every particle.
    return np.asarray(np.minimum(indices, np.flatnonzero(weights)[-1]), dtype=np.int64)


def resample(particles: Particles, ess_fraction: float, rng: np.random.Generator) -> Particles:
    """Redraw the particles when their effective sample size is under a fraction of their number."""
    count = len(particles)
    if particles.effective_sample_size >= ess_fraction * count:
        return particles
    chosen = systematic_indices(particles.weights, rng)
    return Particles(particles.poses[chosen], particles.log_scale[chosen], np.full(count, -np.log(count)))
