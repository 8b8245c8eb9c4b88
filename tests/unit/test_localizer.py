"""What the localizer's step puts together, in a room whose depth is known exactly."""

from __future__ import annotations

import gc
import weakref
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from monoloc.bundle import Bundle
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.fusion.bias_model import BiasModel
from monoloc.geometry import FloatArray, invert, is_rigid, make_pose, se3_exp, se3_log
from monoloc.landmarks.pnp import LandmarkMeasurement, LandmarkPose, NoLandmarks
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.ray import RayLikelihood
from monoloc.likelihood.scan import Scan, scan_from_corners
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Localizer
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.odometry.motion import Motion
from monoloc.odometry.scale_tilt import ScaleTiltConfig
from monoloc.particle_filter.estimate import estimate
from monoloc.particle_filter.particles import Particles, normalised, scatter
from monoloc.relocalization.state_machine import Mode
from monoloc.start import Start
from monoloc.step import Step
from monoloc.step_budget import Level, StepBudget
from monoloc.supervision.integrity import IntegrityMonitor
from monoloc.supervision.state import Reason
from synthetic_room import (
    BLACK,
    CAMERA,
    FRAME_S,
    NO_DEPTH,
    SETTINGS,
    RoomRecording,
    depth_from_blue,
    follow,
    make_localizer,
    plausible_integrity,
    poses_of,
    sparse_depth,
)

FRAMES = 12
DOWN = np.array([0.0, 1.0, 0.0])


def localizer_at_truth(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    config: LocalizerConfig = SETTINGS,
    **given: Any,
) -> Localizer:
    start = scatter(recording.poses[0], config.particles, 0.03, 0.015, 0.0, np.random.default_rng(0))
    return make_localizer(mixture, thresholds, start, recording.poses[:1], settings=config, **given)


def test_refused_frame_changes_nothing(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer, twin = (localizer_at_truth(mixture, recording, thresholds) for _ in range(2))
    for each in (localizer, twin):
        follow(each, recording, range(2))
    color, depth = recording.color(2), sparse_depth(recording, 2)
    for elapsed_s in (-0.01, 1e200, float("nan"), None, "0.1", np.array([0.1])):
        with pytest.raises(ValueError, match="elapsed_s"):
            localizer.step(color, cast(float, elapsed_s), depth)
    for noise in ((np.nan, 0.01), (0.01, np.inf), (-0.01, 0.01)):
        motion = Motion(np.eye(4), translation="metric", translation_sd_m=noise[0], rotation_sd_rad=noise[1])
        with pytest.raises(ValueError, match="measured_motion"):
            localizer.step(color, FRAME_S, depth, measured_motion=motion)
    millimetres = make_pose(np.eye(3), [0.0, 0.0, 20.0])
    with pytest.raises(ValueError, match=r"measured_motion moves by 20 m in .* s; give metres"):
        localizer.step(color, FRAME_S, depth, measured_motion=Motion.metric(millimetres, 0.01, 0.01))
    with pytest.raises(ValueError, match="color"):
        localizer.step(color[:, ::2], FRAME_S, depth)
    with pytest.raises(ValueError, match="the room's surfaces do not tell its direction"):
        localizer.step(color, FRAME_S, depth, DOWN)
    after = [poses_of(follow(each, recording, range(2, 4))) for each in (localizer, twin)]
    np.testing.assert_array_equal(*after)


@pytest.mark.parametrize(("reference_poses", "search_precision"), [(0, 0.9), (10, 0.2)])
def test_start_must_be_given_where_the_room_cannot_be_searched(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    reference_poses: int,
    search_precision: float,
) -> None:
    integrity = plausible_integrity(thresholds, search_precision)
    with pytest.raises(
        ValueError, match="start must be given: neither scans nor landmarks can find the camera in this room"
    ):
        make_localizer(mixture, thresholds, None, recording.poses[:reference_poses], integrity=integrity)


@pytest.mark.parametrize("path", ["room.monoloc", Path("room.monoloc")])
def test_path_in_place_of_a_bundle_is_refused(path: Any) -> None:
    with pytest.raises(
        TypeError, match=r"^bundle must be a bundle, as monoloc\.load\(PATH\) gives it, got (str|Posix)"
    ):
        Localizer(path, CAMERA)


def test_numbers_in_place_of_a_camera_and_a_dict_of_settings_are_refused() -> None:
    bundle, numbers, settings = Bundle.__new__(Bundle), (640, 480, 525.0, 525.0, 319.5, 239.5), {"particles": 100}
    with pytest.raises(TypeError, match=r"^camera must be a monoloc\.Camera, got tuple$"):
        Localizer(bundle, cast(Any, numbers))
    with pytest.raises(TypeError, match=r"^config must be settings .*, got dict; write monoloc\.config\.override"):
        Localizer(bundle, CAMERA, config=cast(Any, settings))


def test_same_seed_gives_the_same_trajectory_and_another_seed_another(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    first, again, other = (
        poses_of(follow(localizer_at_truth(mixture, recording, thresholds, seed=seed), recording, range(6)))
        for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first[1:], other[1:], atol=1e-4)


def test_stream_that_shows_each_image_twice_is_followed_as_well(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """What the second showing allows for is known at the next image, whose motion begins at the first."""
    once, twice = (localizer_at_truth(mixture, recording, thresholds) for _ in range(2))
    for index in range(FRAMES):
        color, depth = recording.color(index), sparse_depth(recording, index)
        once.step(color, FRAME_S, depth)
        twice.step(color, 0.5 * FRAME_S, depth)
        new, expected = twice._tracker.fusion.belief, once._tracker.fusion.belief
        assert new.position_sd_m == pytest.approx(expected.position_sd_m, rel=0.15)
        assert np.linalg.norm(new.pose[:3, 3] - expected.pose[:3, 3]) < 0.02
        twice.step(color, 0.5 * FRAME_S, depth)
        assert twice._tracker.fusion.belief.position_sd_m > new.position_sd_m + 0.001  # the camera may have moved


class _RecordedLikelihood:
    """Notes what it is asked for and what it answered."""

    def __init__(self, mixture: GaussianMixture, config: LikelihoodConfig) -> None:
        self._likelihood = RayLikelihood(mixture, config)
        self.calls: list[tuple[FloatArray, Scan, float | None, FloatArray]] = []

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        values = self._likelihood.mean_log_likelihood(poses, log_scale, scan, log_depth_sd)
        self.calls.append((poses, scan, log_depth_sd, values))
        return values


def tilted_depth(color: NDArray[np.uint8]) -> DepthPrediction:
    """Of a network that states a larger error the farther right a pixel is."""
    depth = DepthPredictor(depth_from_blue(), CAMERA)(color)
    x = depth.camera.pixel_rays()[..., 0].astype(np.float32)
    return DepthPrediction(depth.depth_m * np.exp(0.15 * x), depth.camera, x - 2.0)


def test_particles_are_weighed_by_the_corrected_depth_and_then_by_corners(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    # So little evidence that tempering needs one stage.
    trust = SETTINGS.likelihood.model_copy(update={"effective_points": 10.0, "effective_corners": 5.0})
    config = SETTINGS.model_copy(update={"scale_tilt": ScaleTiltConfig(tilt_sd=0.15), "likelihood": trust})
    likelihood = _RecordedLikelihood(mixture, trust)
    localizer = localizer_at_truth(mixture, recording, thresholds, config, depth=tilted_depth, likelihood=likelihood)
    for index in range(FRAMES):
        likelihood.calls.clear()
        prior = localizer.particles
        step = localizer.step(recording.color(index), FRAME_S)
    uncorrected = tilted_depth(recording.color(index))
    assert np.std(np.log(step.depth.depth_m / uncorrected.depth_m)) > 0.01
    (poses, scan, sd, of_image), (same_poses, corners, corner_sd, of_corners), (pose, *_, at_pose) = likelihood.calls
    assert scan is step.scan and poses is same_poses
    assert (sd, corner_sd) == (trust.log_depth_sd, trust.corner_log_depth_sd)
    expected = scan_from_corners(step.motion, trust.max_corner_log_depth_sd)
    assert len(expected) > 10
    np.testing.assert_array_equal(corners.points, expected.points)
    weights = normalised(prior.log_weights + 10.0 * of_image + 5.0 * of_corners)
    weighed = estimate(Particles(poses, np.zeros(len(poses)), weights))
    np.testing.assert_allclose(step.particle_estimate.pose, weighed.pose, atol=1e-12)
    # The state depends on the scan at the particles' pose.
    np.testing.assert_array_equal(pose[0], step.particle_estimate.pose)
    assert step.mean_log_likelihood == at_pose[0]


def test_known_bias_is_subtracted_from_the_belief_and_not_from_the_particles(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    bias = np.array([0.02, -0.03, 0.01, 0.02, 0.0, -0.01])

    def steps(bias: ArrayLike) -> list[Any]:
        return follow(localizer_at_truth(mixture, recording, thresholds, bias=bias), recording)

    unbiased, corrected = steps(0.0), steps(bias)
    for one, other in zip(unbiased, corrected, strict=True):
        np.testing.assert_array_equal(one.particle_estimate.pose, other.particle_estimate.pose)
    # Depth is exact, so the corrected belief ends that far off, up to the centimetre that a bias may have.
    difference = se3_log(invert(unbiased[-1].estimate.pose) @ corrected[-1].estimate.pose)
    np.testing.assert_allclose(difference, -bias, atol=0.006)


def test_larger_bias_model_follows_odometry_more(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """Particles are the same whatever comes after them."""
    start = recording.poses[0] @ se3_exp([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    particles = scatter(start, SETTINGS.particles, 0.06, 0.03, 0.0, np.random.default_rng(0))

    def steps(bias_model: BiasModel) -> list[Any]:
        settings = SETTINGS.model_copy(update={"particle_bias": bias_model})
        localizer = make_localizer(mixture, thresholds, particles, recording.poses[:1], settings=settings)
        return follow(localizer, recording)

    small = steps(BiasModel(sd_at_reference_m=0.01))
    large = steps(BiasModel(sd_at_reference_m=0.01, sd_growth_m=50.0, sd_growth_rad=50.0))
    for one, other in zip(small, large, strict=True):
        np.testing.assert_array_equal(one.particle_estimate.pose, other.particle_estimate.pose)
    # With a large bias, the start is all that is known: the belief stays 10 cm off.
    errors_m = [np.linalg.norm(each[-1].estimate.pose[:3, 3] - recording.poses[-1][:3, 3]) for each in (small, large)]
    assert errors_m[0] < 0.03 < 0.07 < errors_m[1]
    sds_m = [np.sqrt(each[-1].estimate.covariance[0, 0]) for each in (small, large)]
    assert sds_m[0] < 0.03 and sds_m[1] > 0.06


@pytest.mark.parametrize(
    ("probability_wrong", "has_landmarks", "moves"), [(0.1, True, True), (0.9, False, True), (0.9, True, False)]
)
def test_scans_do_not_move_a_suspected_belief_that_landmarks_could_confirm(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    monkeypatch: pytest.MonkeyPatch,
    probability_wrong: float,
    has_landmarks: bool,
    moves: bool,
) -> None:
    monkeypatch.setattr(IntegrityMonitor, "probability_wrong", probability_wrong)
    monkeypatch.setattr(Bundle, "supports_landmark_search", has_landmarks)
    monkeypatch.setattr(Bundle, "supports_scan_search", False)  # else a suspected pose is first verified
    start = recording.poses[0] @ se3_exp([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    particles = scatter(start, SETTINGS.particles, 0.06, 0.03, 0.0, np.random.default_rng(0))
    steps = follow(make_localizer(mixture, thresholds, particles, recording.poses[:1], settings=SETTINGS), recording)
    error_m = np.linalg.norm(steps[-1].estimate.pose[:3, 3] - recording.poses[-1][:3, 3])
    assert error_m < 0.04 if moves else error_m > 0.07


def test_first_frame_without_contrast_leaves_the_start(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer = localizer_at_truth(mixture, recording, thresholds)
    step = localizer.step(BLACK, 0.0, NO_DEPTH)
    assert step.motion is None and len(step.scan) == 0 and np.isnan(step.mean_log_likelihood)
    assert step.state == "uncertain" and step.reasons >= {Reason.BELIEF_DOUBTFUL}  # nothing has confirmed the start
    assert np.linalg.norm(step.estimate.pose[:3, 3] - recording.poses[0][:3, 3]) < 0.01


@pytest.mark.parametrize(("away_m", "states"), [(0.0, {"tracking"}), (50.0, {"uncertain", "lost"})])
def test_start_is_vouched_for_once_something_confirms_it(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    away_m: float,
    states: set[str],
) -> None:
    """A start that sees none of the map may be in other units: no frame of it reaches an autopilot."""
    start = Start(se3_exp([away_m, 0.0, 0.0, 0.0, 0.0, 0.0]) @ recording.poses[0], error_m=0.03, error_rad=0.01)
    particles = start.particles(SETTINGS, np.random.default_rng(0))
    steps = follow(make_localizer(mixture, thresholds, particles, recording.poses[:1], settings=SETTINGS), recording)
    assert {step.state for step in steps} <= states


class _NoneFound(NoLandmarks):
    def __init__(self, expected: int) -> None:
        self._expected = expected

    def measure(self, seen: None, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        return LandmarkMeasurement(self._expected)


@pytest.mark.parametrize(("expected", "state"), [(0, "tracking"), (20, "tracking"), (200, "uncertain")])
def test_scan_does_not_confirm_a_start_where_landmarks_should_be_seen_and_are_not(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    expected: int,
    state: str,
) -> None:
    localizer = localizer_at_truth(mixture, recording, thresholds)
    localizer._landmarks = _NoneFound(expected)
    assert follow(localizer, recording, range(3))[0].state == state


class _Seen(NoLandmarks):
    def __init__(self, pose: FloatArray) -> None:
        self._pose = LandmarkPose(pose, 1e-6 * np.eye(6), np.zeros((30, 3)))

    def measure(self, seen: None, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        return LandmarkMeasurement(30, 30, self._pose)


def test_particles_that_landmarks_contradict_are_drawn_anew_around_the_belief(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """Without a scan nothing else would bring them back."""
    rng = np.random.default_rng(0)
    start = scatter(recording.poses[0] @ se3_exp([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]), 100, 0.03, 0.015, 0.0, rng)
    localizer = make_localizer(mixture, thresholds, start, recording.poses[:1])
    localizer._landmarks = _Seen(recording.poses[0])
    localizer.step(recording.color(0), FRAME_S, NO_DEPTH)
    away_m = np.linalg.norm(estimate(localizer.particles).pose[:3, 3] - recording.poses[0][:3, 3])
    assert away_m < 0.05


def test_landmark_pose_in_place_of_a_measurement_is_refused(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer, own = localizer_at_truth(mixture, recording, thresholds), _Seen(recording.poses[0])
    own.measure = lambda seen, prior, covariance: cast(Any, own._pose)  # type: ignore[method-assign]
    localizer._landmarks = own
    with pytest.raises(TypeError, match="landmarks measures must be a LandmarkMeasurement, got LandmarkPose"):
        localizer.step(recording.color(0), FRAME_S, NO_DEPTH)


def test_ten_particles_give_rigid_poses(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    config = SETTINGS.model_copy(update={"particles": 10})
    steps = follow(localizer_at_truth(mixture, recording, thresholds, config), recording)
    assert np.all(is_rigid(poses_of(steps)))


def test_poses_that_a_caller_changes_in_place_do_not_change_the_flight(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer, twin = (localizer_at_truth(mixture, recording, thresholds) for _ in range(2))
    for index in range(4):
        (step,), (other,) = (follow(each, recording, range(index, index + 1)) for each in (localizer, twin))
        np.testing.assert_array_equal(step.estimate.pose, other.estimate.pose)
        step.estimate.pose[:3, 1:3] *= -1.0  # to the axes of OpenGL
        step.estimate.covariance[:] *= 1e4
        if step.motion is not None:
            step.motion.T_previous_current[:3, 3] *= 100.0


def test_reset_begins_anew_at_another_place(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer = localizer_at_truth(mixture, recording, thresholds)
    follow(localizer, recording, range(3))
    localizer.reset(Start(recording.poses[9], error_m=0.03, error_rad=0.01))
    step = localizer.step(recording.color(9), 100.0, sparse_depth(recording, 9))
    assert step.motion is None  # odometry's last frame was elsewhere
    offset = np.linalg.norm(step.estimate.pose[:3, 3] - recording.poses[9][:3, 3])
    assert offset < 0.1 < np.linalg.norm(recording.poses[9][:3, 3] - recording.poses[2][:3, 3])
    assert step.state == "tracking"


def test_reset_without_a_start_is_refused_where_the_room_cannot_be_searched(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    unsearchable = plausible_integrity(thresholds, 0.2)
    localizer, twin = (localizer_at_truth(mixture, recording, thresholds, integrity=unsearchable) for _ in range(2))
    with pytest.raises(ValueError, match="start must be given"):
        localizer.reset(None)
    np.testing.assert_array_equal(*(poses_of(follow(each, recording, range(3))) for each in (localizer, twin)))


def test_frames_without_their_turn_have_no_depth_and_make_the_belief_no_surer(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer = localizer_at_truth(
        mixture, recording, thresholds, depth=DepthPredictor(depth_from_blue(), recording.camera)
    )
    steps = [
        localizer.step(recording.color(index), FRAME_S, level=Level.IN_TURN if index else Level.FULL)
        for index in range(FRAMES)
    ]
    assert [step.depth is None for step in steps] == [index % 2 == 1 for index in range(FRAMES)]
    assert all(len(step.scan) == (0 if index % 2 else 100) for index, step in enumerate(steps) if index)
    assert [step.level for step in steps[:2]] == [Level.FULL, Level.IN_TURN] and len(localizer.particles) == 100
    variances = [np.trace(step.estimate.covariance[:3, :3]) for step in steps]
    assert all(variances[index] > variances[index - 1] for index in range(1, FRAMES, 2))
    errors_m = np.linalg.norm(poses_of(steps)[:, :3, 3] - recording.poses[:FRAMES, :3, 3], axis=1)
    assert errors_m[FRAMES // 2 :].max() < 0.1


def test_depth_of_a_sensor_has_its_turn_too(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer = localizer_at_truth(mixture, recording, thresholds)
    follow(localizer, recording, range(1))
    steps = [
        localizer.step(recording.color(index), FRAME_S, sparse_depth(recording, index), level=Level.IN_TURN)
        for index in range(1, 5)
    ]
    assert [step.depth is None for step in steps] == [len(step.scan) == 0 for step in steps] == [True, False] * 2


def test_stream_that_was_frozen_goes_on_where_it_stopped(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """While the image repeats the camera may be anywhere; the next image shows that it is not."""
    localizer = localizer_at_truth(mixture, recording, thresholds)
    follow(localizer, recording, range(4))
    frozen = [localizer.step(recording.color(3), 0.1, NO_DEPTH) for _ in range(40)]
    assert frozen[0].state == "tracking" and frozen[-1].state == "lost"
    resumed = localizer.step(recording.color(4), 0.1, sparse_depth(recording, 4))
    assert resumed.state == "tracking"
    assert np.linalg.norm(resumed.estimate.pose[:3, 3] - recording.poses[4][:3, 3]) < 0.05


def test_time_of_a_search_does_not_choose_the_level(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No level leaves a search out, so its time would only make the flight after it worse."""
    ended: list[int] = []
    monkeypatch.setattr(StepBudget, "end", lambda self, plan: ended.append(plan.particles))
    config = SETTINGS.model_copy(update={"budget_ms": 1000.0})
    localizer = make_localizer(mixture, thresholds, None, recording.poses[:1], settings=config)
    steps = [*follow(localizer, recording), *follow(localizer, recording, range(FRAMES - 1, -1, -1))]
    counted = sum(step.mode is Mode.TRACKING and not step.restarted for step in steps[1:])
    assert {step.mode for step in steps} > {Mode.TRACKING} and len(ended) == counted


def test_cost_of_weighing_counts_the_particles_that_were_weighed(
    mixture: GaussianMixture,
    recording: RoomRecording,
    thresholds: LikelihoodThresholds,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    weighed: list[int] = []
    monkeypatch.setattr(StepBudget, "end", lambda self, plan: weighed.append(plan.particles))
    config = SETTINGS.model_copy(update={"budget_ms": 1000.0})
    localizer = localizer_at_truth(mixture, recording, thresholds, config)
    levels = (Level.FULL, Level.FULL, Level.FEWER_PARTICLES, Level.FEWER_PARTICLES, Level.FULL)
    for index, level in enumerate(levels):
        localizer.step(recording.color(index), FRAME_S, sparse_depth(recording, index), level=level)
    # The first step is not counted: a start may be rough.
    assert SETTINGS.particles > 100 and weighed == [SETTINGS.particles, SETTINGS.particles, 100, 100]


def test_two_threads_give_the_same_to_the_last_bit(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    def steps(threads: int) -> list[Step]:
        config = SETTINGS.model_copy(update={"threads": threads, "scale_tilt": ScaleTiltConfig()})
        predictor = DepthPredictor(depth_from_blue(), recording.camera)
        localizer = localizer_at_truth(mixture, recording, thresholds, config, depth=predictor)
        levels = [Level.IN_TURN if index > FRAMES // 2 else Level.FULL for index in range(FRAMES)]
        images = [BLACK if index == 3 else recording.color(index) for index in range(FRAMES)]
        return [localizer.step(image, FRAME_S, level=level) for image, level in zip(images, levels, strict=True)]

    for one, two in zip(steps(1), steps(2), strict=True):
        np.testing.assert_array_equal(one.estimate.pose, two.estimate.pose)
        np.testing.assert_array_equal(one.estimate.covariance, two.estimate.covariance)
        np.testing.assert_array_equal(one.scan.points, two.scan.points)


def test_a_localizer_that_nobody_holds_is_gone_at_once(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """Not at the next collection of circles: a flight through many rooms makes and drops many."""
    localizer = localizer_at_truth(mixture, recording, thresholds, SETTINGS)
    localizer.step(recording.color(0), FRAME_S, sparse_depth(recording, 0))
    watched = weakref.ref(localizer)
    gc.disable()
    try:
        del localizer
        assert watched() is None
    finally:
        gc.enable()
