"""Tempered measurement update, for likelihoods so sharp that one particle would take all the weight.

Progressive correction with regularisation (Musso, Oudjane and Le Gland, *Improving regularised particle filters*,
2001): after darkness, or from a vague start, few of hundreds of particles are near the likelihood's peak. The
likelihood is applied in powers, and between them particles are resampled and spread a little.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from monoloc.geometry import FloatArray, se3_exp
from monoloc.particle_filter.estimate import estimate
from monoloc.particle_filter.particles import Particles, normalised
from monoloc.particle_filter.resampling import resample

_LEAST_ESS_SHARE = 0.1  # effective sample size after a stage, as a share of the particles
_MOST_STAGES = 12
_BANDWIDTH = 0.5  # share of the particles' own spread: near the optimum for hundreds in seven dimensions
_BISECTIONS = 20


def tempered_update(
    particles: Particles, weigh: Callable[[Particles], Particles], rng: np.random.Generator
) -> Particles:
    """Particles after a measurement: in one stage if the effective sample size allows it, else in several.

    Args:
        weigh: particles with the log-likelihood added to their log-weights.
        rng: used only if there are several stages.
    """
    remaining = 1.0
    for stage in range(_MOST_STAGES):
        weighed = weigh(particles)
        gain = weighed.log_weights - particles.log_weights
        power = remaining if stage == _MOST_STAGES - 1 else _largest_power(particles.log_weights, gain, remaining)
        if power == 1.0:
            return weighed
        particles = Particles(particles.poses, particles.log_scale, normalised(particles.log_weights + power * gain))
        remaining -= power
        if remaining == 0.0:
            break
        particles = _regularised(resample(particles, 1.0, rng), rng)
    return particles


def _largest_power(log_weights: FloatArray, gain: FloatArray, most: float) -> float:
    """The largest power of the likelihood, up to ``most``, that keeps the effective sample size, to a millionth."""

    def keeps_ess(power: float) -> bool:
        weights = np.exp(normalised(log_weights + power * gain))
        return bool(1.0 / np.sum(weights**2) >= _LEAST_ESS_SHARE * len(weights))

    if keeps_ess(most):
        return most
    low, high = 0.0, most
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps_ess(middle) else (low, middle)
    return low


def _regularised(particles: Particles, rng: np.random.Generator) -> Particles:
    """Particles with kernel noise added."""
    spread = estimate(particles)
    variances, axes = np.linalg.eigh(spread.covariance)
    noise = rng.standard_normal((len(particles), 6)) * (_BANDWIDTH * np.sqrt(np.maximum(variances, 0.0)))
    scale_sd = _BANDWIDTH * float(particles.log_scale.std())
    log_scale = particles.log_scale + scale_sd * rng.standard_normal(len(particles))
    return Particles(particles.poses @ se3_exp(noise @ axes.T), log_scale, particles.log_weights)
