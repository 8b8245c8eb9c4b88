"""How well a scan fits the map from where each particle stands."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import Scan
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import Particles, normalised


class MeasurementConfig(BaseModel):
    """What is believed about the errors of scan points.

    Attributes:
        likelihood: of a point's depth given its ray, whose errors are a share of the depth, as a network's are; or of
            its place in the volume, whose errors are the same in all directions, which suits a depth sensor.
        outlier_share: share of points that come from anywhere (epsilon).
        noise_sd_m: standard deviation of the map itself, beyond its own spread; the map is smoothed by it.
        log_depth_sd: standard deviation of an inlier's log-depth (``ray``).
        effective_points: how many independent points a scan of the whole depth image is worth. Depth errors of one
            image go together, so this is far below the number of points (tempering: tau = effective_points / P, at
            most 1).
        effective_corners: the same of the corners whose depth parallax has refined.
        error_power: how much the error that the network states of itself decides which points count: as its inverse
            to this power; 0 counts all alike.
        corner_log_depth_sd: standard deviation of a refined corner's log-depth (``ray``).
        corner_doubt: corners whose stated standard deviation of log-depth is above this are left out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    likelihood: Literal["ray", "volume"] = "ray"
    outlier_share: float = Field(0.3, gt=0.0, lt=1.0)
    noise_sd_m: float = Field(0.02, ge=0.0)
    log_depth_sd: float = Field(0.06, gt=0.0)
    effective_points: float = Field(100.0, ge=0.0)
    effective_corners: float = Field(20.0, ge=0.0)
    error_power: float = Field(1.0, ge=0.0)
    corner_log_depth_sd: float = Field(0.04, gt=0.0)
    corner_doubt: float = Field(0.1, gt=0.0)


class Measurement:
    """The likelihood of scans under a map, tempered.

    Given the ray: ``prod_p (1 - eps) d p(d | ray) + eps / range``, see :func:`monoloc.map.numpy_twins.weigh_rays`. In
    the volume: ``prod_p e^s ((1 - eps) M(T e^s x_p) + eps / V)``; what is observed is depth as predicted, so the
    density of the depth that it stands for is stretched by ``e^s``, without which the likelihood favours particles
    that shrink the scan.
    """

    def __init__(self, mixture: GaussianMixture, config: MeasurementConfig) -> None:
        smoothed = replace(mixture, covariances=mixture.covariances + config.noise_sd_m**2 * np.eye(3))
        self.config = config
        if config.likelihood == "ray":
            self._rays = smoothed.along_rays()
        else:
            self._volume_m3 = smoothed.volume_m3
            floor = config.outlier_share / (1.0 - config.outlier_share) / self._volume_m3
            self._index = smoothed.index(floor_density=floor)

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        """Weighted mean over the scan's points of the log density at each particle, (N,) nats.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scale: (N,).
            scan: of at least one point.
            log_depth_sd: of the points, where it is not that of the depth image.
        """
        config = self.config
        total = float(scan.weights.sum())
        if config.likelihood == "ray":
            weighed = self._rays.weigh(
                poses,
                log_scale,
                scan.points,
                log_depth_sd=config.log_depth_sd if log_depth_sd is None else log_depth_sd,
                outlier_share=config.outlier_share,
                point_weights=scan.weights,
            )
            return weighed / total
        weighed = self._index.weigh(
            poses,
            log_scale,
            scan.points,
            outlier_share=config.outlier_share,
            volume_m3=self._volume_m3,
            point_weights=scan.weights,
        )
        return weighed / total + log_scale

    def weigh_image(self, particles: Particles, scan: Scan) -> Particles:
        """The particles with the evidence of a depth image's scan added."""
        return self._weigh(particles, scan, self.config.effective_points, self.config.log_depth_sd)

    def weigh_corners(self, particles: Particles, scan: Scan) -> Particles:
        """The particles with the evidence of refined corners added."""
        return self._weigh(particles, scan, self.config.effective_corners, self.config.corner_log_depth_sd)

    def _weigh(self, particles: Particles, scan: Scan, effective_points: float, log_depth_sd: float) -> Particles:
        """The evidence counts as that of so many points, or of as many as there are."""
        if len(scan) == 0 or effective_points == 0.0:
            return particles
        fit = self.mean_log_likelihood(particles.poses, particles.log_scale, scan, log_depth_sd)
        log_weights = particles.log_weights + min(effective_points, len(scan)) * fit
        return Particles(particles.poses, particles.log_scale, normalised(log_weights))
