"""The particle filter: predict, update, resample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from monoloc.geometry import se3_exp
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.motion_model import MotionConfig, predict
from monoloc.particle_filter.particles import Particles
from monoloc.particle_filter.resampling import resample


class ParticleFilter:
    """Particles of one camera.

    Args:
        start: particles before the first frame.
        motion_noise: noise of the motion model.
        log_scale_sd: standard deviation of the depth's log-scale.
        ess_fraction: resample when the effective sample size is below this share of the particles.
        rng: source of all random numbers.

    Attributes:
        particles: after the last call.
    """

    def __init__(
        self,
        start: Particles,
        motion_noise: MotionConfig,
        log_scale_sd: float,
        ess_fraction: float,
        rng: np.random.Generator,
    ) -> None:
        self.particles = start
        self._motion_noise, self._log_scale_sd, self._ess_fraction = motion_noise, log_scale_sd, ess_fraction
        self._rng = rng

    def predict(self, motion: Motion | None, elapsed_s: float, time_since_update_s: float) -> Particles:
        """Particles after the motion since the previous frame; arguments as :func:`motion_model.motion_sd`."""
        self.particles = predict(
            self.particles,
            motion,
            elapsed_s,
            time_since_update_s,
            self._log_scale_sd,
            self._motion_noise,
            self._rng,
        )
        return self.particles

    def redraw(self, around: Estimate) -> None:
        """Draw the particles anew from a pose's covariance; their depth scales remain."""
        count = len(self.particles)
        variances, axes = np.linalg.eigh(around.covariance)
        twists = self._rng.standard_normal((count, 6)) * np.sqrt(np.maximum(variances, 0.0)) @ axes.T
        log_weights = np.full(count, -np.log(count))
        self.particles = Particles(around.pose @ se3_exp(twists), self.particles.log_scale, log_weights)

    def update(
        self, particles: Particles, weigh: Callable[[Particles], Particles], count: int | None = None
    ) -> Estimate:
        """The particles' pose after a measurement; then resample.

        Args:
            particles: predicted, or drawn anew by a relocalisation.
            weigh: returns particles with the measurement's evidence.
            count: of particles after it; None keeps their number.
        """
        weighed = weigh(particles)
        self.particles = resample(weighed, self._ess_fraction, self._rng, count)
        return estimate(weighed)
