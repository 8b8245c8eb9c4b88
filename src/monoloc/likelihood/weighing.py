"""The weighing of particles by scans and corners, frame after frame."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood, weigh_corners, weigh_depth_image
from monoloc.likelihood.scan import Scan
from monoloc.particle_filter.frame_share import share_of_frame
from monoloc.particle_filter.particles import Particles
from monoloc.particle_filter.tempering import tempered_update


class FrameWeighing:
    """Weighs particles by the frames of one flight; images of a fast camera count as shares of a frame.

    Args:
        likelihood, config: of scans and corners.
        rng: for the resampling between powers of a sharp likelihood.
    """

    def __init__(self, likelihood: ScanLikelihood, config: LikelihoodConfig, rng: np.random.Generator) -> None:
        self._likelihood, self._config, self._rng = likelihood, config, rng
        self._scan_age_s = math.inf  # since a scan was last weighed

    def begin(self, scan: Scan, corners: Scan, elapsed_s: float) -> Callable[[Particles], Particles]:
        """The measurement update of a frame, to be called once for each.

        Args:
            scan: of the frame's depth image; empty where depth has not its turn.
            corners: with their refined depth.
            elapsed_s: since the previous frame.
        """
        self._scan_age_s += elapsed_s
        of_scan, of_corners = share_of_frame(self._scan_age_s), share_of_frame(elapsed_s)
        if len(scan):
            self._scan_age_s = 0.0

        def weigh(particles: Particles) -> Particles:
            particles = weigh_depth_image(particles, scan, self._likelihood, self._config, of_scan)
            return weigh_corners(particles, corners, self._likelihood, self._config, of_corners)

        return lambda particles: tempered_update(particles, weigh, self._rng)
