"""Poses are confirmed or contradicted by landmarks; a recording of which no pose is confirmed is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from altered_recordings import Altered
from edit_helpers import VOXEL_M, bundle_of_walk, in_another_world, walk
from monoloc.bundle import Bundle
from monoloc.editing.alignment import poses_by_landmarks
from monoloc.editing.world_check import WorldCheck, check_same_world
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.io.recording import Recording
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.map.cloud import cloud_from_recording
from refusals import refuses_data
from synthetic_room import Room, RoomRecording, make_path

pytestmark = pytest.mark.usefixtures("one_thread")
HALF_TURN = make_pose(so3_exp(np.array([0.0, np.pi, 0.0])), np.zeros(3))


def checked(recording: Recording, room: Bundle | None = None) -> WorldCheck:
    room = room or bundle_of_walk("A")
    cloud = cloud_from_recording(recording, VOXEL_M)
    return check_same_world(room, recording, poses_by_landmarks(room, recording), cloud)


def without_landmarks_in_sight(recording: RoomRecording) -> Altered:
    """The same depth and poses, in light in which no landmark is recognised."""
    return Altered(recording, color=lambda color: np.full_like(color, 90))


def test_right_poses_are_confirmed_by_where_landmarks_see_the_camera() -> None:
    check = checked(walk("A"))
    assert (check.confirmed, check.contradicted, check.looked_at) == (14, 0, 14)


def test_right_poses_are_confirmed_by_depth_where_no_landmark_is_recognised() -> None:
    check = checked(without_landmarks_in_sight(walk("A")))
    assert check.confirmed >= 12 and check.contradicted == 0


def test_depth_of_another_place_contradicts_poses() -> None:
    nearer = Altered(without_landmarks_in_sight(walk("A")), depth=lambda depth: 0.7 * depth)
    refuses_data(
        lambda: checked(nearer), "walk-A", "contradicts the map: 0 of 1. frames see the landmarks", "--align"
    )


def test_frames_that_landmarks_see_elsewhere_contradict_poses() -> None:
    poses = walk("A").poses
    assert poses is not None
    shuffled = Altered(walk("A"), poses=poses[::-1] @ HALF_TURN)
    refuses_data(lambda: checked(shuffled), "walk-A", "contradicts the map: 0 of 14 frames see", "monoloc check")


def away(begins_in_the_map: int) -> RoomRecording:
    """Eight frames that turn their back on the map's landmarks, after some of the map's walk."""
    walk_poses = walk("A").poses
    assert walk_poses is not None
    poses: FloatArray = make_path(8) @ HALF_TURN
    return RoomRecording(Room(), np.concatenate([walk_poses[:begins_in_the_map], poses]))


def test_a_part_that_the_map_never_saw_says_nothing() -> None:
    assert checked(away(begins_in_the_map=1)) == WorldCheck(confirmed=1, contradicted=0, looked_at=9)


def test_recording_of_which_landmarks_confirm_no_frame_is_refused() -> None:
    problem = "shows nothing of the map: its landmarks confirm none of the 8 frames looked at"
    refuses_data(lambda: checked(away(begins_in_the_map=0)), "room", problem, "begins where .* build a place")


def test_without_landmarks_the_map_must_know_some_of_the_surfaces() -> None:
    bare = replace(bundle_of_walk("A"), landmarks=Landmarks.none())
    assert checked(walk("B"), bare) == WorldCheck(confirmed=0, contradicted=0, looked_at=0)
    elsewhere = in_another_world(walk("B"), make_pose(np.eye(3), np.array([40.0, 0.0, 0.0])))
    problem = "where its poses place it, the map knows 0% of its surfaces"
    refuses_data(lambda: checked(elsewhere, bare), "walk-B", problem, "in the map's world that begins where")
