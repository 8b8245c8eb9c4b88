"""A lost camera, or one whose start is unknown, is searched for in the whole room."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.depth.predictor import DepthPrediction
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, pose_distance_m, se3_exp
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.particles import Particles, scatter
from monoloc.progress import NoProgress
from monoloc.relocalization.state_machine import Mode
from monoloc.step import Step
from synthetic_room import (
    BLACK,
    FRAME_RATE_HZ,
    FRAME_S,
    NO_DEPTH,
    SETTINGS,
    Room,
    RoomRecording,
    follow,
    make_localizer,
    plausible_integrity,
    poses_of,
    room_mixture,
    sparse_depth,
)

FRAMES = 50


def errors_m(steps: list[Step], recording: RoomRecording, frames: range) -> FloatArray:
    return pose_errors(poses_of(steps), recording.poses[frames]).position_m


def states(steps: list[Step]) -> list[str]:
    return [step.state for step in steps]


def at_first_frame(recording: RoomRecording) -> Particles:
    return scatter(recording.poses[0], SETTINGS.particles, 0.03, 0.02, 0.0, np.random.default_rng(0))


def with_relocalization_sds(sd_m: float, sd_rad: float) -> LocalizerConfig:
    bias = SETTINGS.particle_bias.model_copy(update={"relocalization_sd_m": sd_m, "relocalization_sd_rad": sd_rad})
    return SETTINGS.model_copy(update={"particle_bias": bias})


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_camera_of_unknown_start_is_found(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds, seed: int
) -> None:
    localizer = make_localizer(mixture, thresholds, None, recording.poses[10::15], seed)
    frames = range(22)
    steps = follow(localizer, recording, frames)
    verified = round(FRAME_RATE_HZ)  # after a second, before which nothing is claimed
    assert set(states(steps[:verified])) == {"lost"}
    assert set(states(steps[verified + 1 :])) == {"tracking"}
    assert {step.mode for step in steps[:verified]} <= {Mode.SEARCHING, Mode.VERIFYING}
    assert np.all(errors_m(steps, recording, frames)[verified + 1 :] < 0.08)
    # Until then, the belief is as wide as the reference poses are spread.
    spreads_m = [np.sqrt(np.trace(step.estimate.covariance[:3, :3])) for step in steps]
    assert min(spreads_m[:verified]) > 0.3 and max(spreads_m[verified + 1 :]) < 0.1


def test_camera_carried_elsewhere_in_the_dark_is_found(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    localizer = make_localizer(mixture, thresholds, at_first_frame(recording), recording.poses[::10])
    assert follow(localizer, recording, range(5))[-1].state == "tracking"
    for _ in range(60):
        dark = localizer.step(BLACK, FRAME_S, NO_DEPTH)
    assert dark.state == "lost"
    frames = range(30, FRAMES)  # 0.7 m and 35 degrees from where it was
    steps = follow(localizer, recording, frames)
    assert set(states(steps[:15])) == {"lost"}
    assert steps[-1].state == "tracking"
    assert errors_m(steps, recording, frames)[-1] < 0.05


@pytest.mark.slow
def test_gap_counts_as_darkness(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """A frame that comes four seconds late leaves the position as unknown as four seconds in the dark."""
    localizer = make_localizer(mixture, thresholds, at_first_frame(recording), recording.poses[::10])
    assert follow(localizer, recording, range(5))[-1].state == "tracking"
    late = localizer.step(recording.color(30), 4.0, sparse_depth(recording, 30))
    forward = [late, *follow(localizer, recording, range(31, 46))]
    backward = range(45, 29, -1)
    steps = follow(localizer, recording, backward)
    assert set(states(forward[:15])) == {"lost"}
    assert steps[-1].state == "tracking"
    is_tracking = np.array(states(steps)) == "tracking"
    assert np.all(errors_m(steps, recording, backward)[is_tracking] < 0.05)


@pytest.mark.slow
def test_camera_whose_scans_do_not_fit_for_a_second_is_searched_for(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    wrong = recording.poses[0] @ se3_exp([1.0, 0.0, 0.5, 0.0, 1.2, 0.0])
    start = scatter(wrong, SETTINGS.particles, 0.02, 0.01, 0.0, np.random.default_rng(0))
    localizer = make_localizer(mixture, thresholds, start, recording.poses[::10])
    frames = range(FRAMES)
    steps = follow(localizer, recording, frames)
    # Suspected after less than a second, and verified for another.
    modes = [step.mode for step in steps]
    # The start was stated as certain, which a few scans do not outweigh.
    assert "tracking" not in states(steps[5 : modes.index(Mode.VERIFYING) + round(FRAME_RATE_HZ)])
    is_tracking = np.array(states(steps[5:])) == "tracking"
    assert is_tracking[-1] and np.all(errors_m(steps, recording, frames)[5:][is_tracking] < 0.05)


@pytest.mark.slow
def test_camera_whose_depth_has_the_wrong_scale_is_found_by_landmarks(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """Landmarks give the place at once; its scan is compared at the scale that the depth needs."""
    built = RoomRecording(Room(), recording.poses[20:FRAMES:2])
    landmarks, landmark_bias, _ = build_landmarks(built, built.depth, NoProgress())
    settings = with_relocalization_sds(0.2, 0.1).model_copy(
        update={"log_scale_sd": 0.05, "landmark_bias": landmark_bias}
    )
    localizer = make_localizer(
        mixture, thresholds, None, recording.poses[::10], settings=settings, landmarks=landmarks
    )
    frames, steps = range(30, FRAMES), []
    for index in frames:
        exact = sparse_depth(recording, index)
        depth = DepthPrediction(np.float32(np.exp(-0.05)) * exact.depth_m, exact.camera)
        steps.append(localizer.step(recording.color(index), FRAME_S, depth))
    found = next(index for index, step in enumerate(steps) if step.state != "lost")
    assert found < 18
    assert errors_m(steps, recording, frames)[found:].max() < 0.02
    # Not as uncertain as by scans alone: 20 cm an axis.
    assert np.sqrt(np.trace(steps[found].estimate.covariance[:3, :3])) < 0.1


def test_in_another_room_the_camera_is_never_tracking(
    recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """Half as wide again; whether the start is unknown, or given in the wrong room."""
    other, frames = room_mixture(Room(stretch=1.5)), range(20)
    searched = follow(make_localizer(other, thresholds, None, recording.poses[::10]), recording, frames)
    assert set(states(searched)) == {"lost"}
    started = follow(
        make_localizer(other, thresholds, at_first_frame(recording), recording.poses[:1]), recording, frames
    )
    assert "tracking" not in states(started[5:]) and "lost" in states(started)
    assert all(np.all(np.isfinite(step.estimate.pose)) for step in started)


@pytest.mark.slow
def test_room_whose_places_are_hard_to_tell_apart_is_not_searched(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """After a darkness, the particles are the same as without any reference poses, and what is claimed is right."""
    poses = []
    for reference_poses, search_precision in ((recording.poses[::10], 0.1), (recording.poses[:0], 0.9)):
        settings = SETTINGS.model_copy(update={"motion": "random-walk", "particles": 300})
        start = scatter(recording.poses[0], 300, 0.03, 0.02, 0.0, np.random.default_rng(0))
        integrity = plausible_integrity(thresholds, search_precision)
        localizer = make_localizer(
            mixture, thresholds, start, reference_poses, settings=settings, integrity=integrity
        )
        for _ in range(40):
            dark = localizer.step(BLACK, FRAME_S, NO_DEPTH)
        assert dark.estimate.position_is_unknown and dark.state == "lost"
        steps = follow(localizer, recording, range(2))
        assert all(step.mode is Mode.TRACKING for step in steps)
        for step, truth in zip(steps, recording.poses, strict=False):
            assert step.state != "tracking" or pose_distance_m(step.estimate.pose, truth[None])[0] < 0.3
        poses.append([step.particle_estimate.pose for step in steps])
    np.testing.assert_array_equal(*poses)


@pytest.mark.parametrize("motion", ["visual", pytest.param("random-walk", marks=pytest.mark.slow)])
def test_relocalized_pose_is_as_uncertain_as_was_measured(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds, motion: str
) -> None:
    settings = with_relocalization_sds(0.2, 0.1).model_copy(update={"motion": motion, "particles": 500})
    localizer = make_localizer(mixture, thresholds, None, recording.poses[10::15], settings=settings)
    steps = follow(localizer, recording, range(40))
    first = [step.mode for step in steps].index(Mode.TRACKING)
    sd = np.sqrt(np.diag(steps[first].estimate.covariance))
    np.testing.assert_allclose(sd, np.repeat([0.2, 0.1], 3), rtol=0.3)
    # It decreases with the motion, and not at once.
    next_sd, last_sd = (np.sqrt(np.diag(step.estimate.covariance)) for step in (steps[first + 1], steps[-1]))
    assert np.all(next_sd > 0.8 * sd) and np.all(last_sd < sd)


def test_without_odometry_a_camera_is_found_after_a_long_darkness(
    mixture: GaussianMixture, recording: RoomRecording, thresholds: LikelihoodThresholds
) -> None:
    """However fast particles spread in the dark, those under verification follow scans."""
    settings = SETTINGS.model_copy(update={"motion": "random-walk"})
    localizer = make_localizer(
        mixture, thresholds, at_first_frame(recording), recording.poses[::10], settings=settings
    )
    for _ in range(5):
        localizer.step(BLACK, 10.0, NO_DEPTH)
    frames = range(30, FRAMES)
    steps = follow(localizer, recording, frames)
    assert steps[-1].state == "tracking"
    assert errors_m(steps, recording, frames)[-1] < 0.08
