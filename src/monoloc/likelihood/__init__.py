"""Likelihoods of a scan under the map."""

from __future__ import annotations

from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.map.mixture import GaussianMixture


def make_likelihood(mixture: GaussianMixture, config: LikelihoodConfig) -> ScanLikelihood:
    """The likelihood of ``config.kind`` under a map."""
    return RayLikelihood(mixture, config) if config.kind == "ray" else VolumeLikelihood(mixture, config)
