"""The likelihood of points in the map's density."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from map_helpers import make_mixture, make_particles, nats_with_outliers
from monoloc.geometry import transform
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import uniform_scan
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.map.mixture import GaussianMixture


def test_likelihood_is_the_formula() -> None:
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    scan = uniform_scan(mixture.sample(60, rng).astype(np.float32))
    config = LikelihoodConfig(kind="volume", outlier_share=0.25, noise_sd_m=0.06)
    smoothed = GaussianMixture(mixture.weights, mixture.means, mixture.covariances + 0.06**2 * np.eye(3))
    expected = []
    for pose, scale in zip(poses, log_scale, strict=True):
        density = smoothed.log_density(transform(pose, np.exp(scale) * scan.points))
        expected.append(nats_with_outliers(density, 0.25, smoothed.volume_m3).mean() + scale)
    result = VolumeLikelihood(mixture, config).mean_log_likelihood(poses, log_scale, scan)
    # The index behind the likelihood is exact to 2 % of density, so 0.02 nats.
    assert np.allclose(result, expected, atol=0.02)


def test_noise_does_not_change_the_best_scale() -> None:
    """Without its factor ``e^s`` the likelihood would favour a scan shrunk by the noise's variance."""
    noise, distance_m = 0.1, 2.0
    wall = GaussianMixture(np.ones(1), np.array([[0.0, 0.0, distance_m]]), np.diag([1.0, 1.0, 1e-6])[None])
    config = LikelihoodConfig(kind="volume", outlier_share=1e-6, noise_sd_m=noise * distance_m)
    depth = distance_m * (1.0 + noise * norm.ppf((np.arange(2000) + 0.5) / 2000))
    scan = uniform_scan(np.column_stack([np.zeros(2000), np.zeros(2000), depth]).astype(np.float32))
    log_scale = np.linspace(-0.05, 0.05, 101)
    values = VolumeLikelihood(wall, config).mean_log_likelihood(np.tile(np.eye(4), (101, 1, 1)), log_scale, scan)
    assert log_scale[np.argmax(values)] == pytest.approx(0.0, abs=0.0015)
    assert log_scale[np.argmax(values - log_scale)] == pytest.approx(-(noise**2), abs=0.0015)
