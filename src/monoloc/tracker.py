"""The tracker: particles and belief of one camera from frame to frame, whatever measures its pose."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from monoloc.fusion.bias_filter import BiasAugmentedFilter
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.filter import ParticleFilter
from monoloc.particle_filter.particles import Particles


class Tracker:
    """Predicts and updates particles and belief; a frame is :meth:`predict`, :meth:`update`, :meth:`fuse`.

    Args:
        start: particles before the first frame.
        config: settings.
        reference_poses: of the room, or none.
        rng: source of all random numbers.

    Attributes:
        fusion: holds the belief.
    """

    def __init__(
        self, start: Particles, config: LocalizerConfig, reference_poses: ReferencePoses, rng: np.random.Generator
    ) -> None:
        noise = config.motion_noise
        self._filter = ParticleFilter(start, noise, config.log_scale_sd, config.ess_fraction, rng)
        self.fusion = BiasAugmentedFilter(
            estimate(start),
            config.particle_bias,
            noise,
            reference_poses,
            config.landmark_bias,
            is_memoryless="bias" in config.without,
        )
        self._is_first = True
        self._held: tuple[Particles, BiasAugmentedFilter] | None = None

    @property
    def particles(self) -> Particles:
        return self._filter.particles

    def hold(self) -> None:
        """Remember particles and belief at the last image, before the first prediction for one that repeats it."""
        if self._held is None:
            self._held = self._filter.particles, copy(self.fusion)

    def resume(self) -> None:
        """Go on from what is remembered, if anything: the motion of the next prediction begins there."""
        if self._held is not None:
            self._filter.particles, self.fusion = self._held
            self._held = None

    def predict(self, motion: Motion | None, elapsed_s: float, from_search: bool = False) -> Particles:
        """Particles after the motion since the previous frame; at the first frame, as they start.

        Args:
            motion: of the odometry, None where it has none.
            elapsed_s: since the previous frame.
            from_search: whether the particles are those of a recent search, and so independent of how long the
                belief has not been updated.
        """
        if self._is_first:
            self._is_first = False
            return self._filter.particles
        time_since_update_s = 0.0 if from_search else self.fusion.time_since_update_s
        return self._filter.predict(motion, elapsed_s, time_since_update_s)

    def update(
        self, particles: Particles, weigh: Callable[[Particles], Particles], count: int | None = None
    ) -> Estimate:
        """The particles' pose after a measurement; as :meth:`ParticleFilter.update`."""
        return self._filter.update(particles, weigh, count)

    def redraw(self) -> None:
        """Draw the particles anew from the belief."""
        self._filter.redraw(self.fusion.belief)

    def fuse(self, motion: Motion | None, elapsed_s: float, measured: Estimate, accepted: bool) -> Estimate:
        """The belief after the motion and, if it is accepted, the particles' pose.

        Args:
            measured: pose of the particles.
            accepted: whether this frame's measurement counts; if not, the particles say nothing new.
        """
        belief = self.fusion.predict(motion, elapsed_s, measured)
        return self.fusion.update_from_particles(measured) if accepted else belief
