"""The likelihood of depth along rays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from map_helpers import make_mixture, make_particles
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, se3_exp
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import scan_from_depth, uniform_scan
from monoloc.map.mixture import GaussianMixture
from monoloc.map.numpy_twins import weigh_rays
from monoloc.map.rays import LOG_DEPTH_RANGE
from particle_helpers import scan_ahead
from synthetic_room import CAMERA, SETTINGS, Room, make_path


def test_likelihood_is_the_formula_at_any_error_size() -> None:
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    scan = scan_ahead(mixture, 60, rng)
    config = LikelihoodConfig(outlier_share=0.25, noise_sd_m=0.06, log_depth_sd=0.05)
    likelihood = RayLikelihood(mixture, config)
    for log_depth_sd in (0.05, 0.11):
        expected = weigh_rays(
            poses,
            log_scale,
            scan.points.astype(np.float64),
            None,
            mixture.weights,
            mixture.means,
            mixture.covariances + 0.06**2 * np.eye(3),  # smoothed by the noise
            log_depth_sd,
            0.25,
            LOG_DEPTH_RANGE,
        ) / len(scan)
        result = likelihood.mean_log_likelihood(poses, log_scale, scan, log_depth_sd)
        assert np.allclose(result, expected, atol=1e-4)
        if log_depth_sd == config.log_depth_sd:
            assert np.array_equal(likelihood.mean_log_likelihood(poses, log_scale, scan), result)


@pytest.mark.parametrize("start_s", [0.0, 1.0, 2.5])
def test_likelihood_peaks_at_the_true_pose_and_scale(mixture: GaussianMixture, start_s: float) -> None:
    pose = make_path(1, start_s)[0]
    _, depth = Room().view(pose)
    scan = scan_from_depth(DepthPrediction(depth, CAMERA), 400, np.random.default_rng(0))
    # 15 cm or 5 degrees: farther than the map's grain, nearer than a wrong basin.
    offsets = np.diag(np.repeat([0.15, np.deg2rad(5.0)], 3))
    poses = pose @ se3_exp(np.concatenate([np.zeros((3, 6)), offsets, -offsets]))
    log_scale = np.concatenate([[0.0, 0.1, -0.1], np.zeros(12)])
    values = RayLikelihood(mixture, SETTINGS.likelihood).mean_log_likelihood(poses, log_scale, scan)
    assert np.all(values[1:] < values[0] - 0.01)


def best_log_scale(distance_m: float, noise: float) -> float:
    """Of scans of a wall, whose depth has errors proportional to depth."""
    log_scale = np.linspace(-0.05, 0.05, 101)
    wall = GaussianMixture(np.ones(1), np.array([[0.0, 0.0, distance_m]]), np.diag([1.0, 1.0, 1e-6])[None])
    config = LikelihoodConfig(outlier_share=1e-6, noise_sd_m=0.0, log_depth_sd=noise)
    depth: FloatArray = distance_m * (1.0 + noise * norm.ppf((np.arange(2000) + 0.5) / 2000))
    scan = uniform_scan(np.column_stack([np.zeros(2000), np.zeros(2000), depth]).astype(np.float32))
    values = RayLikelihood(wall, config).mean_log_likelihood(np.tile(np.eye(4), (101, 1, 1)), log_scale, scan)
    return float(log_scale[np.argmax(values)])


@pytest.mark.parametrize("distance_m", [1.0, 4.0])
def test_noise_does_not_change_the_best_scale(distance_m: float) -> None:
    """Errors of 10 % of depth move it by under 1 %, whatever the distance."""
    assert best_log_scale(distance_m, 0.1) == pytest.approx(0.0, abs=0.0015)
