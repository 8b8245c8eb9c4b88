"""Flights through a room whose depth is known exactly: accuracy, darkness, and the state of an unknown pose."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.bundle import read_network
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.evaluation.consistency import consistency
from monoloc.evaluation.trajectory import pose_errors
from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.geometry import FloatArray, is_rigid, make_pose, se3_exp
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Localizer
from monoloc.map.mixture import GaussianMixture
from monoloc.odometry.motion import Motion
from monoloc.odometry.scale_tilt import ScaleTiltConfig
from monoloc.particle_filter.particles import scatter
from monoloc.progress import NoProgress
from monoloc.start import Start
from monoloc.step import Step
from monoloc.supervision.state import Reason
from synthetic_room import (
    BLACK,
    CAMERA,
    FRAME_S,
    NO_DEPTH,
    SETTINGS,
    Room,
    RoomRecording,
    depth_from_blue,
    follow,
    make_localizer,
    make_path,
    poses_of,
    sparse_depth,
)

FRAMES, SETTLED = 40, 15
START_ERROR_M, START_ERROR_RAD = 0.1, np.deg2rad(3.0)
DOWN = np.array([0.0, 1.0, 0.0])


class Flights:
    """Makes localizers that start beside the first frame of the recording."""

    def __init__(self, mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds) -> None:
        self.mixture, self.recording, self.thresholds = mixture, recording, thresholds

    def localizer(
        self, seed: int = 0, error_m: float = START_ERROR_M, error_rad: float = START_ERROR_RAD, **settings: Any
    ) -> Localizer:
        given = {name: settings.pop(name) for name in ("depth", "down", "landmarks") if name in settings}
        config = SETTINGS.model_copy(update=settings)
        rng = np.random.default_rng(seed)
        start = Start.disturbed(self.recording.poses[0], rng, error_m, error_rad).particles(config, rng)
        reference_poses = self.recording.poses[:1]
        return make_localizer(self.mixture, self.thresholds, start, reference_poses, rng, config, **given)

    def errors_m(self, steps: list[Step], first: int = 0) -> FloatArray:
        truth = self.recording.poses[first : first + len(steps)]
        return pose_errors(poses_of(steps), truth).position_m


@pytest.fixture(scope="module")
def flights(mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds) -> Flights:
    return Flights(mixture, recording, thresholds)


@pytest.fixture(scope="module")
def landmarks() -> Landmarks:
    built = RoomRecording(Room(), make_path(FRAMES, start_s=0.03)[::2])
    return build_landmarks(built, built.depth, NoProgress())[0]


# --- Accuracy ---


@pytest.fixture(scope="module")
def visual_flight(flights: Flights) -> list[Step]:
    return follow(flights.localizer(), flights.recording)


def test_pose_converges_from_a_disturbed_start(flights: Flights, visual_flight: list[Step]) -> None:
    truth = flights.recording.poses
    errors = pose_errors(poses_of(visual_flight), truth)
    # Over seeds 0..5: medians of 0.7 to 1.8 cm and 0.11 to 0.33 degrees, largest 3.4 cm. The map's 250 components
    # limit it: their mean diameter is 40 cm.
    assert np.median(errors.position_m[SETTLED:]) < 0.025
    assert errors.position_m[SETTLED:].max() < 0.06
    # Fused with odometry, the rotation changes more slowly than that of the particles.
    assert np.median(errors.rotation_rad[SETTLED:]) < np.deg2rad(0.6)
    particles = pose_errors(np.stack([step.particle_estimate.pose for step in visual_flight]), truth)
    assert np.median(particles.rotation_rad[SETTLED:]) < np.deg2rad(0.4)
    assert sum(step.state == "tracking" for step in visual_flight[SETTLED:]) >= 0.9 * (FRAMES - SETTLED)
    assert abs(visual_flight[-1].estimate.log_scale) < 0.02
    assert [step.motion is None for step in visual_flight] == [True] + [False] * (FRAMES - 1)


def test_covariance_covers_the_error(flights: Flights, visual_flight: list[Step]) -> None:
    poses, covariances = poses_of(visual_flight), np.stack([step.estimate.covariance for step in visual_flight])
    assert np.all(is_rigid(poses))
    # 0.73 to 1 over seeds 0..5: the errors of neighbouring frames are correlated, so less than 0.95 must do.
    truth = flights.recording.poses
    assert consistency(poses[SETTLED:], truth[SETTLED:], covariances[SETTLED:]).coverage_95 > 0.65
    # Covered because it is right, not because it is wide.
    assert np.sqrt(np.trace(covariances[-1, :3, :3])) < 0.05


@pytest.mark.slow
def test_random_walk_follows_less_accurately_than_odometry(flights: Flights, visual_flight: list[Step]) -> None:
    steps = follow(flights.localizer(motion="random-walk"), flights.recording)
    assert all(step.motion is None for step in steps)
    errors_m = flights.errors_m(steps)
    # Medians of 3 to 6 cm, largest 10 cm once settled over seeds 0..5.
    assert np.median(errors_m[SETTLED:]) < 0.12
    assert errors_m.max() < 0.3
    assert np.median(flights.errors_m(visual_flight)[SETTLED:]) < 0.7 * np.median(errors_m[SETTLED:])
    positions = flights.recording.poses[:, :3, 3]
    assert np.linalg.norm(positions - positions[0], axis=1).max() > 0.5


@pytest.mark.parametrize("scale", [0.9, pytest.param(1.1, marks=pytest.mark.slow)])
def test_wrong_scale_of_depth_is_estimated(flights: Flights, scale: float) -> None:
    localizer = flights.localizer(log_scale_sd=0.1)
    for index in range(30):
        exact = sparse_depth(flights.recording, index)
        step = localizer.step(
            flights.recording.color(index), FRAME_S, DepthPrediction(np.float32(scale) * exact.depth_m, exact.camera)
        )
    assert step.estimate.log_scale == pytest.approx(-np.log(scale), abs=0.03)
    assert flights.errors_m([step], index)[0] < 0.08


def test_tilt_of_depth_is_corrected(flights: Flights) -> None:
    localizer = flights.localizer(scale_tilt=ScaleTiltConfig(tilt_sd=0.15))
    errors = []
    for index in range(25):
        exact = sparse_depth(flights.recording, index)
        tilt = np.exp(0.15 * exact.camera.pixel_rays()[..., 0]).astype(np.float32)
        depth = DepthPrediction(exact.depth_m * tilt, exact.camera)
        step = localizer.step(flights.recording.color(index), FRAME_S, depth)
        errors.append([np.std(np.log(each.depth_m / exact.depth_m)) for each in (depth, step.depth)])
    uncorrected, corrected = np.median(errors[SETTLED:], axis=0)
    assert corrected < 0.6 * uncorrected


def test_predicted_depth_is_as_accurate_as_exact_depth(flights: Flights) -> None:
    localizer = flights.localizer(depth=DepthPredictor(depth_from_blue(), CAMERA))
    steps = [localizer.step(flights.recording.color(index), FRAME_S) for index in range(30)]
    assert steps[0].depth.depth_m.shape == (32, 40)
    assert np.median(flights.errors_m(steps)[SETTLED:]) < 0.03


def test_vague_start_is_found(flights: Flights) -> None:
    """60 cm and 20 degrees off: none of the particles is near enough."""
    steps = follow(flights.localizer(0, 0.6, np.deg2rad(20.0)), flights.recording)
    assert np.median(flights.errors_m(steps)[SETTLED:]) < 0.05


# --- Biased depth ---


def test_landmarks_correct_what_biased_depth_draws_away(flights: Flights, landmarks: Landmarks) -> None:
    """The depth's error looks like a step aside; a bias of 10 cm is known to be possible."""
    frames = 22
    step_aside = make_pose(np.eye(3), np.array([0.06, 0.0, 0.08]))
    camera = CAMERA.resized(80, 64)
    depths = [
        DepthPrediction(Room().view(pose @ step_aside, camera)[1], camera)
        for pose in flights.recording.poses[:frames]
    ]
    medians_m = []
    for known in (Landmarks.none(), landmarks):
        localizer = flights.localizer(
            particle_bias=BiasModel(sd_at_reference_m=0.1, sd_at_reference_rad=0.05),
            landmark_bias=LandmarkBiasModel(sd_at_reference_m=0.005, sd_at_reference_rad=0.003),
            landmarks=known,
        )
        steps = [localizer.step(flights.recording.color(index), FRAME_S, depth) for index, depth in enumerate(depths)]
        assert all((step.landmark_pose is None) == (len(known) == 0) for step in steps)
        assert localizer.step(BLACK, FRAME_S, NO_DEPTH).landmark_pose is None
        medians_m.append(np.median(flights.errors_m(steps)[SETTLED:]))
    assert medians_m[1] < 0.02 < 0.05 < medians_m[0]


def test_known_direction_of_gravity_corrects_biased_depth(flights: Flights) -> None:
    """Tilted depth rotates the particles' poses by four degrees and lifts them by 22 to 28 cm."""

    def errors(down: FloatArray | None) -> tuple[float, float]:
        bias = BiasModel(sd_at_reference_m=0.05, sd_at_reference_rad=0.06)
        localizer = flights.localizer(particle_bias=bias, down=down)
        steps = []
        for index in range(30):
            exact, rotation = sparse_depth(flights.recording, index), flights.recording.poses[index, :3, :3]
            tilt = np.exp(0.1 * exact.camera.pixel_rays()[..., 1]).astype(np.float32)
            depth = DepthPrediction(exact.depth_m * tilt, exact.camera)
            observed = None if down is None else 9.81 * rotation.T @ down
            steps.append(localizer.step(flights.recording.color(index), FRAME_S, depth, observed))
        rotations, true = (poses[SETTLED:30, :3, :3] for poses in (poses_of(steps), flights.recording.poses))
        tilts_rad = np.arccos(np.clip(np.einsum("nij,nij->nj", rotations, true)[:, 1], -1.0, 1.0))
        return float(np.median(flights.errors_m(steps)[SETTLED:])), float(np.median(tilts_rad))

    (unknown_m, unknown_rad), (known_m, known_rad) = errors(None), errors(DOWN)
    # Over seeds 0..2: 17, 14 and 23 cm become 7, 4 and 11.
    assert unknown_m > 0.12 and known_m < 0.6 * unknown_m
    assert known_rad < 0.8 * unknown_rad


# --- The state where the pose cannot be known ---


def test_scan_that_fits_nowhere_is_lost_where_no_landmarks_are_seen(flights: Flights, landmarks: Landmarks) -> None:
    """Depth of half the size, in the first second; landmarks say that the belief is right all the same.

    The one reference pose is that of the first frame.
    """
    for known, state, reasons in (
        (Landmarks.none(), "lost", {Reason.BELIEF_DOUBTFUL, Reason.FAR_FROM_BUILD}),
        (landmarks, "tracking", set()),
    ):
        localizer = flights.localizer(0, 0.02, 0.01, landmarks=known)
        for index in range(15):
            exact = sparse_depth(flights.recording, index)
            depth = DepthPrediction(np.float32(0.5) * exact.depth_m, exact.camera)
            step = localizer.step(flights.recording.color(index), FRAME_S, depth)
        assert step.mean_log_likelihood < flights.thresholds.lost
        assert (step.state, step.reasons) == (state, reasons)
    assert flights.errors_m([step], 14)[0] < 0.025


def test_certain_start_far_from_the_truth_is_not_tracking_for_long(flights: Flights) -> None:
    """A start is believed until scans have contradicted it for a third of a second."""
    recording, rng = flights.recording, np.random.default_rng(0)
    wrong = Start.disturbed(recording.poses[0], rng, 1.0, np.deg2rad(60.0)).pose
    particles = scatter(wrong, SETTINGS.particles, 0.02, 0.01, 0.0, rng)
    localizer = make_localizer(flights.mixture, flights.thresholds, particles, recording.poses, rng)
    states = [step.state for step in follow(localizer, recording, range(10))]
    assert set(states[5:]) <= {"uncertain", "lost"}


def test_camera_that_odometry_does_not_follow_is_uncertain(flights: Flights) -> None:
    """The depth fits, but nobody knows how the camera came there: the walls have another texture."""
    localizer = flights.localizer()
    before = follow(localizer, flights.recording, range(5))[-1]
    assert before.state != "lost" and before.motion is not None
    repainted = RoomRecording(Room(seed=5), flights.recording.poses[5:6])
    step = localizer.step(repainted.color(0), FRAME_S, sparse_depth(repainted, 0))
    assert step.motion is None and len(step.scan) > 0
    assert step.state == "uncertain"


@pytest.mark.slow
def test_darkness_widens_the_belief_and_light_narrows_it(flights: Flights) -> None:
    localizer = flights.localizer()
    before = follow(localizer, flights.recording, range(SETTLED))[-1]
    dark = [localizer.step(BLACK, FRAME_S, NO_DEPTH) for _ in range(6)]
    for step in dark:
        assert step.motion is None
        assert np.isnan(step.mean_log_likelihood)
        assert np.all(is_rigid(step.estimate.pose[None]))
    assert all(step.state != "tracking" for step in dark[3:])
    variances = [np.trace(step.estimate.covariance[:3, :3]) for step in (before, *dark)]
    assert np.all(np.diff(variances) > 0.0)
    # An unknown velocity that is constant for 0.4 s; one redrawn every frame would give 6 cm.
    assert 0.1 < np.sqrt(np.trace(dark[-1].particle_estimate.covariance[:3, :3]) / 3.0) < 0.2
    # The camera moved on in the dark; in the light it is found again.
    after = follow(localizer, flights.recording, range(SETTLED + 6, FRAMES))
    errors_m = flights.errors_m(after, SETTLED + 6)
    assert np.trace(after[-1].estimate.covariance[:3, :3]) < variances[-1]
    # Errors of 2 to 6 cm after the darkness over seeds 0..4, and of 0.4 to 2 cm a second and a half later.
    assert errors_m[0] < 0.12 and errors_m[-1] < 0.04
    assert after[-1].state == "tracking"


@pytest.mark.slow
def test_gyroscope_keeps_the_rotation_in_the_dark(flights: Flights) -> None:
    """While the light is off for 0.4 s, the camera turns by 30 degrees and moves 6 cm; nobody measures the latter."""
    before = flights.recording.poses[SETTLED - 1]
    step, count = se3_exp([0.01, 0.0, 0.0, 0.0, np.deg2rad(5.0), 0.0]), 6
    after = before @ np.linalg.matrix_power(step, count)
    beliefs = []
    for motion in (None, Motion.rotation(step[:3, :3], 0.003)):
        localizer = flights.localizer()
        follow(localizer, flights.recording, range(SETTLED))
        dark = [localizer.step(BLACK, FRAME_S, NO_DEPTH, measured_motion=motion) for _ in range(count)][-1]
        assert dark.state != "tracking" and {Reason.NO_ODOMETRY, Reason.IMAGE_EMPTY} <= dark.reasons
        beliefs.append(dark.estimate)
    blind, aided = pose_errors(np.stack([belief.pose for belief in beliefs]), np.stack([after, after])).rotation_rad
    # Measured: 0.16 and 30.1 degrees; 0.8 cm in the light.
    assert aided < np.deg2rad(1.5) and blind > np.deg2rad(25.0)
    # Both allow alike for a wrong belief, and only the blind one for a turn that nobody measured.
    blind_variances, aided_variances = (np.diag(belief.covariance) for belief in beliefs)
    turn_sd_rad = SETTINGS.motion_noise.turn_sd_rad_s * count * FRAME_S
    assert np.all(blind_variances[3:] - aided_variances[3:] > 0.9 * turn_sd_rad**2)
    assert aided_variances[:3].max() < 1.2 * blind_variances[:3].max()
    # In the light it is found at once.
    light = RoomRecording(Room(), (after @ step)[None])
    found = localizer.step(light.color(0), FRAME_S, sparse_depth(light, 0), measured_motion=motion)
    assert pose_errors(found.estimate.pose[None], light.poses).position_m[0] < 0.05


def test_after_a_long_darkness_the_belief_is_right_or_wide(flights: Flights) -> None:
    """The camera stands still; after four seconds it could be anywhere, and particles gather somewhere."""
    localizer = flights.localizer()
    follow(localizer, flights.recording, range(SETTLED))
    for _ in range(60):
        dark = localizer.step(BLACK, FRAME_S, NO_DEPTH)
    assert dark.state == "lost"
    for _ in range(25):
        step = localizer.step(flights.recording.color(SETTLED), FRAME_S, sparse_depth(flights.recording, SETTLED))
        spread_m = np.sqrt(np.trace(step.estimate.covariance[:3, :3]))
        assert flights.errors_m([step], SETTLED)[0] < 0.1 or spread_m > 0.5


def covered_lens(noise_seed: int | None) -> NDArray[np.uint8]:
    """The image of a camera whose lens is covered: black, or a sensor's noise."""
    if noise_seed is None:
        return BLACK
    return np.clip(np.random.default_rng(noise_seed).normal(4.0, 2.0, BLACK.shape), 0.0, 255.0).astype(np.uint8)


@pytest.mark.parametrize(
    ("network", "is_noisy"), [(depth_from_blue(), False), (read_network("tiny-0.35"), True)], ids=["black", "noise"]
)
def test_covered_lens_ends_in_lost(flights: Flights, network: DepthModel, is_noisy: bool) -> None:
    """A network predicts depth even for black images; the localizer must neither fail nor claim to know."""
    localizer = flights.localizer(depth=DepthPredictor(network, CAMERA))
    for index in range(8):
        before = localizer.step(flights.recording.color(index), FRAME_S)
    # A camera of unknown velocity, half a metre a second along any axis, is anywhere in the room after four seconds.
    steps = [localizer.step(covered_lens(index if is_noisy else None), FRAME_S) for index in range(60)]
    assert all(step.motion is None and len(step.scan) == 0 for step in steps)
    # A few frames of darkness are harmless.
    assert all(step.state != "tracking" and Reason.IMAGE_EMPTY in step.reasons for step in steps[3:])
    assert all(np.isfinite(step.estimate.covariance).all() for step in steps)
    variances = [np.trace(step.estimate.covariance[:3, :3]) for step in (before, *steps)]
    assert np.all(np.diff(variances) > 0.0)
    assert steps[-1].state == "lost"
