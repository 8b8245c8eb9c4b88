"""What is done about a camera that is lost: it is looked for in the whole room, and what is found is put on trial."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from monoloc.geometry import viewpoints_apart
from monoloc.landmarks.pnp import Sighting
from monoloc.likelihood.scan import Scan
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization.search import Search
from monoloc.supervision.state import HealthyRange, is_wide

_EVERY_S = 1.0  # the camera is looked for; as long, a scan has to fit nowhere near before the camera is lost
_SAME_M = 0.3  # of two poses that are taken for one, a radian for a metre
_SEEN_AGAIN_M = 1.0  # the same of two that landmarks told: between them, particles have followed what depth says


def _apart_m(one: Estimate, other: Estimate) -> float:
    return float(viewpoints_apart(one.pose, other.pose[None])[0])


class Recovery:
    """Knows whether a camera is lost, and looks for it; per frame, :meth:`look` and then :meth:`note`.

    One scan may fit where the camera is not. So where it is found, it is on trial: followed for a second, and
    believed if the whole room then has no better place for it.

    Args:
        search: of the room; None where there is nothing to look around, and then no camera is ever lost.
        healthy: range of a pose that can be believed.
        is_lost: whether where it starts is unknown.

    Attributes:
        is_lost: nothing but odometry is to move the belief.
        is_on_trial: the particles are where a lost camera was found, and scans move them.
    """

    def __init__(self, search: Search | None, healthy: HealthyRange, is_lost: bool) -> None:
        self._search = search
        self._healthy = healthy
        self.is_lost = is_lost and search is not None
        self.is_on_trial = False
        self._misfit_s = 0.0
        self._since_s = _EVERY_S  # the last search

    @property
    def is_followed(self) -> bool:
        """Whether the particles are anywhere in particular, to be moved by a scan."""
        return self.is_on_trial or not self.is_lost

    def lose(self) -> None:
        """Where the camera is, nothing says any more; it is looked for, if it can be."""
        self.is_lost = self._search is not None

    def look(
        self,
        particles: Particles,
        scan: Scan,
        elapsed_s: float,
        rng: np.random.Generator,
        sighted: Callable[[], Sighting | None] = lambda: None,
    ) -> tuple[Particles, bool]:
        """Look for a lost camera, once a second: where landmarks say that it is, or else where its scan fits.

        One that is only suspected to be lost, by scans, is not if landmarks, anywhere, say where it is thought to be.

        Args:
            particles: where they are at this frame, by motion alone.
            scan: of this frame; of no points where it tells nothing.
            elapsed_s: since the frame before.
            rng: used only where the camera is lost.
            sighted: asked only then.

        Returns:
            The particles, or others where the camera was found; and whether it is no longer lost.
        """
        self._since_s += elapsed_s
        is_sought = self.is_lost or self._misfit_s >= _EVERY_S
        if self._search is None or not is_sought or self._since_s < _EVERY_S or len(scan) == 0:
            return particles, False
        self._since_s = 0.0
        here = estimate(particles)
        seen = sighted()
        if seen is not None:
            # However the scan fits there: landmarks are for where depth errs.
            place, was_lost = Estimate(seen.pose, seen.covariance, here.log_scale), self.is_lost
            is_known = self.is_on_trial or not was_lost
            is_believed = self._tried(is_known and _apart_m(here, place) < _SEEN_AGAIN_M)
            return self._search.around(place, len(particles), rng), is_believed and was_lost
        found, fit = self._search(scan, here, rng)
        if fit < self._healthy.lost:
            self.is_on_trial = False
            return particles, False
        if self.is_on_trial and _apart_m(here, found) < _SAME_M:
            is_believed = fit >= self._healthy.low
            return particles, is_believed and self._tried(is_believed)
        return self._search.around(found, len(particles), rng), self._tried(False)

    def _tried(self, is_believed: bool) -> bool:
        """After a trial that was passed, or at the beginning of one; says which."""
        self.is_lost = self.is_on_trial = not is_believed
        if is_believed:
            self._misfit_s = 0.0
        return is_believed

    def note(self, fit: float, belief: Estimate, elapsed_s: float) -> None:
        """Take in what became of a frame.

        Args:
            fit: of its scan where the particles are, nats; NaN for an empty scan.
            belief: the joined one.
            elapsed_s: since the frame before.
        """
        if self._search is None:
            return
        if is_wide(belief):
            self.lose()
        if not math.isnan(fit):
            self._misfit_s = self._misfit_s + elapsed_s if fit < self._healthy.lost else 0.0
