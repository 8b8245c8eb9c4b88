"""The filter's parts: particles, motion, scan, weighing, resampling, estimate, health."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from monoloc.likelihood.scan_likelihood import LikelihoodConfig, Measurement
from scipy.stats import norm

from map_helpers import make_mixture, make_particles, motion_of, nats_with_outliers
from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import invert, make_pose, se3_exp, se3_log, so3_exp, transform
from monoloc.likelihood.scan import Scan, scan_from_corners, scan_from_depth, uniform_scan
from monoloc.map.mixture import GaussianMixture
from monoloc.map.numpy_twins import weigh_rays
from monoloc.map.rays import LOG_DEPTH_RANGE
from monoloc.odometry.visual import Motion
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd, predict
from monoloc.particle_filter.particles import Particles, normalised, scatter
from monoloc.particle_filter.resampling import resample, systematic_indices
from monoloc.supervision.state import LikelihoodThresholds, judge
from synthetic_room import CAMERA, SETTINGS, Room, make_path

POSE = make_pose(so3_exp([0.4, -1.1, 0.3]), [1.0, -2.0, 0.5])
QUIET = MotionConfig(translation_sd_m=1e-9, translation_sd_ratio=0.0, rotation_sd_rad=1e-9, rotation_sd_ratio=0.0)


def particles_at(poses, log_scale=None, weights=None) -> Particles:
    count = len(poses)
    return Particles(
        poses=np.asarray(poses),
        log_scale=np.zeros(count) if log_scale is None else np.asarray(log_scale, dtype=np.float64),
        log_weights=np.full(count, -np.log(count)) if weights is None else np.log(np.asarray(weights)),
    )


def scan_ahead(mixture: GaussianMixture, count: int, rng: np.random.Generator) -> Scan:
    """Points of the mixture, those that a camera at the origin can see: at least 20 cm before it."""
    points = mixture.sample(8 * count, rng)
    return uniform_scan(points[points[:, 2] > 0.2][:count].astype(np.float32))


# Weights as a filter has them: of very different sizes, some of them zero.
weight_vectors = (
    arrays(np.float64, st.integers(1, 60), elements=st.floats(-40.0, 0.0))
    .map(np.exp)
    .flatmap(lambda w: arrays(np.bool_, len(w)).map(lambda zero, w=w: np.where(zero, 0.0, w)))
    .filter(lambda w: w.sum() > 0.0)
    .map(lambda w: w / w.sum())
)


# --- Particles ---


def test_scatter_has_the_spread_asked_for():
    particles = scatter(POSE, 20000, 0.2, 0.1, 0.07, np.random.default_rng(0))
    twists = se3_log(invert(POSE) @ particles.poses)
    # The standard error of a standard deviation is sd / sqrt(2 N), here 0.5 %.
    assert np.allclose(twists.std(axis=0), [0.2] * 3 + [0.1] * 3, rtol=0.025)
    assert np.all(np.abs(twists.mean(axis=0)) < 5 * twists.std(axis=0) / np.sqrt(20000))
    correlation = np.corrcoef(np.column_stack([twists, particles.log_scale]).T) - np.eye(7)
    assert np.abs(correlation).max() < 0.04
    assert particles.log_scale.std() == pytest.approx(0.07, rel=0.025)
    assert np.allclose(particles.weights, 1.0 / 20000)


def test_scatter_without_spread_is_the_pose():
    particles = scatter(POSE, 5, 0.0, 0.0, 0.0, np.random.default_rng(0))
    assert np.allclose(particles.poses, POSE)
    assert np.all(particles.log_scale == 0.0)


@given(arrays(np.float64, st.integers(1, 50), elements=st.floats(-1e5, 1e5)))
def test_normalised_sums_to_one_and_keeps_ratios(log_weights):
    result = normalised(log_weights)
    assert np.exp(result).sum() == pytest.approx(1.0)
    assert np.allclose(result - result[0], log_weights - log_weights[0], atol=1e-9)


def test_normalised_takes_particles_that_are_impossible():
    assert np.allclose(np.exp(normalised(np.array([-np.inf, 0.0, np.log(3.0)]))), [0.0, 0.25, 0.75])


@given(weight_vectors)
def test_effective_sample_size_lies_between_one_and_the_count(weights):
    with np.errstate(divide="ignore"):
        particles = particles_at(np.tile(np.eye(4), (len(weights), 1, 1)), weights=weights)
    assert 1.0 - 1e-9 <= particles.effective_sample_size <= len(weights) * (1.0 + 1e-9)


@pytest.mark.parametrize("alike", [1, 4, 10])
def test_effective_sample_size_counts_equal_weights(alike):
    weights = np.where(np.arange(10) < alike, 1.0 / alike, 1e-300)
    assert particles_at(np.tile(np.eye(4), (10, 1, 1)), weights=weights).effective_sample_size == pytest.approx(alike)


# --- Resampling ---


@given(weight_vectors, st.integers(0, 2**32 - 1))
def test_systematic_resampling_draws_floor_or_ceil(weights, seed):
    indices = systematic_indices(weights, np.random.default_rng(seed))
    drawn = np.bincount(indices, minlength=len(weights))
    expected = len(weights) * weights
    assert len(indices) == len(weights) == len(drawn)
    assert np.all(drawn >= np.floor(expected - 1e-9))
    assert np.all(drawn <= np.ceil(expected + 1e-9) * (weights > 0.0))


class _Largest(np.random.Generator):
    """A generator whose uniform number is the largest below 1."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def uniform(self, *_, **__):
        return np.nextafter(1.0, 0.0)


@pytest.mark.parametrize("weights", [np.full(10, 0.1), np.array([0.5, 0.5, 0.0]), np.full(500, 1 / 500)])
def test_systematic_resampling_at_the_end_of_the_interval(weights):
    # (u + N - 1) / N rounds to 1 here, which lies beyond the sum of all weights.
    indices = systematic_indices(weights, _Largest())
    assert indices.max() < len(weights)
    assert np.all(weights[indices] > 0.0)


def test_systematic_resampling_is_unbiased():
    weights = np.array([0.35, 0.02, 0.0, 0.11, 0.3, 0.07, 0.15])
    rng = np.random.default_rng(0)
    drawn = np.mean([np.bincount(systematic_indices(weights, rng), minlength=7) for _ in range(4000)], axis=0)
    # A count is one of two neighbours, so its standard deviation is at most 1/2: five standard errors are 0.04.
    assert np.allclose(drawn, 7 * weights, atol=0.04)


def test_resample_waits_until_the_weights_are_uneven():
    poses = se3_exp(np.random.default_rng(0).normal(size=(4, 6)))
    even = particles_at(poses, weights=[0.3, 0.2, 0.3, 0.2])
    assert resample(even, 0.5, np.random.default_rng(0)) is even
    uneven = particles_at(poses, log_scale=[0.0, 0.1, 0.2, 0.3], weights=[0.01, 0.01, 0.97, 0.01])
    result = resample(uneven, 0.5, np.random.default_rng(0))
    assert np.allclose(result.weights, 0.25)
    # Pose and scale stay together: nearly all are copies of the third.
    chosen = np.round(10 * result.log_scale).astype(int)
    assert np.all(result.poses == poses[chosen])
    assert np.count_nonzero(chosen == 2) >= 3


# --- Motion ---


def test_odometry_moves_each_particle_in_its_own_frame_and_scale():
    rng = np.random.default_rng(1)
    before = particles_at(se3_exp(rng.normal(size=(6, 6))), log_scale=rng.normal(0.0, 0.3, 6), weights=[1 / 6] * 6)
    delta = make_pose(so3_exp([0.1, -0.3, 0.2]), [0.4, 0.1, -0.2])
    after = predict(before, motion_of(delta), 0.1, 0.0, 0.05, QUIET, rng)
    for old, scale, new in zip(before.poses, before.log_scale, after.poses, strict=True):
        assert np.allclose(new[:3, :3], old[:3, :3] @ delta[:3, :3], atol=1e-6)
        assert np.allclose(new[:3, 3], old[:3, 3] + np.exp(scale) * old[:3, :3] @ delta[:3, 3], atol=1e-6)
    assert np.all(after.log_weights == before.log_weights)


def test_odometry_noise_grows_with_the_motion():
    config = MotionConfig(
        translation_sd_m=0.01, translation_sd_ratio=0.2, rotation_sd_rad=0.005, rotation_sd_ratio=0.1
    )
    spreads = []
    for delta in (np.eye(4), make_pose(so3_exp([0.0, 0.5, 0.0]), [1.0, 0.0, 0.0])):
        particles = particles_at(np.tile(POSE, (4000, 1, 1)))
        after = predict(particles, motion_of(delta), 0.1, 0.0, 0.0, config, np.random.default_rng(0))
        spreads.append(se3_log(invert(POSE @ delta) @ after.poses).std(axis=0))
    assert np.allclose(spreads[0], [0.01] * 3 + [0.005] * 3, rtol=0.06)
    assert np.allclose(spreads[1], [np.hypot(0.01, 0.2)] * 3 + [np.hypot(0.005, 0.05)] * 3, rtol=0.06)


def test_random_walk_spreads_with_elapsed_time():
    config = MotionConfig(speed_sd_m_s=0.5, turn_sd_rad_s=0.3)

    def spread(elapsed_s):
        particles = particles_at(np.tile(POSE, (4000, 1, 1)))
        after = predict(particles, None, elapsed_s, 0.0, 0.05, config, np.random.default_rng(0))
        return se3_log(invert(POSE) @ after.poses).std(axis=0)

    assert np.allclose(spread(0.0), 0.0)
    assert np.allclose(spread(0.1), [0.05] * 3 + [0.03] * 3, rtol=0.06)
    assert np.all(spread(0.2) > 1.3 * spread(0.1))


@pytest.mark.parametrize("rate_hz", [1, 10, 30])
def test_a_second_without_a_word_leads_as_far_astray_at_any_rate(rate_hz):
    config = MotionConfig(speed_sd_m_s=0.5, turn_sd_rad_s=0.3)
    elapsed_s = 1.0 / rate_hz
    variances = [motion_sd(None, elapsed_s, index * elapsed_s, config) ** 2 for index in range(rate_hz)]
    np.testing.assert_allclose(np.sqrt(np.sum(variances, axis=0)), [0.5] * 3 + [0.3] * 3)


@pytest.mark.parametrize("elapsed_s", [1 / 30, 0.5])
@pytest.mark.parametrize("motion", [None, motion_of(np.eye(4))])
def test_log_scale_keeps_its_spread_and_forgets_at_the_rate_given(elapsed_s, motion):
    config = MotionConfig(log_scale_correlation=0.6)
    rng = np.random.default_rng(0)
    particles = scatter(np.eye(4), 20000, 0.0, 0.0, 0.1, rng)
    start = particles.log_scale
    steps = round(1.0 / elapsed_s)
    for _ in range(steps):
        particles = predict(particles, motion, elapsed_s, 0.0, 0.1, config, rng)
    # One second on, whatever the frame rate; the standard errors are 0.5 % and 0.006.
    assert particles.log_scale.std() == pytest.approx(0.1, rel=0.025)
    assert np.corrcoef(start, particles.log_scale)[0, 1] == pytest.approx(0.6, abs=0.03)


def test_log_scale_returns_to_its_prior_from_anywhere():
    rng = np.random.default_rng(0)
    particles = particles_at(np.tile(np.eye(4), (5000, 1, 1)), log_scale=np.full(5000, 0.5))
    for _ in range(30):
        particles = predict(particles, None, 1.0, 0.0, 0.1, MotionConfig(log_scale_correlation=0.6), rng)
    assert abs(particles.log_scale.mean()) < 0.01
    assert particles.log_scale.std() == pytest.approx(0.1, rel=0.06)


# --- Estimate ---


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 6)])
@pytest.mark.parametrize("seed", range(3))
def test_estimate_of_symmetric_perturbations_is_the_centre(part, seed):
    twists = np.zeros((8, 6))
    twists[:, part] = np.random.default_rng(seed).normal(0.0, 0.3, (8, 3))
    belief = estimate(particles_at(POSE @ se3_exp(np.concatenate([twists, -twists]))))
    assert np.allclose(belief.pose, POSE, atol=1e-12)


def test_estimate_covariance_is_of_twists_in_the_estimated_camera():
    # The camera's x axis is the world's: a spread along camera x must not appear elsewhere.
    twists = np.zeros((4, 6))
    twists[0, 0], twists[1, 0] = 0.1, -0.1
    twists[2, 4], twists[3, 4] = 0.2, -0.2
    belief = estimate(particles_at(POSE @ se3_exp(twists), weights=[0.4, 0.4, 0.1, 0.1]))
    expected = np.zeros((6, 6))
    expected[0, 0], expected[4, 4] = 0.8 * 0.1**2, 0.2 * 0.2**2
    assert np.allclose(belief.covariance, expected, atol=1e-12)


def test_estimate_covariance_of_many_particles():
    particles = scatter(POSE, 20000, 0.1, 0.05, 0.02, np.random.default_rng(0))
    belief = estimate(particles)
    assert np.allclose(belief.covariance, np.diag([0.01] * 3 + [0.0025] * 3), atol=4e-4)
    offset = se3_log(invert(POSE) @ belief.pose)
    assert np.all(np.abs(offset) < 5 * np.sqrt(np.diag(belief.covariance) / 20000))


def test_estimate_weighs():
    far = make_pose(np.eye(3), [1.0, 0.0, 0.0])
    half = estimate(particles_at([np.eye(4), far], log_scale=[0.0, 0.4]))
    assert np.allclose(half.pose[:3, 3], [0.5, 0.0, 0.0])
    assert half.covariance[0, 0] == pytest.approx(0.25)
    assert half.log_scale == pytest.approx(0.2)
    quarter = estimate(particles_at([np.eye(4), far], log_scale=[0.0, 0.4], weights=[0.75, 0.25]))
    assert np.allclose(quarter.pose[:3, 3], [0.25, 0.0, 0.0])
    assert quarter.covariance[0, 0] == pytest.approx(0.75 * 0.25**2 + 0.25 * 0.75**2)
    assert quarter.log_scale == pytest.approx(0.1)
    turned = estimate(particles_at([np.eye(4), se3_exp([0, 0, 0, 0, 0, 1.0])]))
    assert np.allclose(turned.pose, se3_exp([0, 0, 0, 0, 0, 0.5]))


@given(weight_vectors, st.integers(0, 1000))
def test_estimate_is_rigid_with_a_covariance_that_is_one(weights, seed):
    with np.errstate(divide="ignore"):
        particles = particles_at(
            se3_exp(np.random.default_rng(seed).normal(0.0, 0.4, (len(weights), 6))), weights=weights
        )
    belief = estimate(particles)
    assert np.allclose(belief.pose[:3, :3].T @ belief.pose[:3, :3], np.eye(3))
    assert np.allclose(belief.covariance, belief.covariance.T)
    assert np.linalg.eigvalsh(belief.covariance)[0] > -1e-12


# --- Scan ---


@pytest.fixture(scope="module")
def room() -> Room:
    return Room()


@pytest.fixture(scope="module")
def pose():
    return make_path(1, start_s=1.0)[0]


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.05, 0.001, -0.002, 0.01)])
def test_scan_points_lie_on_what_is_seen(room, pose, distortion):
    camera = Camera(160, 128, 136.0, 136.0, 79.5, 63.5, distortion)
    _, depth = room.view(pose, camera)
    scan = scan_from_depth(DepthPrediction(depth, camera), 200, np.random.default_rng(0))
    assert scan.points.shape == (200, 3) and scan.points.dtype == np.float32
    assert np.array_equal(scan.weights, np.ones(200, dtype=np.float32))
    pixels = np.round(camera.project(scan.points)).astype(int)
    assert np.allclose(camera.project(scan.points), pixels, atol=1e-3)
    assert np.allclose(scan.points[:, 2], depth[pixels[:, 1], pixels[:, 0]])
    assert not at_discontinuity(depth, 0.15)[pixels[:, 1], pixels[:, 0]].any()
    assert room.distance_m(transform(pose, scan.points)).max() < 1e-5
    assert len(np.unique(pixels, axis=0)) == 200
    # Even over the image: every quarter has about its share.
    quarters = np.bincount((pixels[:, 0] >= 80) + 2 * (pixels[:, 1] >= 64), minlength=4)
    assert quarters.min() > 30


def test_scan_differs_from_frame_to_frame_but_not_from_seed_to_seed(room, pose):
    _, depth = room.view(pose)
    rng = np.random.default_rng(3)
    first, second = (scan_from_depth(DepthPrediction(depth, CAMERA), 100, rng) for _ in range(2))
    again = scan_from_depth(DepthPrediction(depth, CAMERA), 100, np.random.default_rng(3))
    assert np.array_equal(first.points, again.points)
    assert not np.array_equal(first.points, second.points)


def test_scan_leaves_out_what_is_far_or_missing():
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    depth[:, :10] = 0.0
    depth[:, 30:] = 9.0
    scan = scan_from_depth(DepthPrediction(depth, camera), 10_000, np.random.default_rng(0), max_depth_m=8.0)
    columns = np.round(camera.project(scan.points)[:, 0]).astype(int)
    # The column beside the step from 2 to 9 m is an edge; that beside missing depth is none.
    assert sorted(set(columns)) == list(range(10, 29))
    assert len(scan) == 19 * 30
    assert np.all(scan.points[:, 2] == 2.0)


def test_scan_of_an_edge_leaves_both_sides_out():
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    depth[10:20, 10:20] = 1.0
    scan = scan_from_depth(DepthPrediction(depth, camera), 10_000, np.random.default_rng(0), depth_jump=0.5)
    pixels = np.round(camera.project(scan.points)).astype(int)
    taken = np.zeros((30, 40), dtype=bool)
    taken[pixels[:, 1], pixels[:, 0]] = True
    assert not taken[9, 10:20].any() and not taken[10, 10:20].any()
    assert not taken[10:20, 19].any() and not taken[10:20, 20].any()
    assert taken[11:19, 11:19].all() and taken[:9].all() and taken[21:].all()


@pytest.mark.parametrize("value", [0.0, 20.0])
def test_scan_of_nothing_is_empty(value):
    depth = np.full((30, 40), value, dtype=np.float32)
    scan = scan_from_depth(
        DepthPrediction(depth, Camera(40, 30, 30.0, 30.0, 19.5, 14.5)), 50, np.random.default_rng(0)
    )
    assert scan.points.shape == (0, 3) and scan.points.dtype == np.float32 and len(scan) == 0


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_points_that_are_said_to_be_wrong_count_less(power):
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    log_error = np.log(np.where(np.arange(40) < 20, 0.1, 0.15)).astype(np.float32) * np.ones((30, 1), np.float32)
    log_error[0, 0], log_error[0, 39] = -20.0, 20.0
    stated = DepthPrediction(depth, camera, log_error)
    scan = scan_from_depth(stated, 10_000, np.random.default_rng(0), power)
    columns, rows = np.round(camera.project(scan.points)).astype(int).T
    sure = scan.weights[(columns < 20) & (rows > 0)]
    unsure = scan.weights[(columns >= 20) & (rows > 0)]
    assert scan.weights.mean() == pytest.approx(1.0, rel=1e-5) and scan.weights.dtype == np.float32
    assert np.ptp(sure) == 0.0 and sure[0] / unsure[0] == pytest.approx(1.5**power, rel=1e-3)
    # However sure of itself the network is, or unsure, one point neither decides nor vanishes.
    assert scan.weights.max() / scan.weights.min() == pytest.approx(16.0, rel=1e-3)
    alike = scan_from_depth(stated, 10_000, np.random.default_rng(0), 0.0)
    assert np.array_equal(alike.points, scan.points) and np.all(alike.weights == 1.0)


@pytest.mark.parametrize("likelihood", ["ray", "volume"])
def test_the_likelihood_weighs_points(likelihood):
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    points = scan_ahead(mixture, 60, rng).points
    weights = rng.uniform(0.5, 2.0, len(points)).astype(np.float32)
    measurement = Measurement(mixture, LikelihoodConfig(likelihood=likelihood))
    single = [measurement.mean_log_likelihood(poses, log_scale, uniform_scan(point[None])) for point in points]
    weighed = measurement.mean_log_likelihood(poses, log_scale, Scan(points, weights))
    assert np.allclose(weighed, np.average(single, axis=0, weights=weights), atol=1e-4)


def test_scan_from_corners_takes_those_that_parallax_has_measured():
    # Of the others, one is in doubt, one too far, one behind the camera, and one on its plane.
    points = np.array(
        [[0.1, 0.2, 2.0], [0.3, 0.1, 3.0], [0.5, 0.0, 9.0], [0.0, 0.0, 4.0], [0.1, 0.0, -2.0], [0.1, 0, 0]]
    )
    motion = Motion(np.eye(4), 6, points, np.array([0.02, 0.3, 0.02, 0.05, 0.02, 0.02]))
    scan = scan_from_corners(motion, doubt=0.1, max_depth_m=8.0)
    assert scan.points.dtype == np.float32
    assert np.allclose(scan.points, points[[0, 3]])
    assert len(scan_from_corners(motion, doubt=0.01)) == 0


# --- Weighing ---


@pytest.mark.parametrize("start_s", [0.0, 1.0, 2.5])
def test_likelihood_peaks_at_the_true_pose(room, mixture, start_s):
    pose = make_path(1, start_s)[0]
    _, depth = room.view(pose)
    scan = scan_from_depth(DepthPrediction(depth, CAMERA), 400, np.random.default_rng(0))
    measurement = Measurement(mixture, SETTINGS.measurement)

    def fit(twist, log_scale=0.0):
        return measurement.mean_log_likelihood((pose @ se3_exp(twist))[None], np.array([log_scale]), scan)[0]

    best = fit(np.zeros(6))
    for axis in range(6):
        for sign in (-1.0, 1.0):
            twist = np.zeros(6)
            # 15 cm or 5 degrees: farther than the map's grain, nearer than a wrong basin.
            twist[axis] = sign * (0.15 if axis < 3 else np.deg2rad(5.0))
            assert fit(twist) < best - 0.01, (axis, sign)
    assert fit(np.zeros(6), 0.1) < best - 0.01
    assert fit(np.zeros(6), -0.1) < best - 0.01


def test_ray_likelihood_is_the_formula():
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    scan = scan_ahead(mixture, 60, rng)
    config = LikelihoodConfig(outlier_share=0.25, noise_sd_m=0.06, log_depth_sd=0.05)
    measurement = Measurement(mixture, config)
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
        result = measurement.mean_log_likelihood(poses, log_scale, scan, log_depth_sd)
        assert np.allclose(result, expected, atol=1e-4)
        if log_depth_sd == config.log_depth_sd:
            assert np.array_equal(measurement.mean_log_likelihood(poses, log_scale, scan), result)


def test_volume_likelihood_is_the_formula():
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(20, rng)
    scan = uniform_scan(mixture.sample(60, rng).astype(np.float32))
    config = LikelihoodConfig(likelihood="volume", outlier_share=0.25, noise_sd_m=0.06)
    smoothed = type(mixture)(mixture.weights, mixture.means, mixture.covariances + 0.06**2 * np.eye(3))
    expected = []
    for pose, scale in zip(poses, log_scale, strict=True):
        density = smoothed.log_density(transform(pose, np.exp(scale) * scan.points))
        expected.append(nats_with_outliers(density, 0.25, smoothed.volume_m3).mean() + scale)
    result = Measurement(mixture, config).mean_log_likelihood(poses, log_scale, scan)
    # The index behind the likelihood answers for 2 % of density, so 0.02 nats.
    assert np.allclose(result, expected, atol=0.02)


def test_noise_does_not_shrink_the_scan_in_the_volume():
    """The scale that fits noisy depth best is the true one; without its factor it is less by the noise's variance."""
    noise, distance = 0.1, 2.0
    wall = GaussianMixture(np.ones(1), np.array([[0.0, 0.0, distance]]), np.diag([1.0, 1.0, 1e-6])[None])
    config = LikelihoodConfig(likelihood="volume", outlier_share=1e-6, noise_sd_m=noise * distance)
    depth = distance * (1.0 + noise * norm.ppf((np.arange(2000) + 0.5) / 2000))
    scan = uniform_scan(np.column_stack([np.zeros(2000), np.zeros(2000), depth]).astype(np.float32))
    log_scale = np.linspace(-0.05, 0.05, 101)
    fit = Measurement(wall, config).mean_log_likelihood(np.repeat(np.eye(4)[None], 101, axis=0), log_scale, scan)
    assert log_scale[np.argmax(fit)] == pytest.approx(0.0, abs=0.0015)
    assert log_scale[np.argmax(fit - log_scale)] == pytest.approx(-(noise**2), abs=0.0015)


def test_noise_does_not_shrink_the_scan_along_rays():
    """Nor does it stretch it: errors of 10 % of depth move the best scale by under 1 %, whatever the distance."""
    noise = 0.1
    log_scale = np.linspace(-0.05, 0.05, 101)
    for distance in (1.0, 2.0, 4.0):
        wall = GaussianMixture(np.ones(1), np.array([[0.0, 0.0, distance]]), np.diag([1.0, 1.0, 1e-6])[None])
        config = LikelihoodConfig(outlier_share=1e-6, noise_sd_m=0.0, log_depth_sd=noise)
        depth = distance * (1.0 + noise * norm.ppf((np.arange(2000) + 0.5) / 2000))
        scan = uniform_scan(np.column_stack([np.zeros(2000), np.zeros(2000), depth]).astype(np.float32))
        fit = Measurement(wall, config).mean_log_likelihood(np.repeat(np.eye(4)[None], 101, axis=0), log_scale, scan)
        assert log_scale[np.argmax(fit)] == pytest.approx(0.0, abs=0.0015)


@pytest.mark.parametrize(
    ("kind", "count", "width"),
    [("image", "effective_points", "log_depth_sd"), ("corners", "effective_corners", "corner_log_depth_sd")],
)
def test_tempering_scales_log_weights(kind, count, width):
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    poses, log_scale = make_particles(50, rng)
    prior = normalised(rng.normal(size=50))
    scan = scan_ahead(mixture, 60, rng)
    evidence = []
    for points in (5.0, 10.0):
        measurement = Measurement(mixture, LikelihoodConfig(**{count: points, width: 0.09}))
        after = getattr(measurement, f"weigh_{kind}")(Particles(poses, log_scale, prior), scan)
        assert after.weights.sum() == pytest.approx(1.0)
        assert after.poses is poses and after.log_scale is log_scale
        gained = after.log_weights - prior
        evidence.append(gained - gained[0])
        fit = measurement.mean_log_likelihood(poses, log_scale, scan, 0.09)
        assert np.allclose(evidence[-1], points * (fit - fit[0]))
    assert np.allclose(evidence[1], 2.0 * evidence[0])
    assert np.ptp(evidence[0]) > 0.1


def test_more_points_of_one_image_do_not_make_the_filter_surer():
    mixture, rng = make_mixture(30), np.random.default_rng(0)
    particles = Particles(*make_particles(50, rng), np.full(50, -np.log(50)))
    scan = scan_ahead(mixture, 60, rng)
    measurement = Measurement(mixture, LikelihoodConfig(effective_points=10.0))
    once, thrice = (measurement.weigh_image(particles, uniform_scan(np.tile(scan.points, (n, 1)))) for n in (1, 3))
    assert np.allclose(once.log_weights, thrice.log_weights, atol=1e-6)


@pytest.mark.parametrize("likelihood", ["ray", "volume"])
def test_no_evidence_says_nothing(likelihood):
    particles = Particles(*make_particles(5, np.random.default_rng(0)), np.full(5, -np.log(5)))
    measurement = Measurement(make_mixture(3), LikelihoodConfig(likelihood=likelihood))
    empty = uniform_scan(np.zeros((0, 3), dtype=np.float32))
    assert measurement.weigh_image(particles, empty) is particles
    assert measurement.weigh_corners(particles, empty) is particles
    deaf = Measurement(make_mixture(3), LikelihoodConfig(effective_points=0.0, effective_corners=0.0))
    scan = uniform_scan(np.array([[0.0, 0.0, 1.0]], dtype=np.float32))
    assert deaf.weigh_image(particles, scan) is particles
    assert deaf.weigh_corners(particles, scan) is particles


def test_settings_of_the_likelihood_are_checked():
    with pytest.raises(ValueError, match="likelihood"):
        LikelihoodConfig(likelihood="area")
    with pytest.raises(ValueError, match="log_depth_sd"):
        LikelihoodConfig(log_depth_sd=0.0)


# --- Health ---


def belief_of(spread_m: float) -> Estimate:
    # Rotated, so that the widest direction is no axis.
    axes = so3_exp([0.5, 0.4, -0.3])
    covariance = np.eye(6) * 1e-4
    covariance[:3, :3] = axes @ np.diag([1e-4, spread_m**2, 1e-4]) @ axes.T
    return Estimate(np.eye(4), covariance, 0.0)


@pytest.mark.parametrize(
    ("fit", "spread_m", "state"),
    [
        (-1.0, 0.05, "tracking"),
        (-2.0, 0.05, "tracking"),  # the border of the range is healthy
        (-2.5, 0.05, "uncertain"),
        (-3.5, 0.05, "lost"),
        (np.nan, 0.05, "uncertain"),
        (-1.0, 3.0, "lost"),
        (np.nan, 3.0, "lost"),
        (-3.5, 3.0, "lost"),
    ],
)
def test_state_of_the_localizer(fit, spread_m, state):
    assert judge(fit, belief_of(spread_m), LikelihoodThresholds(low=-2.0, lost=-3.0), is_followed=True) == state


@pytest.mark.parametrize(("fit", "state"), [(-1.0, "uncertain"), (-2.5, "uncertain"), (-3.5, "lost")])
def test_a_camera_lost_sight_of_is_not_tracked(fit, state):
    assert judge(fit, belief_of(0.05), LikelihoodThresholds(low=-2.0, lost=-3.0), is_followed=False) == state


def test_healthy_range_is_measured():
    healthy = LikelihoodThresholds.from_log_likelihoods(np.linspace(-2.0, -1.0, 101))
    assert healthy.low == pytest.approx(-1.99)
    assert healthy.lost < healthy.low
    assert healthy.low - healthy.lost == pytest.approx(-1.5 - healthy.low)


def test_a_healthy_range_of_few_frames_is_not_taken_for_what_they_happen_to_span():
    healthy = LikelihoodThresholds.from_log_likelihoods([1.0, 1.02])
    assert healthy.low < 0.7 and healthy.lost < 0.3
    wide = LikelihoodThresholds.from_log_likelihoods(np.linspace(0.0, 2.0, 5))  # as measured
    assert wide.low == pytest.approx(0.02)
