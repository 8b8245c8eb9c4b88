"""Likelihood of a point's depth given its ray, for depth whose error is proportional to depth."""

from __future__ import annotations

from monoloc.geometry import FloatArray
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import Scan
from monoloc.map.mixture import GaussianMixture


class RayLikelihood:
    """``prod_p (1 - eps) d p(d | ray) + eps / range`` under a map.

    Cut by a ray, a Gaussian component is a one-dimensional Gaussian in depth, so the normaliser is closed form. The
    formula is written out in :func:`monoloc.map.numpy_twins.weigh_rays`.
    """

    def __init__(self, mixture: GaussianMixture, config: LikelihoodConfig) -> None:
        self._rays = mixture.smoothed(config.noise_sd_m).along_rays()
        self._config = config

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        """As :meth:`monoloc.likelihood.protocol.ScanLikelihood.mean_log_likelihood`."""
        total = self._rays.weigh(
            poses,
            log_scale,
            scan.points,
            log_depth_sd=self._config.log_depth_sd if log_depth_sd is None else log_depth_sd,
            outlier_share=self._config.outlier_share,
            point_weights=scan.weights,
        )
        return total / float(scan.weights.sum())
