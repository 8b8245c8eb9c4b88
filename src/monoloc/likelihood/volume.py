"""Likelihood of a point's position in the map's density, for depth whose error is equal in all directions."""

from __future__ import annotations

from monoloc.geometry import FloatArray
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import Scan
from monoloc.map.mixture import GaussianMixture


class VolumeLikelihood:
    """``prod_p e^s ((1 - eps) M(T e^s x_p) + eps / V)`` under a map.

    The observation is depth as predicted. The density of the depth that it stands for is stretched by ``e^s``;
    without that factor the likelihood favours particles that shrink the scan.
    """

    def __init__(self, mixture: GaussianMixture, config: LikelihoodConfig) -> None:
        smoothed = mixture.smoothed(config.noise_sd_m)
        self._config = config
        self._volume_m3 = smoothed.volume_m3
        floor = config.outlier_share / (1.0 - config.outlier_share) / self._volume_m3
        self._index = smoothed.index(floor_density=floor)

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        """As :meth:`monoloc.likelihood.protocol.ScanLikelihood.mean_log_likelihood`; ``log_depth_sd`` is not used."""
        total = self._index.weigh(
            poses,
            log_scale,
            scan.points,
            outlier_share=self._config.outlier_share,
            volume_m3=self._volume_m3,
            point_weights=scan.weights,
        )
        return total / float(scan.weights.sum()) + log_scale
