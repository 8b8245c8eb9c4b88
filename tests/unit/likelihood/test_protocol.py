"""Evidence of a scan on the particles, whatever its likelihood; and what holds of both likelihoods."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from map_helpers import make_mixture, make_particles
from monoloc.geometry import FloatArray
from monoloc.likelihood import make_likelihood
from monoloc.likelihood.protocol import (
    LikelihoodConfig,
    ScanLikelihood,
    best_over_scales,
    weigh_corners,
    weigh_depth_image,
)
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, uniform_scan
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.particle_filter.particles import Particles, normalised
from particle_helpers import particles_at, scan_ahead

MIXTURE = make_mixture(30)
LIKELIHOODS = [LikelihoodConfig(kind="ray"), LikelihoodConfig(kind="volume")]


@pytest.fixture
def scan() -> Scan:
    return scan_ahead(MIXTURE, 60, np.random.default_rng(0))


def test_likelihood_is_made_by_its_kind() -> None:
    ray, volume = (make_likelihood(MIXTURE, config) for config in LIKELIHOODS)
    assert isinstance(ray, RayLikelihood) and isinstance(volume, VolumeLikelihood)


@pytest.mark.parametrize("config", LIKELIHOODS, ids=lambda config: config.kind)
def test_mean_log_likelihood_is_the_weighted_mean_over_points(config: LikelihoodConfig, scan: Scan) -> None:
    rng = np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    weights = rng.uniform(0.5, 2.0, len(scan)).astype(np.float32)
    likelihood = make_likelihood(MIXTURE, config)
    single = [likelihood.mean_log_likelihood(poses, log_scale, uniform_scan(point[None])) for point in scan.points]
    weighted = likelihood.mean_log_likelihood(poses, log_scale, Scan(scan.points, weights))
    assert np.allclose(weighted, np.average(single, axis=0, weights=weights), atol=1e-4)


class _Recorder:
    """A likelihood of its own: minus the particle's x, whatever the scan; notes the error size it is given."""

    def __init__(self) -> None:
        self.log_depth_sds: list[float | None] = []

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        self.log_depth_sds.append(log_depth_sd)
        return -poses[:, 0, 3]


@pytest.mark.parametrize(
    ("weigh", "count_setting", "sd_setting"),
    [
        (weigh_depth_image, "effective_points", "log_depth_sd"),
        (weigh_corners, "effective_corners", "corner_log_depth_sd"),
    ],
)
def test_log_weights_gain_the_mean_times_the_effective_points(
    weigh: Any, count_setting: str, sd_setting: str, scan: Scan
) -> None:
    """As many as the settings say, but no more than there are."""
    rng = np.random.default_rng(0)
    poses, log_scale = make_particles(50, rng)
    particles = Particles(poses, log_scale, normalised(rng.normal(size=50)))
    for effective, counted in ((5.0, 5.0), (10.0, 10.0), (1000.0, 60.0)):
        likelihood = _Recorder()
        config = LikelihoodConfig(**{count_setting: effective, sd_setting: 0.09})
        after = weigh(particles, scan, likelihood, config)
        assert after.weights.sum() == pytest.approx(1.0)
        assert after.poses is poses and after.log_scale is log_scale
        gain = after.log_weights - particles.log_weights
        assert np.allclose(gain - gain[0], -counted * (poses[:, 0, 3] - poses[0, 0, 3]))
        assert likelihood.log_depth_sds == [0.09]


@pytest.mark.parametrize("config", LIKELIHOODS, ids=lambda config: config.kind)
def test_more_points_of_one_image_give_no_more_evidence(config: LikelihoodConfig, scan: Scan) -> None:
    particles = particles_at(make_particles(50, np.random.default_rng(0))[0])
    config = config.model_copy(update={"effective_points": 10.0})
    likelihood = make_likelihood(MIXTURE, config)
    once, thrice = (
        weigh_depth_image(particles, uniform_scan(np.tile(scan.points, (n, 1))), likelihood, config) for n in (1, 3)
    )
    assert np.allclose(once.log_weights, thrice.log_weights, atol=1e-6)
    assert np.ptp(once.log_weights) > 0.1


@pytest.mark.parametrize("weigh", [weigh_depth_image, weigh_corners])
def test_a_share_of_the_evidence_counts(weigh: Any, scan: Scan) -> None:
    """Four frames of a fast camera, each with a quarter, say as much as one."""
    particles = particles_at(make_particles(50, np.random.default_rng(0))[0])
    once, often = weigh(particles, scan, _Recorder(), LikelihoodConfig()), particles
    for _ in range(4):
        often = weigh(often, scan, _Recorder(), LikelihoodConfig(), 0.25)
    np.testing.assert_allclose(often.log_weights, once.log_weights, atol=1e-9)
    assert weigh(particles, scan, _Recorder(), LikelihoodConfig(), 0.0) is particles


@pytest.mark.parametrize("weigh", [weigh_depth_image, weigh_corners])
def test_without_evidence_particles_stay(weigh: Any, scan: Scan) -> None:
    particles = particles_at(make_particles(5, np.random.default_rng(0))[0])
    likelihood: ScanLikelihood = _Recorder()
    assert weigh(particles, EMPTY_SCAN, likelihood, LikelihoodConfig()) is particles
    no_evidence = LikelihoodConfig(effective_points=0.0, effective_corners=0.0)
    assert weigh(particles, scan, likelihood, no_evidence) is particles


def test_settings_are_checked() -> None:
    with pytest.raises(ValueError, match="kind"):
        LikelihoodConfig(kind="area")
    with pytest.raises(ValueError, match="log_depth_sd"):
        LikelihoodConfig(log_depth_sd=0.0)


class _Own:
    def __init__(self, values: FloatArray) -> None:
        self._values = values

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        return self._values


@pytest.mark.parametrize(
    ("values", "found"),
    [
        (np.array(0.0), r"have shape \(20,\), got \(\)"),
        (np.zeros((20, 60)), r"have shape \(20,\), got \(20, 60\)"),
        (np.full(20, -np.inf), "be finite, got 20 values that are not"),
        (np.full(20, np.nan), "be finite, got 20 values that are not"),
    ],
)
def test_likelihood_of_ones_own_must_give_a_finite_value_a_particle(
    values: FloatArray, found: str, scan: Scan
) -> None:
    particles = Particles(*make_particles(20, np.random.default_rng(0)), normalised(np.zeros(20)))
    with pytest.raises(ValueError, match=f"^what mean_log_likelihood returns must {found}"):
        weigh_depth_image(particles, scan, _Own(values), LikelihoodConfig())
    with pytest.raises(ValueError, match=f"^what mean_log_likelihood returns must {found}"):
        best_over_scales(_Own(values), particles.poses[0], scan, np.zeros(20))
