"""Localisation by keypoints of posed frames with depth."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.evaluation.trajectory import pose_errors
from monoloc.io.recording import Selection
from monoloc.progress import NoProgress
from monoloc_lab.baselines.keypoints import KeypointConfig, KeypointLocalizer, KeypointMap, build_keypoint_map
from synthetic_room import CAMERA, Room, RoomRecording, make_path

KINDS = ("orb", "sift")
BUILD, UNSEEN = range(0, 21, 5), range(2, 20, 7)


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(21))


def map_of(recording: RoomRecording, config: KeypointConfig) -> KeypointMap:
    return build_keypoint_map(Selection(recording, BUILD), config, NoProgress())


@pytest.mark.parametrize("kind", KINDS)
def test_unseen_frames_are_localised_and_others_have_no_pose(recording: RoomRecording, kind: str) -> None:
    config = KeypointConfig.model_validate({"kind": kind})
    room = map_of(recording, config)
    localizer = KeypointLocalizer(room, CAMERA, config)
    poses = [localizer(recording.color(index)) for index in UNSEEN]
    assert recording.poses is not None
    errors = pose_errors(np.stack([pose for pose in poses if pose is not None]), recording.poses[list(UNSEEN)])
    assert np.max(errors.position_m) < 0.02
    assert np.rad2deg(np.max(errors.rotation_rad)) < 0.5
    assert len(room.points) > 500
    assert np.percentile(Room().distance_m(room.points.astype(np.float64)), 95) < 0.01
    assert localizer(np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)) is None
    another_room = RoomRecording(Room(seed=5), make_path(2))
    assert [localizer(another_room.color(index)) for index in range(2)] == [None, None]


@pytest.mark.parametrize(("right", "has_pose"), [(8, False), (300, True)])
def test_keypoint_counts_once_however_many_frames_show_it(
    recording: RoomRecording, right: int, has_pose: bool
) -> None:
    """Five map frames from one place, of which only the first few points are right."""
    config = KeypointConfig(retrieved=5, min_inliers=30)
    room = build_keypoint_map(Selection(recording, [0]), config, NoProgress())
    count = len(room.points)
    rng = np.random.default_rng(0)
    points = np.concatenate([room.points[:right], rng.uniform(-2.0, 2.0, (count - right, 3)).astype(np.float32)])
    descriptors = np.repeat(room.descriptors[None], 5, axis=0)
    for frame, keypoint in np.ndindex(5, count):  # each frame is the nearest to a fifth of them, and gets votes
        descriptors[frame, keypoint, 0] ^= int(frame != keypoint % 5)
    repeated = KeypointMap(np.tile(points, (5, 1)), np.concatenate(descriptors), count * np.arange(6))
    assert (KeypointLocalizer(repeated, CAMERA, config)(recording.color(0)) is not None) == has_pose


@pytest.mark.parametrize(("kind", "descriptor_bytes"), [("orb", 32), ("sift", 128)])
def test_bytes_are_those_of_points_and_descriptors(
    recording: RoomRecording, kind: str, descriptor_bytes: int
) -> None:
    config = KeypointConfig.model_validate({"kind": kind, "keypoints": 100})
    room = build_keypoint_map(Selection(recording, [0, 5]), config, NoProgress())
    assert room.bytes == len(room.points) * (12 + descriptor_bytes) + 8 * 3


class Black(RoomRecording):
    def color(self, index: int) -> np.ndarray:
        return np.zeros_like(super().color(index))


def test_map_needs_poses_depth_and_texture() -> None:
    poses = make_path(1)
    unposed = RoomRecording(Room(), poses)
    unposed.poses = None
    for recording, message in (
        (RoomRecording(Room(), poses, has_depth=False), "room: has no depth; build from posed frames with depth"),
        (unposed, "room: has no poses; build from posed frames with depth"),
        (Black(Room(), poses), "room: has no frame with enough keypoints; build from lit frames"),
    ):
        with pytest.raises(DataError, match=message):
            build_keypoint_map(recording, KeypointConfig(), NoProgress())
