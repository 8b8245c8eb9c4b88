"""Tempered updates: against the exact posterior, and where a single update leaves one particle."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray, is_rigid, se3_exp, se3_log
from monoloc.particle_filter.estimate import estimate
from monoloc.particle_filter.particles import Particles, normalised, scatter
from monoloc.particle_filter.tempering import tempered_update

COUNT = 500


def prior(seed: int, sd_m: float = 0.5, sd_rad: float = 0.3) -> Particles:
    return scatter(np.eye(4), COUNT, sd_m, sd_rad, 0.1, np.random.default_rng(seed))


class GaussianEvidence:
    """Evidence for one pose with a standard deviation per axis; counts how often it is evaluated."""

    def __init__(self, pose: FloatArray, sd_m: float, sd_rad: float) -> None:
        self.pose, self.sd, self.evaluations = pose, np.repeat([sd_m, sd_rad], 3), 0

    def __call__(self, particles: Particles) -> Particles:
        self.evaluations += 1
        off = se3_log(np.linalg.inv(self.pose) @ particles.poses) / self.sd
        log_weights = normalised(particles.log_weights - 0.5 * np.sum(off**2, axis=1))
        return Particles(particles.poses, particles.log_scale, log_weights)


def test_vague_evidence_is_applied_in_one_stage() -> None:
    rng = np.random.default_rng(0)
    before, particles, vague = rng.bit_generator.state, prior(0), GaussianEvidence(np.eye(4), 1.0, 0.6)
    corrected = tempered_update(particles, vague, rng)
    assert vague.evaluations == 1 and rng.bit_generator.state == before
    np.testing.assert_array_equal(corrected.log_weights, vague(particles).log_weights)
    assert corrected.poses is particles.poses


@pytest.mark.parametrize("seed", range(3))
def test_sharp_evidence_moves_the_particles_to_the_posterior(seed: int) -> None:
    """In six dimensions none of 500 particles lies within the posterior; tempering fills it."""
    pose = se3_exp([0.4, -0.3, 0.5, 0.2, -0.3, 0.1])
    sharp, particles = GaussianEvidence(pose, 0.03, 0.02), prior(seed)
    plain = estimate(sharp(particles))
    corrected = tempered_update(particles, sharp, np.random.default_rng(seed))
    found = estimate(corrected)
    error, plain_error = (
        np.linalg.norm(se3_log(np.linalg.inv(pose) @ each.pose) / sharp.sd) for each in (found, plain)
    )
    assert error < 2.4 and plain_error > 5.0 * error  # in standard deviations of six axes together
    assert np.all(is_rigid(corrected.poses))
    assert corrected.effective_sample_size >= 0.1 * COUNT
    spread = np.sqrt(np.diag(found.covariance))
    assert 0.7 < np.mean(spread / sharp.sd) < 1.4
    assert np.exp(corrected.log_weights).sum() == pytest.approx(1.0)


def test_evidence_for_a_single_particle_gives_finite_weights() -> None:
    def only_the_first(particles: Particles) -> Particles:
        gain = np.full(len(particles), -1e12)
        gain[0] = 0.0
        return Particles(particles.poses, particles.log_scale, normalised(particles.log_weights + gain))

    corrected = tempered_update(prior(0), only_the_first, np.random.default_rng(0))
    assert np.isfinite(corrected.log_weights[0]) and not np.isnan(corrected.log_weights).any()
    assert np.isfinite(corrected.poses).all()
