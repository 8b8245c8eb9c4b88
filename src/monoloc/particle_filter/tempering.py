"""Evidence taken in by stages where too few particles would bear it at once.

Progressive correction with regularisation (Musso, Oudjane and Le Gland, *Improving regularised particle filters*,
2001): out of the dark, or from a vague start, one of hundreds of particles may be near enough to a sharp likelihood
to be kept; taken in by powers, with particles redrawn and spread a little between, it draws all of them there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from monoloc.geometry import FloatArray, se3_exp
from monoloc.particle_filter.estimate import estimate
from monoloc.particle_filter.particles import Particles, normalised
from monoloc.particle_filter.resampling import resample

_LEAST_SHARE = 0.1  # of the particles that a stage leaves effective
_MOST_STAGES = 12
_KERNEL = 0.5  # of the particles' own spread: near the best bandwidth for hundreds of them in seven dimensions
_HALVINGS = 20


def correct(particles: Particles, weigh: Callable[[Particles], Particles], rng: np.random.Generator) -> Particles:
    """Particles with evidence added: at once where enough of them bear it, else by stages.

    Args:
        weigh: particles with the evidence added to their weights.
        rng: not used where no stages are needed.
    """
    left = 1.0
    for stage in range(_MOST_STAGES):
        weighed = weigh(particles)
        gain = weighed.log_weights - particles.log_weights
        share = left if stage == _MOST_STAGES - 1 else _bearable(particles.log_weights, gain, left)
        if share == 1.0:
            return weighed
        particles = Particles(particles.poses, particles.log_scale, normalised(particles.log_weights + share * gain))
        left -= share
        if left == 0.0:
            break
        particles = _told_apart(resample(particles, 1.0, rng), rng)
    return particles


def _bearable(log_weights: FloatArray, gain: FloatArray, most: float) -> float:
    """The largest power of the evidence, up to ``most``, that leaves enough particles effective, to a millionth."""

    def is_bearable(share: float) -> bool:
        weights = np.exp(normalised(log_weights + share * gain))
        return bool(1.0 / np.sum(weights**2) >= _LEAST_SHARE * len(weights))

    if is_bearable(most):
        return most
    low, high = 0.0, most
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_bearable(middle) else (low, middle)
    return low


def _told_apart(particles: Particles, rng: np.random.Generator) -> Particles:
    """Each particle moved by a share of the spread of all."""
    spread = estimate(particles)
    variances, axes = np.linalg.eigh(spread.covariance)
    noise = rng.standard_normal((len(particles), 6)) * (_KERNEL * np.sqrt(np.maximum(variances, 0.0)))
    scale_sd = _KERNEL * float(particles.log_scale.std())
    log_scale = particles.log_scale + scale_sd * rng.standard_normal(len(particles))
    return Particles(particles.poses @ se3_exp(noise @ axes.T), log_scale, particles.log_weights)
