"""Keypoints against posed frames with depth, and what any method's run is worth."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.evaluation.trajectory import pose_errors, summarise
from monoloc.geometry import FloatArray, se3_exp
from monoloc.io.recording import Selection
from monoloc.progress import NoProgress
from monoloc_lab.baselines.keypoints import KeypointConfig, KeypointLocalizer, KeypointMap, build_keypoint_map
from monoloc_lab.baselines.pose_run import PoseRun, locate_all
from synthetic_room import CAMERA, Room, RoomRecording, make_path

KINDS = ("orb", "sift")
BUILD, UNSEEN = range(0, 31, 5), range(2, 30, 7)


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(31))


def map_of(recording: RoomRecording, config: KeypointConfig) -> KeypointMap:
    return build_keypoint_map(Selection(recording, BUILD), config, NoProgress())


@pytest.mark.parametrize("kind", KINDS)
def test_unseen_frames_are_located(recording: RoomRecording, kind: str) -> None:
    config = KeypointConfig.model_validate({"kind": kind})
    localizer = KeypointLocalizer(map_of(recording, config), CAMERA, config)
    found = [localizer(recording.color(index)) for index in UNSEEN]
    assert recording.poses is not None
    errors = pose_errors(np.stack([pose for pose in found if pose is not None]), recording.poses[list(UNSEEN)])
    assert np.max(errors.position_m) < 0.02
    assert np.rad2deg(np.max(errors.rotation_rad)) < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_points_lie_on_the_room_s_surfaces(recording: RoomRecording, kind: str) -> None:
    room = map_of(recording, KeypointConfig.model_validate({"kind": kind}))
    assert len(room.points) > 500
    assert np.percentile(Room().distance_m(room.points.astype(np.float64)), 95) < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_image_without_keypoints_has_no_pose(recording: RoomRecording, kind: str) -> None:
    config = KeypointConfig.model_validate({"kind": kind})
    localizer = KeypointLocalizer(map_of(recording, config), CAMERA, config)
    assert localizer(np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)) is None


@pytest.mark.parametrize("kind", KINDS)
def test_another_room_has_no_pose(recording: RoomRecording, kind: str) -> None:
    config = KeypointConfig.model_validate({"kind": kind})
    localizer = KeypointLocalizer(map_of(recording, config), CAMERA, config)
    elsewhere = RoomRecording(Room(seed=5), make_path(3))
    assert [localizer(elsewhere.color(index)) for index in range(3)] == [None] * 3


@pytest.mark.parametrize(("true", "is_located"), [(8, False), (300, True)])
def test_a_keypoint_counts_once_however_many_frames_show_it(
    recording: RoomRecording, true: int, is_located: bool
) -> None:
    """Five frames of the map at one place, of whose points the first few alone are where they belong."""
    config = KeypointConfig(retrieved=5, min_inliers=30)
    room = build_keypoint_map(Selection(recording, [0]), config, NoProgress())
    count = len(room.points)
    rng = np.random.default_rng(0)
    points = np.concatenate([room.points[:true], rng.uniform(-2.0, 2.0, (count - true, 3)).astype(np.float32)])
    descriptors = np.repeat(room.descriptors[None], 5, axis=0)
    for frame, keypoint in np.ndindex(5, count):  # each frame is the nearest to a fifth of them, and gets votes
        descriptors[frame, keypoint, 0] ^= int(frame != keypoint % 5)
    shown = KeypointMap(np.tile(points, (5, 1)), np.concatenate(descriptors), count * np.arange(6))
    pose = KeypointLocalizer(shown, CAMERA, config)(recording.color(0))
    assert (pose is not None) == is_located


@pytest.mark.parametrize(("kind", "of_a_descriptor"), [("orb", 32), ("sift", 128)])
def test_bytes_are_what_is_stored(recording: RoomRecording, kind: str, of_a_descriptor: int) -> None:
    room = map_of(recording, KeypointConfig.model_validate({"kind": kind, "keypoints": 100}))
    assert room.bytes == len(room.points) * (12 + of_a_descriptor) + 8 * (len(BUILD) + 1)


def test_map_needs_poses_depth_and_texture() -> None:
    poses = make_path(2)
    with pytest.raises(DataError, match="room: has no depth; build from posed frames with depth"):
        map_of_all(RoomRecording(Room(), poses, has_depth=False))
    unposed = RoomRecording(Room(), poses)
    unposed.poses = None
    with pytest.raises(DataError, match="room: has no poses; build from posed frames with depth"):
        map_of_all(unposed)
    with pytest.raises(DataError, match="room: has no frame with enough keypoints; build from lit frames"):
        map_of_all(Dark(Room(), poses))


class Dark(RoomRecording):
    def color(self, index: int) -> np.ndarray:
        return np.zeros_like(super().color(index))


def map_of_all(recording: RoomRecording) -> KeypointMap:
    return build_keypoint_map(recording, KeypointConfig(), NoProgress())


# --- What a run is worth ---


def poses_with_failure() -> tuple[FloatArray, FloatArray]:
    """Four frames 2 cm off, the third without a pose; and the truth."""
    truth = make_path(4)
    poses = truth @ se3_exp(np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0]))
    poses[2] = np.nan
    return poses, truth


def test_failed_frames_count_as_outside_and_not_as_errors() -> None:
    poses, truth = poses_with_failure()
    run = PoseRun(poses, np.array([1.0, 2.0, 3.0, 4.0]))
    figures = run.metrics(truth, np.ones(4, np.bool_))
    located = [0, 1, 3]
    assert figures["ate_rmse_m"] == summarise(poses[located], truth[located]).ate_rmse_m
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
    recording = RoomRecording(Room(), make_path(3))
    seen: list[tuple[int, float]] = []

    def locate(color: np.ndarray, elapsed_s: float) -> FloatArray | None:
        seen.append((int(color.max()), elapsed_s))
        return None if len(seen) == 2 else np.eye(4)

    run = locate_all(recording, locate, NoProgress(), lambda color: np.minimum(color, 7))
    assert [brightest for brightest, _ in seen] == [7, 7, 7]
    np.testing.assert_allclose([elapsed for _, elapsed in seen], np.diff(recording.timestamps_s, prepend=0.0))
    np.testing.assert_array_equal(run.failed, [False, True, False])
    assert (run.step_ms > 0.0).all()
