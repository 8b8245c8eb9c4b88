"""Depth distribution of a mixture along rays, normalised on each ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

import monoloc._core as _core
from monoloc.geometry import FloatArray
from monoloc.map.arguments import check_outlier_share, float32, float64

LOG_DEPTH_RANGE = 4.0  # support of outliers, which are uniform in log-depth: 0.15 m to 8 m


class RayMixture:
    """Density of depth along rays through a mixture, for likelihoods of particles.

    Only components within 12 m of the particles are used. On each ray, only components with more than 1e-5 of the
    mass of the heaviest one are used. Particles with similar poses share this selection, which is made at 32 of them.

    Args:
        weights, means, covariances: (K,), (K, 3), (K, 3, 3) float64, world frame, metres.
    """

    def __init__(self, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> None:
        self._native = _core.RayMixture(weights, means, covariances)

    def weigh(
        self,
        poses: ArrayLike,
        log_scales: ArrayLike,
        scan: ArrayLike,
        *,
        log_depth_sd: float,
        outlier_share: float,
        point_weights: ArrayLike | None = None,
    ) -> FloatArray:
        """Untempered log-likelihood of a scan's depths, given their rays, for each particle.

        ``sum_p w_p log((1 - eps) d p(d | ray) + eps / range)``, where d is predicted depth times the particle's
        scale, and p is the map's density of depth on the ray, convolved with the error of depth. NumPy twin with the
        full formula: :func:`monoloc.map.numpy_twins.weigh_rays`.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scales: s, (N,), natural logarithm of the factor on predicted depth.
            scan: points in the camera's frame, (P, 3), metres, z > 0.
            log_depth_sd: standard deviation of an inlier's log-depth.
            outlier_share: eps in (0, 1].
            point_weights: w, (P,); None for ones.

        Returns:
            (N,) float64, nats.

        Raises:
            ValueError: a shape is wrong, or a value is not finite or out of range.
        """
        check_outlier_share(outlier_share)
        if not 0.0 <= log_depth_sd < np.inf:
            raise ValueError(f"log_depth_sd must be finite and not negative, got {log_depth_sd}")
        poses = float64("poses", poses, None, 4, 4)
        scan = float32("scan", scan, None, 3)
        if np.any(scan[:, 2] <= 0.0):
            raise ValueError("scan must lie before the camera: z > 0")
        weights = None if point_weights is None else float32("point_weights", point_weights, len(scan))
        log_scales = float64("log_scales", log_scales, len(poses))
        return self._native.weigh(poses, log_scales, scan, weights, log_depth_sd, outlier_share, LOG_DEPTH_RANGE)
