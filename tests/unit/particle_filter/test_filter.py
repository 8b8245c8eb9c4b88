"""The particle filter's two steps."""

from __future__ import annotations

import numpy as np

from map_helpers import motion_of
from monoloc.geometry import invert, se3_exp, se3_log
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.filter import ParticleFilter
from monoloc.particle_filter.motion_model import MotionConfig, predict
from monoloc.particle_filter.particles import Particles, normalised, scatter

START = scatter(np.eye(4), 200, 0.1, 0.05, 0.05, np.random.default_rng(0))
NOISE = MotionConfig()


def make_filter() -> ParticleFilter:
    return ParticleFilter(START, NOISE, 0.05, 0.5, np.random.default_rng(1))


def test_prediction_is_the_motion_models() -> None:
    motion = motion_of(se3_exp([0.1, 0.0, 0.0, 0.0, 0.2, 0.0]))
    particle_filter = make_filter()
    predicted = particle_filter.predict(motion, 0.1, 0.3)
    expected = predict(START, motion, 0.1, 0.3, 0.05, NOISE, np.random.default_rng(1))
    np.testing.assert_array_equal(predicted.poses, expected.poses)
    np.testing.assert_array_equal(predicted.log_scale, expected.log_scale)
    assert particle_filter.particles is predicted


def test_update_estimates_before_it_resamples() -> None:
    """The mean of the resampled particles is noisier."""
    weighed = Particles(START.poses, START.log_scale, normalised(-2000.0 * START.poses[:, 0, 3] ** 2))
    particle_filter = make_filter()
    belief = particle_filter.update(START, lambda particles: weighed if particles is START else particles)
    np.testing.assert_array_equal(belief.pose, estimate(weighed).pose)
    np.testing.assert_array_equal(belief.covariance, estimate(weighed).covariance)
    assert weighed.effective_sample_size < 0.5 * len(START)
    np.testing.assert_allclose(particle_filter.particles.weights, 1.0 / len(START))


def test_particles_drawn_anew_are_distributed_as_a_pose_and_keep_their_scales() -> None:
    rng = np.random.default_rng(2)
    factor = 0.1 * rng.normal(size=(6, 6))
    around = Estimate(se3_exp(rng.normal(size=6)), factor @ factor.T, 0.0)
    particle_filter = ParticleFilter(
        scatter(np.eye(4), 20000, 0.1, 0.05, 0.05, rng), NOISE, 0.05, 0.5, np.random.default_rng(1)
    )
    log_scale = particle_filter.particles.log_scale
    particle_filter.redraw(around)
    drawn = particle_filter.particles
    np.testing.assert_array_equal(drawn.log_scale, log_scale)
    np.testing.assert_allclose(drawn.weights, 1.0 / 20000)
    twists = se3_log(invert(around.pose) @ drawn.poses)
    np.testing.assert_allclose(np.cov(twists.T), around.covariance, atol=0.03 * np.trace(around.covariance))
    np.testing.assert_allclose(twists.mean(axis=0), 0.0, atol=0.01)
