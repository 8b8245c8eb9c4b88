"""Recordings of another convention are read as what they are, and unknown or useless fixes are refused."""

from __future__ import annotations

import numpy as np
import pytest

from altered_recordings import POSES, Altered
from monoloc.errors import DataError
from monoloc.geometry import se3_exp
from monoloc.io.corrected import Fixes, corrected
from monoloc.io.pose_fixes import CONVENTIONS, parse_pose_fixes
from refusals import refuses, refuses_setting
from synthetic_room import FRAME_RATE_HZ, SMALL_CAMERA, Room, RoomRecording, make_path


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(6), SMALL_CAMERA)


def test_every_convention_gives_rigid_poses() -> None:
    poses = make_path(6)
    for convention in CONVENTIONS.values():
        rotation = convention.convert(poses)[:, :3, :3]
        np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (6, 1, 1)), atol=1e-9)
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0)


def test_fixes_are_applied_in_their_order(recording: RoomRecording) -> None:
    assert recording.poses is not None
    stored = POSES["COLMAP"].poses(recording.poses)
    stored[:, :3, 3] *= 4.0
    fixed = corrected(Altered(recording, poses=stored), Fixes("w-first, scaled:0.25 ,world-to-camera"))
    assert fixed.poses is not None
    np.testing.assert_allclose(fixed.poses, recording.poses, atol=1e-9)


def test_late_poses_move_to_their_frames(recording: RoomRecording) -> None:
    assert recording.poses is not None
    for text, frames, rows in (("late:2", range(4), range(2, 6)), ("early:1", range(1, 6), range(5))):
        fixed = corrected(recording, Fixes(text))
        assert fixed.poses is not None
        np.testing.assert_array_equal(fixed.poses, recording.poses[list(rows)])
        assert fixed.frame_names == [recording.frame_names[frame] for frame in frames]
        np.testing.assert_array_equal(fixed.color(0), recording.color(frames[0]))
        np.testing.assert_array_equal(fixed.depth(0), recording.depth(frames[0]))


def test_late_poses_are_not_taken_from_another_sequence(recording: RoomRecording) -> None:
    """Two sequences of three frames, half a minute apart."""
    assert recording.poses is not None
    apart = Altered(recording)
    apart.timestamps_s = recording.timestamps_s + np.where(np.arange(len(recording)) < 3, 0.0, 30.0)
    for text, frames in (("late:1", [0, 1, 3, 4]), ("early:2", [2, 5])):
        assert corrected(apart, Fixes(text)).frame_names == [recording.frame_names[frame] for frame in frames]


def test_turned_depth_is_turned_back(recording: RoomRecording) -> None:
    fixed = corrected(recording, Fixes(depth="turned-180"))
    np.testing.assert_array_equal(fixed.depth(1)[::-1, ::-1], recording.depth(1))


def test_poses_late_by_a_time_move_between_frames() -> None:
    """At constant speed and turn, in which interpolation is exact."""
    rate_hz, twist = FRAME_RATE_HZ, np.array([0.1, -0.2, 0.3, 0.4, 0.1, -0.2])
    times_s = np.arange(6) / rate_hz
    recording = RoomRecording(Room(), se3_exp(times_s[:, None] * twist), SMALL_CAMERA)
    np.testing.assert_allclose(recording.timestamps_s, times_s)
    for text, delay_s, frames in (
        ("late:0.1s", 0.1, range(4)),
        ("early:0.05s", -0.05, range(1, 6)),
        ("late:1,late:0.1s", 0.1 + 1.0 / rate_hz, range(3)),
        ("late:0.2s,early:0.1s", 0.1, range(4)),
    ):
        fixed = corrected(recording, Fixes(text))
        assert fixed.frame_names == [recording.frame_names[frame] for frame in frames] and fixed.poses is not None
        expected = se3_exp((times_s[list(frames), None] + delay_s) * twist)
        np.testing.assert_allclose(fixed.poses, expected, atol=1e-9)


@pytest.mark.parametrize("text", ["late:0.2s,early:30s", "late:11s"])
def test_delays_that_no_poses_have_are_refused(text: str) -> None:
    refuses_setting(
        lambda: parse_pose_fixes(text), "fix_poses", "no poses are .* s (late|early)", "give at most 10 s"
    )


@pytest.mark.parametrize(
    "text",
    [
        "positions:xxy",
        "positions:x,z,y",
        "opengl,sideways",
        "late:1.5",
        "scaled:0",
        "late:",
        "",
        "late:0s",
        "late:-1s",
        "late:nans",
        "scaled:2s",
    ],
)
def test_unknown_fixes_are_refused(text: str) -> None:
    refuses_setting(
        lambda: parse_pose_fixes(text), "fix_poses", "is no fix", "names are w-first, .* late:FRAMES.* late:0.2s"
    )


def test_useless_fixes_are_refused(recording: RoomRecording) -> None:
    refuses_setting(
        lambda: parse_pose_fixes("opengl,positions:xyz"), "fix_poses", "leaves positions as they are", "leave it out"
    )
    refuses_setting(lambda: Fixes(depth="sideways"), "fix_depth", "is 'sideways'", "choose one of range, kinect")
    without = RoomRecording(Room(), make_path(2), SMALL_CAMERA, has_depth=False)
    refuses(lambda: corrected(without, Fixes(depth="range")), DataError, "has no depth to fix; leave out --fix-depth")
    without.poses = None
    refuses(lambda: corrected(without, Fixes("opengl")), DataError, "has no poses to fix; leave out --fix-poses")
    refuses(lambda: corrected(recording, Fixes("late:9")), DataError, "poses off by 9 leave none; give fewer")
    refuses(lambda: corrected(recording, Fixes("late:9s")), DataError, "poses off by 9 s leave none; give less in")
    refuses(
        lambda: corrected(recording, Fixes(depth="registered")), DataError, "not in the layout of 7-Scenes.*; leave"
    )
