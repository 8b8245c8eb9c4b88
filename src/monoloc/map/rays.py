"""The mixture seen along rays: how likely a depth is on its ray, whatever part of the map lies there."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from monoloc import _core
from monoloc.geometry import FloatArray
from monoloc.map.arguments import check_outliers_and_threads, float32, float64

LOG_DEPTH_RANGE = 4.0  # outliers are uniform in log-depth over so much: 0.15 m to 8 m


class RayMixture:
    """A mixture's density of depth along rays, for weighing particles.

    Components are looked at within 12 m of the particles, and along a ray where they carry more than 1e-5 of what
    the fullest one carries. Particles that are nearly alike share that choice, made at 32 of them.

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
        threads: int = 1,
    ) -> FloatArray:
        """Log-likelihood of a scan's depths for every particle, given their rays; not tempered.

        ``sum_p w_p log((1 - eps) d p(d | ray) + eps / range)`` with d the particle's scale times predicted depth and
        p that of the map cut by the ray, widened by the error of depth. Twin, and formula:
        :func:`monoloc.map.numpy_twins.weigh_rays`.

        Args:
            poses: ``T_world_camera``, (N, 4, 4).
            log_scales: s, (N,): natural logarithm of what predicted depth is multiplied by.
            scan: points in the camera's frame, (P, 3), metres, z > 0.
            log_depth_sd: standard deviation of an inlier's log-depth.
            outlier_share: eps in (0, 1].
            point_weights: w, (P,); None for ones.
            threads: that share the particles; the result is the same for any number.

        Returns:
            (N,) float64, nats.

        Raises:
            ValueError: wrong shapes, values that are not finite or out of range.
        """
        check_outliers_and_threads(outlier_share, threads)
        if not 0.0 <= log_depth_sd < np.inf:
            raise ValueError(f"log_depth_sd must be finite and not negative, got {log_depth_sd}")
        poses = float64("poses", poses, None, 4, 4)
        scan = float32("scan", scan, None, 3)
        if np.any(scan[:, 2] <= 0.0):
            raise ValueError("scan must lie before the camera: z > 0")
        weights = None if point_weights is None else float32("point_weights", point_weights, len(scan))
        log_scales = float64("log_scales", log_scales, len(poses))
        return self._native.weigh(
            poses, log_scales, scan, weights, log_depth_sd, outlier_share, LOG_DEPTH_RANGE, threads
        )
