"""What a likelihood of scans must offer, its settings, and how its evidence is added to the particles."""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import Scan
from monoloc.map.arguments import float64
from monoloc.particle_filter.particles import Particles, normalised


class LikelihoodConfig(BaseModel):
    """Error model of scan points.

    Attributes:
        kind: ``ray``: error of a point's depth along its ray, proportional to depth, as a network's errors are.
            ``volume``: error of its position, equal in all directions, as a depth sensor's errors roughly are.
        outlier_share: share of points that hit no mapped surface (epsilon).
        noise_sd_m: standard deviation of the map beyond its components' own spread; the map is smoothed by it.
        log_depth_sd: standard deviation of an inlier's log-depth (``ray``).
        effective_points: number of independent points that a depth image's scan counts as. Depth errors within one
            image are correlated, so this is far below the number of points (tempering: tau = effective_points / P,
            at most 1).
        effective_corners: the same for the corners whose depth parallax has refined.
        error_power: a point's weight is the inverse of the error that the network states, to this power; 0 weighs
            all points alike.
        corner_log_depth_sd: standard deviation of a refined corner's log-depth (``ray``).
        max_corner_log_depth_sd: corners whose stated standard deviation of log-depth is above this are left out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: Literal["ray", "volume"] = "ray"
    outlier_share: float = Field(0.3, gt=0.0, lt=1.0)
    noise_sd_m: float = Field(0.02, ge=0.0, le=10.0)
    log_depth_sd: float = Field(0.06, gt=0.0, le=10.0)
    effective_points: float = Field(100.0, ge=0.0, le=1e6)
    effective_corners: float = Field(20.0, ge=0.0, le=1e6)
    error_power: float = Field(1.0, ge=0.0, le=10.0)
    corner_log_depth_sd: float = Field(0.04, gt=0.0, le=10.0)
    max_corner_log_depth_sd: float = Field(0.1, gt=0.0, le=10.0)


class ScanLikelihood(Protocol):
    """Likelihood of a scan at a pose; :class:`monoloc.likelihood.ray.RayLikelihood` is one.

    A likelihood of your own is used through :class:`monoloc.components.Components` and calibrated with
    :func:`monoloc.calibrate`, which fits ``log_depth_sd`` for ``config.kind == "ray"`` and ``noise_sd_m`` for
    ``"volume"``.

    What is observed is depth as predicted. A density of points in the world must therefore be multiplied by ``e^s``,
    that is, ``log_scale`` is added to the log-likelihood; without it, particles that shrink the scan are favoured.
    """

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        """Weighted mean over the scan's points of the log-likelihood at each particle, (N,) nats.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scale: (N,) natural logarithm of true over predicted depth.
            scan: at least one point.
            log_depth_sd: standard deviation of the points' log-depth; None for that of the depth image. The filter
                passes ``config.log_depth_sd`` for a depth image and ``config.corner_log_depth_sd`` for corners.

        Returns:
            Finite values: poses from which nothing fits need a floor, such as the outlier share.
        """
        ...


def best_over_scales(
    likelihood: ScanLikelihood,
    pose: FloatArray,
    scan: Scan,
    log_scales: FloatArray,
    log_depth_sd: float | None = None,
) -> tuple[float, float]:
    """The best mean log-likelihood of a scan at a pose (4, 4) over depth scales (N,), and the log-scale there."""
    poses = np.repeat(pose[None], len(log_scales), axis=0)
    values = checked_mean_log_likelihood(likelihood, poses, log_scales, scan, log_depth_sd)
    return float(values.max()), float(log_scales[values.argmax()])


def checked_mean_log_likelihood(
    likelihood: ScanLikelihood,
    poses: FloatArray,
    log_scale: FloatArray,
    scan: Scan,
    log_depth_sd: float | None = None,
) -> FloatArray:
    """:meth:`ScanLikelihood.mean_log_likelihood` of a likelihood that may be a user's own.

    Raises:
        ValueError: it does not return a finite value for each particle.
    """
    values = likelihood.mean_log_likelihood(poses, log_scale, scan, log_depth_sd)
    return float64("what mean_log_likelihood returns", values, len(poses))


def weigh_depth_image(
    particles: Particles, scan: Scan, likelihood: ScanLikelihood, config: LikelihoodConfig, share: float = 1.0
) -> Particles:
    """Particles after the evidence of a depth image's scan, of which a share counts."""
    return _weigh(particles, scan, likelihood, config.effective_points, config.log_depth_sd, share)


def weigh_corners(
    particles: Particles, corners: Scan, likelihood: ScanLikelihood, config: LikelihoodConfig, share: float = 1.0
) -> Particles:
    """Particles after the evidence of refined corners, of which a share counts."""
    return _weigh(particles, corners, likelihood, config.effective_corners, config.corner_log_depth_sd, share)


def _weigh(
    particles: Particles,
    scan: Scan,
    likelihood: ScanLikelihood,
    effective_points: float,
    log_depth_sd: float,
    share: float,
) -> Particles:
    """The scan counts as ``effective_points`` independent points, or as many as it has if these are fewer.

    Args:
        share: by which this number is multiplied.

    Raises:
        ValueError: as :func:`checked_mean_log_likelihood`.
    """
    if len(scan) == 0 or share * effective_points == 0.0:
        return particles
    mean = checked_mean_log_likelihood(likelihood, particles.poses, particles.log_scale, scan, log_depth_sd)
    log_weights = particles.log_weights + share * min(effective_points, len(scan)) * mean
    return Particles(particles.poses, particles.log_scale, normalised(log_weights))
