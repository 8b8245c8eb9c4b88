"""What is said of a run that speaks for another room, another camera, or a covariance that is too small."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from altered_recordings import POSES, Altered, turning_path
from monoloc.bundle import Bundle
from monoloc.cli.run_doubts import doubts_of
from monoloc.edit_record import Edit, EditRecord
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from monoloc.supervision.state import Reason
from synthetic_room import Room, RoomRecording, make_bundle, make_path, room_mixture

FRAMES = 4
SOME = Landmarks(np.ones((3, 3), np.float32), np.zeros((3, 32), np.uint8))


@pytest.fixture(scope="module")
def room() -> Bundle:
    return make_bundle(room_mixture(Room()), RoomRecording(Room(), make_path(FRAMES)))


@pytest.fixture(scope="module")
def run(room: Bundle) -> Run:
    recording = RoomRecording(Room(), make_path(FRAMES))
    assert recording.poses is not None
    start = Start(recording.poses[0], 0.01, 0.01)
    return localize(room, recording, start, np.random.default_rng(0), NoProgress())


def doubts(run: Run, room: Bundle) -> Iterator[str]:
    return doubts_of(run, run.metrics(), room)


def test_good_run_is_not_doubted(room: Bundle, run: Run) -> None:
    assert list(doubts(run, room)) == []


def test_landmarks_that_no_frame_shows_speak_for_another_room(room: Bundle, run: Run) -> None:
    (doubt,) = doubts(run, replace(room, landmarks=SOME))
    assert doubt.startswith("no frame shows landmarks of this room; leave out --start, and the room is searched; if")
    searched = replace(run, start=None)
    (doubt,) = doubts(searched, replace(room, landmarks=SOME))
    assert doubt.startswith("no frame shows landmarks of this room; monoloc check")
    record = EditRecord(time="2026-01-02T03:04:05+00:00", kind="remove", parameters={}, changes={})
    (doubt,) = doubts(searched, replace(room, landmarks=SOME, edits=(Edit(record, b""),)))
    assert doubt.endswith("another room; monoloc map edit BUNDLE log shows what was edited")
    left_out = replace(run, config=run.config.model_copy(update={"without": ("landmarks",)}))
    assert list(doubts(left_out, replace(room, landmarks=SOME))) == []


def test_another_focal_length_speaks_for_another_camera(room: Bundle, run: Run) -> None:
    mismatch = [frozenset({Reason.CAMERA_MISMATCH}), *run.reasons[1:]]
    (doubt,) = doubts(replace(run, reasons=mismatch), room)
    assert doubt.startswith("in 1 of 4 frames, landmarks fit another lens than the camera's; check --camera")


def test_what_stands_still_in_the_images_is_said(room: Bundle, run: Run) -> None:
    (doubt,) = doubts(replace(run, standing_shares=np.array([0.0, 0.1, 0.15, 0.2])), room)
    assert doubt.startswith("12% of the image stands still in half of the frames or more, and is left out; clean")
    assert not list(doubts(replace(run, standing_shares=np.array([0.0, 0.0, 0.0, 0.2])), room))


def test_another_odometry_that_contradicts_the_images_is_said(room: Bundle, run: Run) -> None:
    (doubt,) = doubts(replace(run, motion_contradicted=np.array([False, True, False, False])), room)
    assert doubt.startswith("in 1 of 4 frames, the other odometry contradicts the motion that images show; check its")


def test_errors_beyond_the_covariance_are_said(room: Bundle, run: Run) -> None:
    (doubt,) = doubts(replace(run, covariances=1e-12 * run.covariances), room)
    problem = "0% of the errors lie within the stated 95 % ellipsoid"
    assert doubt.startswith(f"{problem}; leave out --start if it may be wrong, and do not use these poses,")
    (doubt,) = doubts(replace(run, covariances=1e-12 * run.covariances, start=None), room)
    assert doubt.startswith(f"{problem}; do not use these poses,")


def test_true_poses_of_another_convention_are_named_in_place_of_the_runs(room: Bundle) -> None:
    poses = turning_path(16)
    recording = RoomRecording(Room(), poses)
    flown = localize(room, recording, Start(poses[0], 0.01, 0.01), np.random.default_rng(0), NoProgress())
    stored = Altered(recording, poses=POSES["w first"].poses(poses))
    wrong = replace(flown, recording=stored, states=["tracking"] * 16)
    (doubt,) = doubts(wrong, room)
    assert doubt == (
        "the true poses agree with the estimated ones as quaternions with w first; give --fix-poses w-first"
    )


def test_a_start_that_was_wrong_until_the_camera_was_found_is_said(room: Bundle, run: Run) -> None:
    narrow = np.array([1e-12, 1e-12, 1e-12, 1.0])[:, None, None]
    late = replace(run, covariances=narrow * run.covariances, states=["uncertain"] * 3 + ["tracking"])
    (doubt,) = doubts(late, room)
    found = "from frame 3 on, where the camera was found, it is 100%: --start was wrong"
    assert doubt.startswith(f"25% of the errors lie within the stated 95 % ellipsoid; {found}")


def test_frames_that_are_far_off_while_tracking_are_counted(room: Bundle, run: Run) -> None:
    (doubt,) = doubts_of(run, {**run.metrics(), "silent_frames_30cm": 2}, room)
    assert doubt == "2 of 4 frames are *tracking* or *map-changed*, and more than 30 cm off"
