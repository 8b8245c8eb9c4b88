"""The belief's filter against a batch solution, and consistent where errors are drawn from its own model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from map_helpers import motion_of
from monoloc.fusion.bias_filter import BiasAugmentedFilter
from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.fusion.bias_state import PARTICLES, BiasAugmentedState
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, adjoint, invert, is_rigid, pose_distance_m, se3_exp, se3_log
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.odometry.motion import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

PARTICLE_BIAS = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03, sd_growth_m=0.1, sd_growth_rad=0.05)
LANDMARK_BIAS = LandmarkBiasModel(sd_at_reference_m=0.01, sd_at_reference_rad=0.006)
START_SD = np.repeat([0.1, 0.05], 3)
STEP = se3_exp([0.03, -0.01, 0.05, 0.01, 0.04, -0.02])
STRAIGHT_STEP = se3_exp([0.04, -0.01, 0.03, 0.002, 0.004, -0.002])
STILL = np.eye(4)
ODOMETRY_SD = np.repeat([0.004, 0.003], 3)
NOISE_SD = np.repeat([0.01, 0.006], 3)  # of the measured poses, without their biases
# Of the filter, for errors that are correlated from frame to frame.
PARTICLE_INFLATION, ODOMETRY_INFLATION, VIEW_INFLATION = 4.0, 4.0, 3.4
ELAPSED_S = 1.0 / 15.0


def along_x(distance_m: float) -> FloatArray:
    return se3_exp([distance_m, 0.0, 0.0, 0.0, 0.0, 0.0])


def by_particles(pose: FloatArray) -> Estimate:
    return Estimate(pose, np.diag(NOISE_SD**2) / PARTICLE_INFLATION**2, 0.0)


def by_landmarks(pose: FloatArray) -> LandmarkPose:
    """Of so many landmarks that their noise is NOISE_SD."""
    return LandmarkPose(pose, np.diag(NOISE_SD**2), np.zeros((20, 3)))


def state_at_start(bias: BiasModel = PARTICLE_BIAS) -> BiasAugmentedState:
    return BiasAugmentedState.from_start(Estimate(np.eye(4), np.diag(START_SD**2), 0.0), bias.sds(0.0)[None])


def filter_with(
    start: Estimate,
    reference_poses: FloatArray | ReferencePoses,
    particle_bias: BiasModel = PARTICLE_BIAS,
    landmark_bias: LandmarkBiasModel = LANDMARK_BIAS,
) -> BiasAugmentedFilter:
    if not isinstance(reference_poses, ReferencePoses):
        reference_poses = ReferencePoses.without_bias(reference_poses.reshape(-1, 4, 4))
    return BiasAugmentedFilter(start, particle_bias, MotionConfig(), reference_poses, landmark_bias)


def filter_at_origin(reference_pose: FloatArray = np.eye(4), bias: BiasModel = PARTICLE_BIAS) -> BiasAugmentedFilter:
    return filter_with(Estimate(np.eye(4), np.diag(START_SD**2), 0.0), reference_pose, bias)


def frame(
    fusion: BiasAugmentedFilter,
    motion: Motion | None,
    measured: Estimate,
    elapsed_s: float = ELAPSED_S,
    accepted: bool = True,
) -> Estimate:
    """A frame without landmarks."""
    belief = fusion.predict(motion, elapsed_s, measured)
    return fusion.update_from_particles(measured) if accepted else belief


# --- The state, against least squares ---


def test_last_state_along_a_line_equals_the_batch_solution() -> None:
    """Without rotation all is linear: the filter gives what least squares over all poses and biases gives."""
    rng = np.random.default_rng(0)
    frames, step_m = 12, 0.1
    bias = BiasModel(sd_at_reference_m=0.05)
    measured_m = step_m * np.arange(frames) + rng.normal(0.0, 0.03, frames)  # within the gate
    correlation = bias.correlation(step_m)
    state = state_at_start(bias)
    # Rows of a weighted system in positions and biases.
    rows, values = [], []

    def row(value: float, sd: float, **columns: float) -> None:
        coefficients = np.zeros(2 * frames)
        for name, factor in columns.items():
            coefficients[(0 if name[0] == "x" else frames) + int(name[1:])] = factor / sd
        rows.append(coefficients)
        values.append(value / sd)

    row(0.0, START_SD[0], x0=1.0)
    row(0.0, 0.05, b0=1.0)
    for k in range(frames):
        if k > 0:
            state = state.predict(along_x(step_m), np.diag(ODOMETRY_SD**2), correlation, bias.sds(0.0)[None])
            row(step_m, ODOMETRY_SD[0], **{f"x{k}": 1.0, f"x{k - 1}": -1.0})
            row(0.0, 0.05 * np.sqrt(1.0 - correlation**2), **{f"b{k}": 1.0, f"b{k - 1}": -correlation})
        state = state.update_from_particles(by_particles(along_x(measured_m[k])))
        row(measured_m[k], NOISE_SD[0], **{f"x{k}": 1.0, f"b{k}": 1.0})
    solution, *_ = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)
    covariance = np.linalg.inv(np.array(rows).T @ np.array(rows))
    last = [frames - 1, 2 * frames - 1]
    np.testing.assert_allclose([state.pose[0, 3], state.biases[0, 0]], solution[last], atol=1e-6)
    np.testing.assert_allclose(
        state.covariance[np.ix_([0, 6], [0, 6])], covariance[np.ix_(last, last)], rtol=1e-4, atol=1e-9
    )


def test_larger_bias_moves_the_pose_less() -> None:
    measured = by_particles(se3_exp([0.2, 0.0, 0.0, 0.0, 0.1, 0.0]))
    shifts = []
    for sd in (0.0, 0.05, 0.2, 1.0):
        state = state_at_start(BiasModel(sd_at_reference_m=sd, sd_at_reference_rad=sd))
        shifts.append(float(np.linalg.norm(se3_log(state.update_from_particles(measured).pose))))
    assert shifts == sorted(shifts, reverse=True)
    assert shifts[0] == pytest.approx(float(np.linalg.norm(se3_log(measured.pose))), rel=0.03)
    assert shifts[-1] < 0.02


def test_particles_that_are_all_one_give_a_finite_belief() -> None:
    """No spread and no bias: a singular covariance."""
    pose = se3_exp([0.1, 0.2, 0.3, 0.1, 0.0, -0.2])
    state = state_at_start(BiasModel()).update_from_particles(Estimate(pose, np.zeros((6, 6)), 0.0))
    np.testing.assert_allclose(state.pose, pose, atol=1e-6)
    assert np.isfinite(state.covariance).all() and np.linalg.eigvalsh(state.covariance)[0] > -1e-15


def test_scale_of_odometry_keeps_its_prior_variance_without_measurements() -> None:
    before = after = state_at_start()
    for _ in range(3):
        after = after.predict(np.eye(4), np.zeros((6, 6)), 1.0, after.prior_sds, scale_correlation=0.9)
    assert after.covariance[-1, -1] == pytest.approx(before.covariance[-1, -1], rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_prediction_carries_the_covariance_to_the_new_cameras_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    error, motion, no_bias = 1e-4 * rng.normal(size=6), se3_exp(rng.normal(size=6)), np.zeros((1, 6))
    start = BiasAugmentedState.from_start(Estimate(se3_exp(rng.normal(size=6)), np.outer(error, error), 0.0), no_bias)
    state = start.predict(motion, np.zeros((6, 6)), 1.0, no_bias)
    carried = se3_log(invert(state.pose) @ start.pose @ se3_exp(error) @ motion)
    np.testing.assert_allclose(state.covariance[:6, :6], np.outer(carried, carried), atol=1e-14)


def test_second_measurement_with_the_same_bias_reveals_nothing_of_it() -> None:
    """A first measurement with unknown bias, then perfect odometry: only the noise is averaged."""
    prior_sds = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03).sds(0.0)[None]
    state = BiasAugmentedState.from_measurement(0, np.eye(4), np.diag(NOISE_SD**2), prior_sds)
    state = state.predict(STILL, np.zeros((6, 6)), 1.0, prior_sds).update_from_particles(by_particles(np.eye(4)))
    sds = np.sqrt(np.diag(state.covariance))
    np.testing.assert_allclose(sds[6:-1], prior_sds[0], rtol=1e-6)
    np.testing.assert_allclose(sds[:6], np.hypot(NOISE_SD / np.sqrt(2.0), prior_sds[0]), rtol=1e-4)


def test_state_from_particles_is_independent_of_the_landmarks_bias() -> None:
    prior_sds = np.stack([PARTICLE_BIAS.sds(0.0), LANDMARK_BIAS.sds(0.0)])
    state = BiasAugmentedState.from_measurement(0, np.eye(4), np.diag(NOISE_SD**2), prior_sds)
    np.testing.assert_array_equal(state.covariance[:12, 12:], 0.0)
    np.testing.assert_allclose(np.sqrt(np.diag(state.covariance)[6:-1]), prior_sds.ravel())
    offset_m = 0.04
    updated = state.update_from_landmarks(along_x(offset_m), np.diag(NOISE_SD**2), is_decisive=True)
    of_particles, of_landmarks = NOISE_SD[0] ** 2 + prior_sds[:, 0] ** 2
    total = of_particles + of_landmarks
    assert updated.pose[0, 3] == pytest.approx(offset_m * of_particles / total, rel=1e-3)
    # The particles' bias is known now: it points the other way.
    assert updated.biases[0, 0] == pytest.approx(-offset_m * prior_sds[0, 0] ** 2 / total, rel=1e-3)


# --- Consistency: errors drawn from the model are as large as the covariance says ---


def last_error(rng: np.random.Generator, steps: list[FloatArray], bias_model: BiasModel) -> float:
    """Squared error of the last belief of a trajectory that leaves a reference pose, in units of its covariance."""
    reference_pose = true = se3_exp(rng.normal(size=6))
    start = Estimate(true @ se3_exp(-rng.normal(size=6) * START_SD), np.diag(START_SD**2), 0.0)
    fusion = filter_with(start, reference_pose, bias_model)
    variances = bias_model.sds(0.0) ** 2
    bias = rng.normal(size=6) * np.sqrt(variances)
    for k, step in enumerate([STILL, *steps]):
        odometry_sd = ODOMETRY_INFLATION * motion_sd(motion_of(step), ELAPSED_S, 0.0, MotionConfig())
        true = true @ step @ se3_exp(rng.normal(size=6) * odometry_sd * (k > 0))
        correlation = bias_model.correlation(float(pose_distance_m(np.eye(4), step[None])[0]))
        # As large as the model says here, or larger by what remains of the bias before.
        remaining = correlation**2 * variances
        here = bias_model.sds(float(pose_distance_m(true, reference_pose[None])[0])) ** 2
        variances = np.maximum(remaining + (1.0 - correlation**2) * here, here)
        bias = correlation * bias + np.sqrt(variances - remaining) * rng.normal(size=6)
        measured = by_particles(true @ se3_exp(bias) @ se3_exp(rng.normal(size=6) * NOISE_SD))
        belief = frame(fusion, motion_of(step) if k > 0 else None, measured)
    assert is_rigid(belief.pose).all()
    error = se3_log(invert(belief.pose) @ true)
    return float(error @ np.linalg.solve(belief.covariance, error))


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Squared errors have six degrees of freedom; over 100 trajectories, their mean's standard deviation is 0.35."""
    rng = np.random.default_rng(1)
    bias_model = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2, sd_growth_rad=0.1)
    errors = [last_error(rng, [se3_exp(4.0 * se3_log(STRAIGHT_STEP))] * 4, bias_model) for _ in range(100)]
    assert np.mean(errors) == pytest.approx(6.0, abs=0.8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "bias_model"),
    [
        ([STEP] * 25, BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03)),
        (
            [STRAIGHT_STEP] * 15 + [invert(STRAIGHT_STEP)] * 15,
            BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.02, sd_growth_m=0.2),
        ),
    ],
    ids=["constant bias", "away and back"],
)
def test_errors_over_long_trajectories_are_as_large_as_the_covariance_says(
    steps: list[FloatArray], bias_model: BiasModel
) -> None:
    """As above; of 200 trajectories, the mean's standard deviation is 0.25."""
    rng = np.random.default_rng(1)
    errors = [last_error(rng, steps, bias_model) for _ in range(200)]
    assert np.mean(errors) == pytest.approx(6.0, abs=0.8)


@pytest.mark.slow
def test_a_landmark_pose_of_nearly_the_same_view_says_less() -> None:
    shifts = []
    for step_m in (0.0, 0.05, 0.1):
        fusion = filter_at_origin()
        fusion.update_from_landmarks(by_landmarks(np.eye(4)))
        exact = Motion.metric(along_x(step_m), 1e-4, 1e-4)
        frame(fusion, exact, by_particles(along_x(step_m)), accepted=False)
        after = fusion.update_from_landmarks(by_landmarks(along_x(step_m + 0.005)))
        shifts.append(after.pose[0, 3] - step_m)
    assert 0.0 < 4.0 * shifts[0] < shifts[1] < shifts[2]


@pytest.mark.parametrize("way_m", [0.1, 0.0], ids=["moving", "hovering"])
def test_the_number_of_landmark_poses_does_not_matter(way_m: float) -> None:
    """A camera of four times the rate is no surer of its pose."""
    sds = []
    for frames in (4, 16):
        fusion = filter_at_origin()
        step_m = way_m / frames
        for k in range(1, frames + 1):
            exact = Motion.metric(along_x(step_m), 1e-6, 1e-6)
            frame(fusion, exact, by_particles(along_x(k * step_m)), 0.24 / frames, accepted=False)
            belief = fusion.update_from_landmarks(by_landmarks(along_x(k * step_m)))
        sds.append(np.sqrt(belief.covariance[0, 0]))
    assert sds[1] == pytest.approx(sds[0], rel=0.1)


def test_errors_are_as_large_as_the_covariance_says_with_landmarks_too() -> None:
    """As above; landmarks have a bias of their own, and are seen in every other frame."""
    rng = np.random.default_rng(2)
    errors, distances_m = [], []
    for _ in range(200):
        reference_pose = true = se3_exp(rng.normal(size=6))
        start = Estimate(true @ se3_exp(-rng.normal(size=6) * START_SD), np.diag(START_SD**2), 0.0)
        fusion = filter_with(start, reference_pose)
        biases = rng.normal(size=(2, 6)) * [PARTICLE_BIAS.sds(0.0), LANDMARK_BIAS.sds(0.0)]
        odometry_sd = ODOMETRY_INFLATION * motion_sd(motion_of(STILL), ELAPSED_S, 0.0, MotionConfig())
        for k in range(20):
            true = true @ se3_exp(rng.normal(size=6) * odometry_sd * (k > 0))
            # After no motion, the noise of a landmark pose is taken for four times as large.
            noise_sds = NOISE_SD, NOISE_SD * (4.0 if k else 1.0)
            particles, landmarks = (
                true @ se3_exp(b) @ se3_exp(rng.normal(size=6) * sd) for b, sd in zip(biases, noise_sds, strict=True)
            )
            belief = frame(fusion, motion_of(STILL) if k else None, by_particles(particles))
            if k % 2 == 0:
                belief = fusion.update_from_landmarks(by_landmarks(landmarks))
        error = se3_log(invert(belief.pose) @ true)
        errors.append(error @ np.linalg.solve(belief.covariance, error))
        distances_m.append(np.linalg.norm(error[:3]))
    assert np.mean(errors) == pytest.approx(6.0, abs=0.9)
    assert np.median(distances_m) < 0.025  # by landmarks, whose bias is a fifth of the particles'


# --- Frame by frame ---


def test_odometrys_translation_has_the_depths_scale() -> None:
    """It is measured in predicted depth, which by the particles is too small by a fifth."""
    fusion = filter_at_origin()
    frame(fusion, None, Estimate(np.eye(4), np.diag(NOISE_SD**2), np.log(1.25)), 0.0)
    belief = frame(fusion, motion_of(STRAIGHT_STEP), by_particles(np.eye(4)), accepted=False)
    np.testing.assert_allclose(belief.pose[:3, 3], 1.25 * STRAIGHT_STEP[:3, 3], atol=1e-12)


def test_metric_translation_has_no_scale_and_its_own_noise() -> None:
    fusion = filter_at_origin()
    frame(fusion, None, Estimate(np.eye(4), np.diag(NOISE_SD**2), np.log(1.25)), 0.0)
    motion = Motion.metric(STRAIGHT_STEP, 0.02, 0.01)
    before_pose, before = fusion.belief.pose, fusion.belief.covariance
    belief = frame(fusion, motion, by_particles(np.eye(4)), accepted=False)
    np.testing.assert_allclose(belief.pose, before_pose @ STRAIGHT_STEP, atol=1e-12)
    turned = adjoint(invert(STRAIGHT_STEP))
    noise = np.repeat([0.02, 0.01], 3) * ODOMETRY_INFLATION
    np.testing.assert_allclose(belief.covariance, turned @ before @ turned.T + np.diag(noise**2), atol=1e-12)


def test_growth_widens_covariance_away_from_reference_poses() -> None:
    """By the distance from the nearest reference pose to where the camera has come."""
    bias = BiasModel(sd_at_reference_m=0.02, sd_at_reference_rad=0.01, sd_growth_m=0.1, sd_growth_rad=0.05)
    near, far, place = np.eye(4), along_x(3.0), along_x(2.8)
    for reference_poses, start, distance_m in (
        (near, near, 2.8),
        (far, far, 0.2),
        (np.stack([near, far]), near, 0.2),
    ):
        fusion = filter_with(Estimate(start, np.eye(6), 0.0), reference_poses, bias)
        frame(fusion, None, by_particles(start), 0.0, accepted=False)
        belief = frame(fusion, motion_of(invert(start) @ place), by_particles(place))
        sd = np.sqrt(np.diag(belief.covariance))
        np.testing.assert_allclose(sd, np.hypot(NOISE_SD, bias.sds(distance_m)), rtol=0.1)


def test_stated_covariance_is_that_of_a_larger_bias_of_the_particles() -> None:
    """Of a belief that particles alone made, exactly that of a belief made with the larger bias."""
    noise, prior_sds = np.diag(NOISE_SD**2), np.stack([PARTICLE_BIAS.sds(0.5), LANDMARK_BIAS.sds(0.5)])
    wider = np.stack([PARTICLE_BIAS.stated_sds(0.5), LANDMARK_BIAS.sds(0.5)])
    assert np.all(wider[PARTICLES] > prior_sds[PARTICLES])
    made = [BiasAugmentedState.from_measurement(PARTICLES, STEP, noise, sds) for sds in (prior_sds, wider)]
    stated = made[0].stated_covariance(PARTICLES, wider[PARTICLES])
    np.testing.assert_allclose(stated, made[1].covariance[:6, :6], rtol=1e-9, atol=1e-12)


def test_covariance_is_stated_wider_away_from_the_build_unless_landmarks_are_seen() -> None:
    def stated(distance_m: float, with_landmarks: bool) -> tuple[float, float]:
        """Standard deviations of position, as stated and as believed."""
        pose = along_x(distance_m)
        belief = filter_at_origin()
        belief.reinitialise(by_particles(pose))
        for _ in range(20):
            belief.predict(motion_of(STILL), ELAPSED_S, by_particles(pose))
            belief.update_from_particles(by_particles(pose))
            if with_landmarks:
                belief.update_from_landmarks(by_landmarks(pose))
        return belief.stated().position_sd_m, belief.belief.position_sd_m

    at_build, at_build_believed = stated(0.0, with_landmarks=False)
    away, away_believed = stated(1.0, with_landmarks=False)
    seen, seen_believed = stated(1.0, with_landmarks=True)
    assert at_build == pytest.approx(at_build_believed, rel=1e-9)
    assert away > 1.5 * away_believed and away > 0.2
    assert seen_believed <= seen < 0.2 * away


def test_belief_is_the_same_whatever_the_view_and_its_stated_covariance_is_not() -> None:
    """Until landmarks are seen, the stated covariance is wider by the noise of the view, of few corners more."""
    view = np.diag(np.repeat([0.02, 0.01], 3) ** 2)
    without, within = filter_at_origin(), filter_at_origin()
    motion = replace(motion_of(STILL), inliers=50)
    for fusion, covariance in ((without, None), (within, view)):
        frame(fusion, replace(motion, view_covariance=covariance), by_particles(STILL), accepted=False)
    np.testing.assert_array_equal(within.belief.covariance, without.belief.covariance)
    wider = within.stated().covariance - without.stated().covariance
    np.testing.assert_allclose(wider, (VIEW_INFLATION * (200 / 50) ** 1.5) ** 2 * view, rtol=1e-9, atol=1e-12)
    for fusion in (without, within):
        fusion.update_from_landmarks(by_landmarks(along_x(0.01)))
    np.testing.assert_array_equal(within.belief.pose, without.belief.pose)
    seen = within.stated().covariance - without.stated().covariance
    assert 0.0 < np.trace(seen) < 0.1 * np.trace(wider)


def test_considered_noise_makes_the_stated_covariance_as_large_as_the_errors() -> None:
    """Motions have more noise than the filter weighs them by: its own covariance is too small for the errors."""
    rng, no_bias = np.random.default_rng(7), np.zeros((2, 6))
    noise, more = np.diag(ODOMETRY_SD**2), np.diag((4.0 * ODOMETRY_SD) ** 2)
    own, stated = [], []
    for _ in range(100):
        true = np.eye(4)
        state = BiasAugmentedState.from_start(Estimate(true, np.diag(NOISE_SD**2), 0.0), no_bias)
        state = replace(state, pose=se3_exp(NOISE_SD * rng.standard_normal(6)))
        for _ in range(6):
            true = true @ STEP @ se3_exp(rng.multivariate_normal(np.zeros(6), noise + more))
            state = state.predict(STEP, noise, 1.0, no_bias, considered_noise=more)
            measured = true @ se3_exp(NOISE_SD * rng.standard_normal(6))
            state = state.update_from_landmarks(measured, np.diag(NOISE_SD**2), is_decisive=True)
        error = se3_log(invert(state.pose) @ true)
        own.append(error @ np.linalg.solve(state.covariance[:6, :6], error))
        stated.append(error @ np.linalg.solve(state.stated_covariance(PARTICLES, np.zeros(6)), error))
    # Of 100 chi-squares with 6 degrees of freedom, the mean has a standard deviation of 0.35.
    assert 5.0 < np.mean(stated) < 7.0
    assert np.mean(own) > 12.0


def test_correlated_landmark_errors_make_the_stated_covariance_as_large_as_the_errors() -> None:
    """Landmark poses of all frames share a bias that the filter does not know of, and that changes slowly."""
    rng, no_bias, correlation = np.random.default_rng(8), np.zeros((2, 6)), 0.95
    noise, correlated = np.diag(NOISE_SD**2), np.diag((3.0 * NOISE_SD) ** 2)
    own, stated = [], []
    for _ in range(100):
        true, bias = np.eye(4), 3.0 * NOISE_SD * rng.standard_normal(6)
        start = Estimate(se3_exp(NOISE_SD * rng.standard_normal(6)), noise, 0.0)
        state = BiasAugmentedState.from_start(start, no_bias)
        for _ in range(6):
            true = true @ STEP @ se3_exp(ODOMETRY_SD * rng.standard_normal(6))
            state = state.predict(STEP, np.diag(ODOMETRY_SD**2), correlation, no_bias)
            bias = correlation * bias + np.sqrt(1.0 - correlation**2) * 3.0 * NOISE_SD * rng.standard_normal(6)
            measured = true @ se3_exp(bias) @ se3_exp(NOISE_SD * rng.standard_normal(6))
            state = state.update_from_landmarks(measured, noise, is_decisive=True, considered_bias=correlated)
        error = se3_log(invert(state.pose) @ true)
        own.append(error @ np.linalg.solve(state.covariance[:6, :6], error))
        stated.append(error @ np.linalg.solve(state.stated_covariance(PARTICLES, np.zeros(6)), error))
    # Of 100 chi-squares with 6 degrees of freedom, the mean has a standard deviation of 0.35.
    assert 5.0 < np.mean(stated) < 7.0
    assert np.mean(own) > 12.0


def test_known_bias_is_subtracted_and_less_of_it_away_from_the_reference_pose() -> None:
    bias = BiasModel(sd_at_reference_m=0.03, sd_at_reference_rad=0.03, sd_growth_m=0.1, sd_growth_rad=0.1)
    reference_pose = se3_exp([0.5, -1.0, 2.0, 0.3, 0.2, -0.4])
    known = np.array([0.02, -0.03, 0.01, 0.01, 0.02, -0.02])
    reference_poses = ReferencePoses(reference_pose[None], known[None], known[None])
    fusion = filter_with(Estimate(reference_pose, np.eye(6), 0.0), reference_poses, bias)
    for distance_m, share in ((0.0, 1.0), (0.3, 0.5)):
        true = reference_pose @ se3_exp([0.0, distance_m, 0.0, 0.0, 0.0, 0.0])
        measured = by_particles(true @ se3_exp(share * known))
        corrected = fusion.without_known_bias(measured, true)
        np.testing.assert_allclose(corrected.pose, true, atol=1e-12)
        assert corrected.covariance is measured.covariance and corrected.log_scale == measured.log_scale


def reference_poses_on_a_line() -> ReferencePoses:
    """Twenty poses along x; the bias along y is opposite in the two directions."""
    poses = np.stack([along_x(0.05 * k) for k in range(20)])
    forward = np.tile([0.0, 0.02, 0.0, 0.0, 0.0, 0.0], (20, 1))
    return ReferencePoses(poses, forward, -forward)


@pytest.mark.parametrize("has_odometry", [True, False])
@pytest.mark.parametrize("step_m", [0.04, -0.04])
def test_known_bias_is_that_of_the_direction_of_motion(step_m: float, has_odometry: bool) -> None:
    reference_poses = reference_poses_on_a_line()
    pose = reference_poses.poses[10]
    fusion = filter_with(by_particles(pose), reference_poses)
    np.testing.assert_array_equal(fusion.without_known_bias(by_particles(pose), pose).pose, pose)  # no direction yet
    for _ in range(8):
        pose = pose @ along_x(step_m)
        frame(fusion, motion_of(along_x(step_m)) if has_odometry else None, by_particles(pose))
    corrected = fusion.without_known_bias(by_particles(pose), pose)
    assert corrected.pose[1, 3] == pytest.approx(-np.sign(step_m) * 0.02, rel=0.12)


def test_camera_that_has_hovered_for_seconds_has_no_direction_of_motion_any_more() -> None:
    reference_poses = reference_poses_on_a_line()
    pose = reference_poses.poses[10]
    fusion = filter_with(by_particles(pose), reference_poses)
    offsets_m = []
    for step_m, elapsed_s in ((0.2, ELAPSED_S), (0.0, 8.0)):
        pose = pose @ along_x(step_m)
        frame(fusion, motion_of(along_x(step_m)), by_particles(pose), elapsed_s)
        offsets_m.append(abs(fusion.without_known_bias(by_particles(pose), pose).pose[1, 3]))
    assert offsets_m[0] > 0.015 and offsets_m[1] < 0.001


def test_jump_of_the_particles_is_no_motion() -> None:
    """Neither the first scan's correction of the start, nor a relocalisation."""
    reference_poses = reference_poses_on_a_line()
    pose = reference_poses.poses[10]
    fusion = filter_with(by_particles(pose), reference_poses)
    for jump_to, elapsed_s in ((reference_poses.poses[14], 0.0), (along_x(4.0), ELAPSED_S)):
        frame(fusion, None, by_particles(jump_to), elapsed_s)
        np.testing.assert_array_equal(fusion.without_known_bias(by_particles(pose), pose).pose, pose)


@pytest.mark.parametrize(("motion", "elapsed_s"), [(None, 2.0), (motion_of(STEP), ELAPSED_S)])
def test_prediction_is_that_of_a_frame_and_changes_nothing(motion: Motion | None, elapsed_s: float) -> None:
    fusion = filter_at_origin()
    predicted = fusion.predicted(motion, elapsed_s)
    np.testing.assert_array_equal(fusion.predicted(motion, elapsed_s).covariance, predicted.covariance)
    np.testing.assert_array_equal(fusion.belief.pose, np.eye(4))
    belief = fusion.predict(motion, elapsed_s, by_particles(np.eye(4)))
    np.testing.assert_array_equal(belief.pose, predicted.pose)
    np.testing.assert_array_equal(belief.covariance, predicted.covariance)


def test_belief_that_scans_relocalised_without_odometry_does_not_start_anew_at_the_next_frame() -> None:
    fusion, restarted = filter_at_origin(), []
    fusion.predict(None, 2.5, by_particles(STEP))
    fusion.reinitialise(by_particles(STEP))
    for _ in range(20):
        frame(fusion, None, by_particles(STEP))
        restarted.append(fusion.restarted)
    assert not any(restarted)


def test_belief_without_odometry_spreads_with_an_unknown_velocity() -> None:
    fusion, noise = filter_at_origin(), MotionConfig()
    for _ in range(15):
        belief = fusion.predict(None, ELAPSED_S, by_particles(np.eye(4)))
    expected = np.hypot(START_SD, np.repeat([noise.speed_sd_m_s, noise.turn_sd_rad_s], 3))
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance)), expected, rtol=1e-6)


def test_rotation_alone_turns_the_belief_and_counts_as_no_odometry() -> None:
    """The position spreads as without it; the rotation does not."""
    turn = se3_exp([0.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    turning, blind = filter_at_origin(), filter_at_origin()
    for index in range(15):
        motion = Motion.rotation(turn[:3, :3], 0.002)
        predicted = turning.predicted(motion, ELAPSED_S)
        belief = turning.predict(motion, ELAPSED_S, by_particles(np.eye(4)))
        unknown = blind.predict(None, ELAPSED_S, by_particles(np.eye(4)))
        np.testing.assert_array_equal(belief.pose, predicted.pose)
        assert turning.time_since_update_s == blind.time_since_update_s == pytest.approx((index + 1) * ELAPSED_S)
    np.testing.assert_allclose(belief.pose, se3_exp([0.0, 0.0, 0.0, 0.0, 1.5, 0.0]), atol=1e-9)
    assert np.trace(belief.covariance[:3, :3]) == pytest.approx(np.trace(unknown.covariance[:3, :3]))
    sd_rad = np.sqrt(START_SD[3] ** 2 + 15 * (ODOMETRY_INFLATION * 0.002) ** 2)
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance)[3:]), sd_rad, rtol=1e-6)
    # After a second without the translation, the belief starts from the particles, as without any motion.
    turning.predict(Motion.rotation(turn[:3, :3], 0.002), ELAPSED_S, by_particles(along_x(2.0)))
    np.testing.assert_allclose(turning.update_from_particles(by_particles(along_x(2.0))).pose, along_x(2.0))


def test_frames_without_accepted_measurement_widen_the_belief() -> None:
    """In darkness the particles follow odometry: counting them would count the same evidence again."""
    motion = motion_of(STEP)
    ignoring, updating = filter_at_origin(), filter_at_origin()
    pose, variances = np.eye(4), []
    for _ in range(20):
        pose = pose @ STEP
        ignored, updated = (
            frame(fusion, motion, by_particles(pose), accepted=fusion is updating) for fusion in (ignoring, updating)
        )
        variances.append(ignored.covariance[0, 0])
    np.testing.assert_allclose(ignored.pose, pose, atol=1e-12)
    assert variances == sorted(variances)
    assert updated.covariance[0, 0] < ignored.covariance[0, 0]


def test_time_since_update_is_reset_by_odometry_particles_and_landmarks() -> None:
    fusion, measured = filter_at_origin(), by_particles(np.eye(4))
    for constrain in (
        lambda: fusion.update_from_particles(measured),
        lambda: fusion.update_from_landmarks(by_landmarks(np.eye(4))),
        lambda: fusion.predict(motion_of(STILL), ELAPSED_S, measured),
    ):
        for count in (1, 2):
            fusion.predict(None, ELAPSED_S, measured)
            assert fusion.time_since_update_s == pytest.approx(count * ELAPSED_S)
        constrain()
        assert fusion.time_since_update_s == 0.0


def test_reinitialisation_has_the_error_of_a_relocalisation() -> None:
    bias = BiasModel(
        sd_at_reference_m=0.01, sd_at_reference_rad=0.01, relocalization_sd_m=0.3, relocalization_sd_rad=0.2
    )
    fusion, measured = filter_at_origin(bias=bias), by_particles(STEP)
    spread = np.sqrt(measured.covariance[3, 3])
    assert fusion.rotation_sd(measured) == pytest.approx(np.hypot(0.01, spread), rel=1e-6)
    fusion.predict(None, 3.0, measured)
    belief = fusion.reinitialise(measured)
    assert fusion.time_since_update_s == 0.0
    np.testing.assert_array_equal(belief.pose, STEP)
    expected = np.hypot(NOISE_SD, np.repeat([0.3, 0.2], 3))
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance)), expected, rtol=1e-6)
    assert fusion.rotation_sd(measured) == pytest.approx(np.hypot(0.2, spread), rel=1e-6)


# --- Without odometry ---


def test_bias_is_forgotten_with_the_distance_that_particles_move() -> None:
    offset, biases = along_x(0.2), []
    bias = BiasModel(sd_at_reference_m=0.1, sd_at_reference_rad=0.1)
    for distance_m in (0.0, 1.0):
        fusion = filter_at_origin(bias=bias)
        for _ in range(8):
            frame(fusion, motion_of(STILL), by_particles(offset))
        fusion.predict(None, 0.5, by_particles(offset @ along_x(distance_m)))
        biases.append(fusion._state.biases[0, 0])
    assert biases[0] > 0.05 and biases[1] == pytest.approx(bias.correlation(1.0) * biases[0], rel=1e-6)


def test_after_a_second_without_odometry_the_belief_is_the_particles_with_their_bias() -> None:
    """However wrong the start; the bias is large far from the reference poses, and decays with the motion."""
    reference_pose, true = se3_exp([0.0, 2.0, 0.0, 0.0, 0.0, 0.0]), along_x(0.1)
    fusion = filter_at_origin(reference_pose)
    frame(fusion, None, by_particles(true), 0.0)
    sds, restarted = [], []
    for _ in range(20):
        true = true @ STEP
        belief = frame(fusion, None, by_particles(true))
        sds.append(PARTICLE_BIAS.sds(float(pose_distance_m(true, reference_pose[None])[0])))
        restarted.append(fusion.restarted)
    assert restarted.count(True) == 1  # said once: the pose may jump there
    np.testing.assert_allclose(belief.pose, true, atol=1e-12)
    variances = np.diag(belief.covariance) - NOISE_SD**2
    np.testing.assert_allclose(belief.covariance, np.diag(np.diag(belief.covariance)), atol=1e-12)
    assert np.all(variances >= 0.999 * sds[-1] ** 2) and np.all(variances <= 1.001 * np.max(sds, axis=0) ** 2)


def test_memoryless_belief_is_the_particles_pose_whatever_was_believed() -> None:
    start, none = Estimate(np.eye(4), np.diag(START_SD**2), 0.0), ReferencePoses.none()
    fusion = BiasAugmentedFilter(start, BiasModel(), MotionConfig(), none, LandmarkBiasModel(), is_memoryless=True)
    for distance_m in (0.5, -0.3):
        belief = frame(fusion, motion_of(STILL), by_particles(along_x(distance_m)))
        np.testing.assert_allclose(belief.pose, along_x(distance_m), atol=1e-9)
        np.testing.assert_allclose(belief.covariance, np.diag(NOISE_SD**2), rtol=1e-3)
        # Landmarks of the same noise, of the same frame, count as much.
        few = replace(by_landmarks(along_x(distance_m + 0.01)), covariance=belief.covariance)
        assert fusion.update_from_landmarks(few).pose[0, 3] == pytest.approx(distance_m + 0.005, abs=1e-3)


def test_particles_that_tell_no_position_do_not_move_a_belief_without_odometry() -> None:
    """Their bias was measured as a metre: a network that does not fit the room."""
    fusion = filter_at_origin(bias=BiasModel(sd_at_reference_m=1.0, sd_at_reference_rad=1.0))
    for _ in range(45):
        belief = frame(fusion, None, by_particles(along_x(2.0)))
    assert np.linalg.norm(belief.pose[:3, 3]) < 0.1 and belief.position_sd_m > 0.6


def test_single_frames_without_odometry_preserve_the_learnt_bias() -> None:
    """Odometry has revealed that the particles are 8 cm off since they left the reference poses."""
    step = se3_exp([0.015, -0.005, 0.018, 0.003, 0.01, -0.005])  # 0.36 m/s
    offset, bias = along_x(0.08), BiasModel(sd_at_reference_m=0.01, sd_growth_m=0.1)
    errors_m = []
    for dropped in ((), (15,), (15, 20, 21, 22)):
        fusion, true = filter_at_origin(bias=bias), np.eye(4)
        frame(fusion, None, by_particles(true), 0.0)
        for k in range(25):
            true = true @ step
            measured = by_particles(true if k < 8 else true @ offset)
            belief = frame(fusion, None if k in dropped else motion_of(step), measured)
        errors_m.append(np.linalg.norm(belief.pose[:3, 3] - true[:3, 3]))
    assert max(errors_m) < 0.06


# --- Landmarks ---


def test_landmarks_tell_the_scale_of_odometry() -> None:
    """Its depth is a quarter too small: the belief learns this, and then keeps the pose without landmarks."""
    step, seen = se3_exp([0.02, 0.0, 0.01, 0.0, 0.01, 0.0]), np.eye(4)
    fusion, true = filter_at_origin(), np.eye(4)
    measured = step.copy()
    measured[:3, 3] *= 0.8
    for _ in range(60):
        true = true @ step
        fusion.predict(motion_of(measured), ELAPSED_S, by_particles(true))
        seen = fusion.update_from_landmarks(by_landmarks(true)).pose
    assert np.exp(fusion._state.log_scale) == pytest.approx(1.0 / 0.8, rel=0.05)
    without = seen
    for _ in range(15):
        true, without = true @ step, without @ measured
        blind = fusion.predict(motion_of(measured), ELAPSED_S, by_particles(true)).pose
    off_m, off_without_m = (np.linalg.norm(pose[:3, 3] - true[:3, 3]) for pose in (blind, without))
    assert off_m < 0.4 * off_without_m


def test_landmarks_reveal_the_particles_bias() -> None:
    """Once landmarks are no longer seen, the particles' pose is corrected by what was learnt of its bias."""
    offset = se3_exp([0.08, 0.0, -0.05, 0.0, 0.04, 0.0])
    errors_m = {}
    for frames_with_landmarks in (0, 10):
        fusion = filter_at_origin()
        for k in range(60):
            belief = frame(fusion, motion_of(STILL), by_particles(offset))
            if k < frames_with_landmarks:
                belief = fusion.update_from_landmarks(by_landmarks(np.eye(4)))
        errors_m[frames_with_landmarks] = np.linalg.norm(belief.pose[:3, 3])
    assert errors_m[10] < 0.03 < 0.05 < errors_m[0]


def by_few_landmarks(pose: FloatArray) -> LandmarkPose:
    return replace(by_landmarks(pose), points=np.zeros((19, 3)))


def test_pose_of_few_landmarks_beyond_the_gate_hardly_counts_until_it_is_repeated() -> None:
    """A metre off a belief of centimetres."""
    fusion = filter_with(by_particles(np.eye(4)), np.eye(4))
    wrong = along_x(1.0)
    frame(fusion, None, by_particles(np.eye(4)), 0.0)
    once = fusion.update_from_landmarks(by_few_landmarks(wrong))
    assert np.linalg.norm(once.pose[:3, 3]) < 0.1
    for _ in range(100):
        frame(fusion, motion_of(STILL), by_particles(wrong))
        belief = fusion.update_from_landmarks(by_few_landmarks(wrong))
    assert np.linalg.norm(belief.pose[:3, 3] - wrong[:3, 3]) < 0.15


def test_belief_that_many_landmarks_contradict_begins_anew_at_their_pose() -> None:
    fusion = filter_with(by_particles(np.eye(4)), np.eye(4))
    frame(fusion, None, by_particles(np.eye(4)), 0.0)
    belief = fusion.update_from_landmarks(by_landmarks(along_x(1.0)))
    np.testing.assert_array_equal(belief.pose, along_x(1.0))
    # Noise and landmarks' bias a metre away from the reference pose.
    np.testing.assert_allclose(
        np.sqrt(np.diag(belief.covariance)), np.hypot(NOISE_SD, LANDMARK_BIAS.sds(1.0)), rtol=1e-4
    )


@pytest.mark.parametrize(("off_m", "contradicts"), [(0.01, False), (0.3, True), (1.0, True)])
def test_landmarks_beyond_the_gate_contradict_the_belief_for_that_frame(off_m: float, contradicts: bool) -> None:
    """Whether the belief moves towards them, or begins anew at them."""
    fusion = filter_with(by_particles(np.eye(4)), np.eye(4))
    frame(fusion, None, by_particles(np.eye(4)), 0.0)
    fusion.update_from_landmarks(by_landmarks(along_x(off_m)))
    assert fusion.landmarks_contradict == contradicts
    frame(fusion, motion_of(STILL), by_particles(np.eye(4)))
    assert not fusion.landmarks_contradict


def test_relocalisation_by_landmarks_counts_only_them() -> None:
    """And as an update: the next frame without odometry is not one of many."""
    fusion = filter_at_origin()
    for _ in range(20):
        fusion.predict(None, ELAPSED_S, by_particles(np.eye(4)))
    measured = by_landmarks(STEP.copy())
    np.testing.assert_array_equal(fusion.reinitialise_from_landmarks(measured).pose, STEP)
    measured.pose[:] = 0.0  # a caller, who is given it in the step
    np.testing.assert_array_equal(fusion.belief.pose, STEP)
    assert fusion.time_since_update_s == 0.0
    # Its noise is stated once, though later landmark poses have errors in common with it.
    np.testing.assert_array_equal(fusion.stated().covariance, fusion.belief.covariance)
    # The particles' next pose does not replace it, as it would after a second without odometry.
    fusion.predict(None, ELAPSED_S, by_particles(along_x(0.1)))
    belief = fusion.update_from_particles(by_particles(along_x(0.1)))
    assert not np.allclose(belief.pose, along_x(0.1), atol=1e-3)


def test_particles_contradict_the_belief_beyond_the_usual_bias_whatever_bias_was_estimated() -> None:
    """The estimated bias follows the particles wherever they go."""
    fusion = filter_with(by_particles(np.eye(4)), np.eye(4))
    near, far = by_particles(along_x(0.1)), by_particles(along_x(0.5))
    assert not fusion.contradicts(near, None) and fusion.contradicts(far, None)
    for _ in range(60):
        frame(fusion, motion_of(STILL), far)
        fusion.update_from_landmarks(by_landmarks(np.eye(4)))
    assert fusion._state.biases[0, 0] > 0.3  # by now, half a metre is what the filter expects
    assert fusion.contradicts(far, None) and not fusion.contradicts(near, None)


def test_particles_contradict_landmarks_whatever_is_believed() -> None:
    """A belief that has followed the particles does not excuse them, nor does a wide one."""
    for start in (by_particles(along_x(0.5)), Estimate(np.eye(4), np.eye(6), 0.0)):
        fusion = filter_with(start, np.eye(4))
        assert not fusion.contradicts(by_particles(along_x(0.5)), None)
        assert fusion.contradicts(by_particles(along_x(0.5)), by_landmarks(np.eye(4)))
        assert not fusion.contradicts(by_particles(along_x(0.1)), by_landmarks(np.eye(4)))


def test_known_bias_does_not_make_particles_contradict() -> None:
    """Half a metre, if the build measured it at this place."""
    known = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    reference_poses = ReferencePoses(np.eye(4)[None], known[None], known[None])
    bias = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.03)
    fusion = filter_with(by_particles(np.eye(4)), reference_poses, bias)
    assert not fusion.contradicts(by_particles(se3_exp(known)), by_landmarks(np.eye(4)))
    assert fusion.contradicts(by_particles(se3_exp(-known)), by_landmarks(np.eye(4)))


def test_landmarks_replace_odometry_as_a_reason_to_trust_the_belief() -> None:
    """While they are seen, the belief does not start anew from the particles."""
    offset, fusion = along_x(0.1), filter_with(by_particles(np.eye(4)), np.eye(4))
    for k in range(60):
        belief = frame(fusion, None, by_particles(offset))
        if k % 3 == 0:
            fusion.update_from_landmarks(by_landmarks(np.eye(4)))
    assert np.linalg.norm(belief.pose[:3, 3]) < 0.05
