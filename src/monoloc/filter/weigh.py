"""How well a scan fits the map from where each particle stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.filter.particles import Particles, normalised
from monoloc.filter.scan import Scan
from monoloc.geometry import FloatArray
from monoloc.map.mixture import GaussianMixture


class MeasurementConfig(BaseModel):
    """What is believed about the errors of scan points.

    Attributes:
        outlier_share: share of points that come from anywhere in the room (epsilon).
        noise_sd_m: standard deviation of a point about the map, beyond the map's own spread; the map is
            smoothed by it.
        effective_points: how many independent points a scan of the whole depth image is worth. Depth errors of one
            image go together, so this is far below the number of points (tempering: tau = effective_points / P).
        effective_corners: the same of the corners whose depth parallax has refined.
        error_power: how much the error that the network states of itself decides which points count: as its inverse
            to this power; 0 counts all alike.
        corner_log_depth_sd: corners whose log-depth is less certain than this are left out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    outlier_share: float = Field(0.5, gt=0.0, lt=1.0)
    noise_sd_m: float = Field(0.03, ge=0.0)
    effective_points: float = Field(40.0, ge=0.0)
    effective_corners: float = Field(20.0, ge=0.0)
    error_power: float = Field(1.0, ge=0.0)
    corner_log_depth_sd: float = Field(0.1, gt=0.0)


class Measurement:
    """The likelihood of scans under a map: ``prod_p e^s ((1 - eps) M(T e^s x_p) + eps / V)``, tempered.

    What is observed is depth as predicted, so the density of the depth that it stands for is stretched by ``e^s``
    along the ray. Without that factor the likelihood favours particles that shrink the scan: its errors shrink too.
    """

    def __init__(self, mixture: GaussianMixture, config: MeasurementConfig) -> None:
        smoothed = replace(mixture, covariances=mixture.covariances + config.noise_sd_m**2 * np.eye(3))
        self.config = config
        self._volume_m3 = smoothed.volume_m3
        floor = config.outlier_share / (1.0 - config.outlier_share) / self._volume_m3
        self._index = smoothed.index(floor_density=floor)

    def mean_log_likelihood(self, poses: FloatArray, log_scale: FloatArray, scan: Scan) -> FloatArray:
        """Weighted mean over the scan's points of the log density at each particle, (N,) nats.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scale: (N,).
            scan: of at least one point.
        """
        total = self._index.weigh(
            poses,
            log_scale,
            scan.points,
            outlier_share=self.config.outlier_share,
            volume_m3=self._volume_m3,
            point_weights=scan.weights,
        )
        return total / float(scan.weights.sum()) + log_scale

    def weigh(self, particles: Particles, scan: Scan, effective_points: float) -> Particles:
        """The particles with the scan's evidence added, as that of so many points; unchanged for an empty scan."""
        if len(scan) == 0:
            return particles
        fit = self.mean_log_likelihood(particles.poses, particles.log_scale, scan)
        log_weights = particles.log_weights + effective_points * fit
        return Particles(particles.poses, particles.log_scale, normalised(log_weights))
