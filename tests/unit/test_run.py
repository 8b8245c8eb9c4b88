"""A recording, localised frame by frame, and its figures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.components import Components, default_components
from monoloc.errors import DataError
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose, rotation_angle, so3_exp
from monoloc.io.registry import select_frames
from monoloc.localizer import Localizer
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.step_budget import Level
from monoloc.supervision.map_change import ChangedRegion
from monoloc.supervision.state import Reason
from synthetic_room import SETTINGS, SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path

DOWN = np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(20), SMALL_CAMERA)


def exact_run(recording: RoomRecording) -> Run:
    """A run whose poses are the truth, of which the first six frames are of the build."""
    count = len(recording)
    return Run(
        recording=recording,
        config=SETTINGS,
        start=None,
        poses=recording.poses,
        covariances=np.repeat(np.eye(6)[None], count, axis=0),
        odometry=None,
        unseen=np.arange(count) > 5,
        states=["tracking"] * count,
        reasons=[frozenset()] * count,
        levels=[Level.FULL] * count,
        mean_log_likelihoods=np.zeros(count),
        log_scales=np.zeros(count),
        step_ms=np.ones(count),
        landmark_used=np.zeros(count, dtype=np.bool_),
        standing_shares=np.zeros(count),
        motion_contradicted=np.zeros(count, dtype=np.bool_),
        depth=None,
    )


def test_changed_regions_are_among_the_figures(recording: RoomRecording) -> None:
    region = ChangedRegion(np.array([0.0, 0.2, 0.4]), np.array([1.0, 1.2, 1.4]))
    named = replace(exact_run(recording), changed_regions=[(region, 7)]).metrics()["changed_regions"]
    assert named == [{"lower_m": [0.0, 0.2, 0.4], "upper_m": [1.0, 1.2, 1.4], "frames": 7}]
    assert exact_run(recording).metrics()["changed_regions"] == []


def test_silent_frames_are_tracking_and_far_off_or_outside_their_covariance(recording: RoomRecording) -> None:
    count = len(recording)
    poses = recording.poses.copy()
    poses[[1, 2, 7], 0, 3] += 0.4  # far off, inside a wide covariance
    poses[[3, 8], 0, 3] += 0.2  # near, outside a narrow covariance
    covariances = np.repeat(0.2**2 * np.eye(6)[None], count, axis=0)
    covariances[[3, 8]] *= 0.01
    states = ["tracking"] * count
    states[2] = "uncertain"
    reasons: list[frozenset[Reason]] = [frozenset()] * count
    reasons[2] = frozenset({Reason.NO_ODOMETRY, Reason.POSITION_WIDE})
    run = replace(exact_run(recording), poses=poses, covariances=covariances, states=states, reasons=reasons)
    figures = run.metrics()
    assert figures["reasons"] == {"position wide": 1, "no odometry": 1}
    assert (figures["silent_frames_30cm"], figures["unseen_silent_frames_30cm"]) == (2, 1)
    assert (figures["silent_frames_3_5_sigma"], figures["unseen_silent_frames_3_5_sigma"]) == (2, 1)
    assert figures["coverage_95"] == figures["coverage_99"] == pytest.approx(18 / 20)


def test_dead_reckoning_is_evaluated_from_the_truth_and_from_the_start(recording: RoomRecording) -> None:
    """Exact odometry from a start 5 cm aside stays 5 cm aside; from one that is rotated it drifts."""
    truth = recording.poses

    def figures(start: FloatArray) -> dict[str, object]:
        return replace(exact_run(recording), start=start, odometry=truth).metrics()

    aside = make_pose(np.eye(3), np.array([0.03, 0.0, 0.04]))
    for start, expected in ((truth[0], 0.0), (aside @ truth[0], 0.05)):
        found = figures(start)
        for prefix in ("", "unseen_"):
            assert found[f"{prefix}odometry_ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
            assert found[f"{prefix}odometry_from_start_ate_rmse_m"] == pytest.approx(expected, abs=1e-9)
    rotation = so3_exp([0.0, 0.1, 0.0])
    in_world = truth[0, :3, :3] @ rotation @ truth[0, :3, :3].T
    drift = (truth[:, :3, 3] - truth[0, :3, 3]) @ (in_world - np.eye(3)).T
    expected = float(np.sqrt(np.mean(np.sum(drift**2, axis=1))))
    found = figures(truth[0] @ make_pose(rotation, np.zeros(3)))
    assert found["odometry_from_start_ate_rmse_m"] == pytest.approx(expected)


def test_bias_of_the_network_is_not_subtracted_from_poses_by_sensor_depth(
    mixture: GaussianMixture, recording: RoomRecording
) -> None:
    few, poses = select_frames(recording, ":4"), []
    for bias_m in (0.0, 0.1):
        bundle = make_bundle(mixture, few)
        bias = np.full((len(few), 6), bias_m)
        bundle = replace(bundle, reference_poses=ReferencePoses(few.poses, bias, bias))
        rng, start = np.random.default_rng(0), Start(few.poses[0])
        poses.append(localize(bundle, few, start, rng, NoProgress(), use_sensor_depth=True).poses)
    np.testing.assert_array_equal(*poses)


def test_frames_are_counted_by_reason(mixture: GaussianMixture, recording: RoomRecording) -> None:
    few = select_frames(recording, ":4")
    bundle, rng, start = make_bundle(mixture, few), np.random.default_rng(0), Start(few.poses[0])
    run = localize(bundle, few, start, rng, NoProgress(), relight=np.zeros_like)
    counts = run.metrics()["reasons"]
    assert isinstance(counts, dict)
    assert list(counts) == [
        reason.value for reason in Reason if reason.value in counts
    ]  # the same order in every run
    for name, count in counts.items():
        assert count == sum(Reason(name) in reasons for reasons in run.reasons)
    # A stated start is believed for a third of a second; then darkness is a reason.
    assert counts["image empty"] == sum(state != "tracking" for state in run.states) > 0


def test_direction_of_gravity_rotates_the_poses(mixture: GaussianMixture, recording: RoomRecording) -> None:
    bundle = make_bundle(mixture, recording, range(0, 20, 5))
    assert bundle.down is not None and np.rad2deg(np.arccos(min(1.0, bundle.down @ DOWN))) < 0.5
    few = select_frames(recording, ":2")
    tilted = so3_exp([0.09, 0.0, 0.0]) @ np.swapaxes(few.poses[:, :3, :3], 1, 2) @ DOWN

    def first_rotation(down: FloatArray | None) -> FloatArray:
        rng, start = np.random.default_rng(0), Start(few.poses[0])
        return localize(bundle, few, start, rng, NoProgress(), down=down).poses[0][:3, :3]

    # The tilt of five degrees counts by the share that the start's three degrees give it.
    assert 0.005 < rotation_angle(first_rotation(None).T @ first_rotation(tilted)) < 0.09


def test_without_a_measured_motion_no_odometry_is_reported(
    mixture: GaussianMixture, recording: RoomRecording
) -> None:
    bundle, few = make_bundle(mixture, recording, range(2)), select_frames(recording, ":3")

    def without_odometry(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        return replace(default_components(bundle, camera, config), odometry=None)

    rng, start = np.random.default_rng(0), Start(few.poses[0])
    run = localize(bundle, few, start, rng, NoProgress(), components=without_odometry)
    assert run.odometry is None and "odometry_ate_rmse_m" not in run.metrics()


def test_gravity_is_one_direction_a_frame(mixture: GaussianMixture, recording: RoomRecording) -> None:
    bundle, few = make_bundle(mixture, recording, range(2)), select_frames(recording, ":3")
    with pytest.raises(ValueError, match=r"down must have shape \(3, 3\), got \(2, 3\)"):
        rng, start = np.random.default_rng(0), Start(few.poses[0])
        localize(bundle, few, start, rng, NoProgress(), down=np.ones((2, 3)))


def test_recording_without_frames_is_refused(mixture: GaussianMixture, recording: RoomRecording) -> None:
    bundle, empty = make_bundle(mixture, recording, range(2)), RoomRecording(Room(), recording.poses[:0])
    with pytest.raises(DataError, match="room: gives no frames; give a recording with at least one"):
        localize(bundle, empty, Start(recording.poses[0]), np.random.default_rng(0), NoProgress())


def test_components_of_ones_own_must_be_components(mixture: GaussianMixture, recording: RoomRecording) -> None:
    bundle = make_bundle(mixture, recording)

    def make(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        return cast(Any, {"depth": None})

    with pytest.raises(TypeError, match="components must be a function that returns Components, got dict from it"):
        Localizer(bundle, recording.camera, Start(recording.poses[0]), components=make)
