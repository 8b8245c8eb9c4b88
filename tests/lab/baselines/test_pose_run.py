"""Runs of methods that localise frame by frame, and their figures."""

from __future__ import annotations

import numpy as np

from monoloc.evaluation.trajectory import summarise
from monoloc.geometry import FloatArray, se3_exp
from monoloc.progress import NoProgress
from monoloc_lab.baselines.pose_run import PoseRun, localize_all
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def poses_with_failure() -> tuple[FloatArray, FloatArray]:
    """Four poses with an error of 2 cm, the third missing; and the truth."""
    truth = make_path(4)
    poses = truth @ se3_exp(np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0]))
    poses[2] = np.nan
    return poses, truth


def test_failed_frames_count_as_outside_and_not_as_errors() -> None:
    poses, truth = poses_with_failure()
    run = PoseRun(poses, np.array([1.0, 2.0, 3.0, 4.0]))
    figures = run.metrics(truth, np.ones(4, np.bool_))
    localized = [0, 1, 3]
    assert figures["ate_rmse_m"] == summarise(poses[localized], truth[localized]).ate_rmse_m
    assert (figures["frames"], figures["failed_frames"]) == (4, 1)
    assert figures["within_5cm_5deg"] == 0.75
    assert figures["step_ms_median"] == 2.5
    assert run.metrics(truth, np.array([True, True, False, False]))["failed_frames"] == 0


def test_run_without_any_pose_has_no_errors() -> None:
    poses, truth = poses_with_failure()
    figures = PoseRun(poses, np.ones(4)).metrics(truth, np.array([False, False, True, False]))
    assert figures["ate_rmse_m"] is None and figures["rot_median_deg"] is None
    assert (figures["failed_frames"], figures["within_10cm_10deg"]) == (1, 0.0)
    whole = PoseRun(poses, np.ones(4)).metrics(truth, np.ones(4, np.bool_))
    assert whole.keys() == figures.keys()


def test_frames_come_in_order_with_their_time_and_light() -> None:
    recording = RoomRecording(Room(), make_path(3), SMALL_CAMERA)
    seen: list[tuple[int, float]] = []

    def method(color: np.ndarray, elapsed_s: float) -> FloatArray | None:
        seen.append((int(color.max()), elapsed_s))
        return None if len(seen) == 2 else np.eye(4)

    run = localize_all(recording, method, NoProgress(), lambda color: np.minimum(color, 7))
    assert [brightest for brightest, _ in seen] == [7, 7, 7]
    np.testing.assert_allclose([elapsed for _, elapsed in seen], np.diff(recording.timestamps_s, prepend=0.0))
    np.testing.assert_array_equal(run.failed, [False, True, False])
    assert (run.step_ms > 0.0).all()
