"""The motion model: odometry, random walk, and the depth's scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from map_helpers import motion_of
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, se3_log, so3_exp
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd, predict
from monoloc.particle_filter.particles import scatter
from particle_helpers import particles_at

POSE = make_pose(so3_exp([0.4, -1.1, 0.3]), [1.0, -2.0, 0.5])
NO_NOISE = MotionConfig(translation_sd_m=1e-9, translation_sd_ratio=0.0, rotation_sd_rad=1e-9, rotation_sd_ratio=0.0)


def test_odometry_moves_each_particle_in_its_own_frame_and_scale() -> None:
    rng = np.random.default_rng(1)
    before = particles_at(se3_exp(rng.normal(size=(6, 6))), log_scale=rng.normal(0.0, 0.3, 6), weights=[1 / 6] * 6)
    delta = make_pose(so3_exp([0.1, -0.3, 0.2]), [0.4, 0.1, -0.2])
    after = predict(before, motion_of(delta), 0.1, 0.0, 0.05, NO_NOISE, rng)
    for old, scale, new in zip(before.poses, before.log_scale, after.poses, strict=True):
        assert np.allclose(new[:3, :3], old[:3, :3] @ delta[:3, :3], atol=1e-6)
        assert np.allclose(new[:3, 3], old[:3, 3] + np.exp(scale) * old[:3, :3] @ delta[:3, 3], atol=1e-6)
    assert np.all(after.log_weights == before.log_weights)


def test_odometry_noise_grows_with_the_motion() -> None:
    config = MotionConfig(
        translation_sd_m=0.01, translation_sd_ratio=0.2, rotation_sd_rad=0.005, rotation_sd_ratio=0.1
    )
    spreads = []
    for delta in (np.eye(4), make_pose(so3_exp([0.0, 0.5, 0.0]), [1.0, 0.0, 0.0])):
        particles = particles_at(np.tile(POSE, (4000, 1, 1)))
        after = predict(particles, motion_of(delta), 1.0 / 15.0, 0.0, 0.0, config, np.random.default_rng(0))
        spreads.append(se3_log(invert(POSE @ delta) @ after.poses).std(axis=0))
    assert np.allclose(spreads[0], [0.01] * 3 + [0.005] * 3, rtol=0.06)
    assert np.allclose(spreads[1], [np.hypot(0.01, 0.2)] * 3 + [np.hypot(0.005, 0.05)] * 3, rtol=0.06)


def test_odometry_by_few_corners_states_more_noise_and_another_sensor_does_not() -> None:
    delta, config = make_pose(so3_exp([0.0, 0.1, 0.0]), [0.1, 0.0, 0.0]), MotionConfig()
    many, few = (motion_sd(Motion(delta, inliers=inliers), 0.1, 0.0, config) for inliers in (200, 50))
    np.testing.assert_allclose(few, 8.0 * many)
    np.testing.assert_array_equal(motion_sd(Motion(delta, inliers=300), 0.1, 0.0, config), many)
    metric = replace(Motion.metric(delta, 0.02, 0.004), inliers=50)  # as where corners are tracked beside it
    np.testing.assert_allclose(motion_sd(metric, 0.1, 0.0, config), [0.02] * 3 + [0.004] * 3)


def test_metric_motion_has_no_depth_scale_and_its_own_noise() -> None:
    delta, scale = make_pose(so3_exp([0.1, -0.3, 0.2]), [0.4, 0.1, -0.2]), np.full(4000, 0.3)
    particles = particles_at(np.tile(POSE, (4000, 1, 1)), log_scale=scale, weights=[1 / 4000] * 4000)
    after = predict(particles, Motion.metric(delta, 0.02, 0.004), 0.1, 0.0, 0.0, NO_NOISE, np.random.default_rng(0))
    twists = se3_log(invert(POSE @ delta) @ after.poses)
    assert np.allclose(twists.std(axis=0), [0.02] * 3 + [0.004] * 3, rtol=0.06)
    assert np.all(np.abs(twists.mean(axis=0)) < 0.1 * twists.std(axis=0))


def test_rotation_alone_turns_the_particles_and_leaves_their_velocity_unknown() -> None:
    turn = so3_exp([0.0, 0.4, 0.0])
    config = MotionConfig(speed_sd_m_s=0.5, turn_sd_rad_s=0.3)
    sd = motion_sd(Motion.rotation(turn, 0.004), 0.1, 0.2, config)
    assert np.allclose(sd[:3], motion_sd(None, 0.1, 0.2, config)[:3]) and np.allclose(sd[3:], 0.004)
    particles = particles_at(np.tile(POSE, (50, 1, 1)))
    after = predict(particles, Motion.rotation(turn, 1e-9), 0.0, 0.0, 0.0, config, np.random.default_rng(0))
    assert np.allclose(after.poses, POSE @ make_pose(turn, np.zeros(3)), atol=1e-6)


def test_random_walk_spreads_with_elapsed_time() -> None:
    config = MotionConfig(speed_sd_m_s=0.5, turn_sd_rad_s=0.3)

    def spread(elapsed_s: float) -> FloatArray:
        particles = particles_at(np.tile(POSE, (4000, 1, 1)))
        after = predict(particles, None, elapsed_s, 0.0, 0.05, config, np.random.default_rng(0))
        return se3_log(invert(POSE) @ after.poses).std(axis=0)

    assert np.allclose(spread(0.0), 0.0)
    assert np.allclose(spread(0.1), [0.05] * 3 + [0.03] * 3, rtol=0.06)
    assert np.all(spread(0.2) > 1.3 * spread(0.1))


@pytest.mark.parametrize("speed_m_s", [0.0, 0.3, 2.0], ids=["hover", "slow", "fast"])
def test_odometry_noise_of_a_second_is_no_larger_for_a_fast_camera(speed_m_s: float) -> None:
    variances = []
    for elapsed_s in (0.06, 0.03, 0.015):
        twist = elapsed_s * np.array([speed_m_s, 0.0, 0.0, 0.0, 0.5 * speed_m_s, 0.0])
        variances.append(motion_sd(motion_of(se3_exp(twist)), elapsed_s, 0.0, MotionConfig()) ** 2 / elapsed_s)
    np.testing.assert_allclose(variances, variances[:1] * 3, rtol=1e-3)  # a chord is a little shorter than its arc


@pytest.mark.parametrize("rate_hz", [1, 10, 30])
def test_spread_after_a_second_without_update_does_not_depend_on_the_frame_rate(rate_hz: int) -> None:
    config = MotionConfig(speed_sd_m_s=0.5, turn_sd_rad_s=0.3)
    elapsed_s = 1.0 / rate_hz
    variances = [motion_sd(None, elapsed_s, index * elapsed_s, config) ** 2 for index in range(rate_hz)]
    np.testing.assert_allclose(np.sqrt(np.sum(variances, axis=0)), [0.5] * 3 + [0.3] * 3)


@pytest.mark.parametrize("elapsed_s", [1 / 15, 0.5])
@pytest.mark.parametrize("motion", [None, motion_of(np.eye(4))])
def test_log_scale_has_a_constant_spread_and_the_given_correlation(elapsed_s: float, motion: Motion | None) -> None:
    config = MotionConfig(log_scale_correlation=0.6)
    rng = np.random.default_rng(0)
    particles = scatter(np.eye(4), 20000, 0.0, 0.0, 0.1, rng)
    start = particles.log_scale
    for _ in range(round(1.0 / elapsed_s)):
        particles = predict(particles, motion, elapsed_s, 0.0, 0.1, config, rng)
    # One second on, whatever the frame rate; the standard errors are 0.5 % and 0.006.
    assert particles.log_scale.std() == pytest.approx(0.1, rel=0.025)
    assert np.corrcoef(start, particles.log_scale)[0, 1] == pytest.approx(0.6, abs=0.03)


def test_log_scale_returns_to_its_prior() -> None:
    rng = np.random.default_rng(0)
    particles = particles_at(np.tile(np.eye(4), (5000, 1, 1)), log_scale=np.full(5000, 0.5))
    for _ in range(30):
        particles = predict(particles, None, 1.0, 0.0, 0.1, MotionConfig(log_scale_correlation=0.6), rng)
    assert abs(particles.log_scale.mean()) < 0.01
    assert particles.log_scale.std() == pytest.approx(0.1, rel=0.06)
