"""A walk reconstructed from its images: poses, depth, scale and the vertical, against the truth."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, MissingExtraError
from monoloc.geometry import FloatArray, make_pose, nearest_rotation, rotation_angle, so3_exp
from monoloc.io.colmap import parameters_of
from monoloc.io.folder_writer import write_folder
from monoloc.io.recording import Recording, recorded_down
from monoloc.io.registry import open_recording
from monoloc.progress import NoProgress
from monoloc.structure_from_motion import reconstruction
from monoloc.structure_from_motion.depth_scale import DepthScale
from monoloc.structure_from_motion.mapping import map_keyframes
from monoloc.structure_from_motion.metric_scale import MetricScale
from monoloc.structure_from_motion.reconstruction import Reconstruction, reconstruct
from monoloc.structure_from_motion.sparse_model import SparseModel
from refusals import refuses
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def found(walk: RoomRecording) -> Reconstruction:
    return reconstruct(walk, DepthScale(), refine_camera=False)


def aligned(poses: FloatArray, truth: FloatArray) -> FloatArray:
    """The true poses in the world of others: rigidly, with the mean rotation and the mean position."""
    R = nearest_rotation(np.einsum("nij,nkj->ik", poses[:, :3, :3], truth[:, :3, :3]))
    T = make_pose(R, poses[:, :3, 3].mean(axis=0) - R @ truth[:, :3, 3].mean(axis=0))
    return np.asarray(T @ truth)


def test_poses_and_scale_are_those_of_the_walk(walk: RoomRecording, found: Reconstruction) -> None:
    assert walk.poses is not None
    poses = found.model.poses
    truth = aligned(poses, walk.poses[found.model.frames])
    assert len(poses) >= 9
    # Here 1.8 mm and 0.06 degrees.
    assert np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1).max() < 0.008
    turned = np.swapaxes(poses[:, :3, :3], 1, 2) @ truth[:, :3, :3]
    assert np.rad2deg(rotation_angle(turned)).max() < 0.4
    assert found.model.reprojection_px() < 0.4
    assert found.recording.scale_sd == found.scale.sd < 0.02


def test_depth_is_that_of_the_room(walk: RoomRecording, found: Reconstruction) -> None:
    errors, shares = [], []
    for position, index in enumerate(found.model.frames.tolist()):
        depth, truth = found.recording.depth(position), walk.depth(index)
        known = depth > 0.0
        shares.append(known.mean())
        errors.append(np.abs(depth[known] / truth[known] - 1.0))
    assert np.mean(shares) > 0.5
    assert np.median(np.concatenate(errors)) < 0.01
    assert np.mean(np.concatenate(errors) < 0.1) > 0.96  # the rest is beside edges


def test_world_is_upright_and_begins_at_the_first_camera(found: Reconstruction) -> None:
    first = found.model.poses[0]
    assert first[:3, 3] == pytest.approx(np.zeros(3), abs=1e-12)
    assert first[1, 2] == pytest.approx(0.0, abs=1e-12) and first[0, 2] > 0.5
    assert walk_up(found) @ [0.0, -1.0, 0.0] > np.cos(np.deg2rad(6.0))


def walk_up(found: Reconstruction) -> FloatArray:
    """The upward axis of the found world, in that of the synthetic room, whose y points down."""
    truth = make_path(12, rate_hz=3.0)[found.model.frames]
    R = nearest_rotation(np.einsum("nij,nkj->ik", truth[:, :3, :3], found.model.poses[:, :3, :3]))
    return np.asarray(R @ [0.0, 0.0, 1.0])


class _Bent:
    """A scale that some keyframes contradict."""

    def __init__(self, bent: list[int]) -> None:
        self._bent = bent

    def frames(self, recording: Recording) -> list[int]:
        return []

    def measure(self, recording: Recording, model: SparseModel, depths: Sequence[NDArray[np.float32]]) -> MetricScale:
        scale = DepthScale().measure(recording, model, depths)
        return replace(scale, is_bent=np.isin(np.arange(len(depths)), self._bent))


def test_frames_of_a_bent_part_are_left_out(walk: RoomRecording, found: Reconstruction) -> None:
    left = reconstruct(walk, _Bent([4]), refine_camera=False)
    assert left.model.frames.tolist() == np.delete(found.model.frames, [4]).tolist()
    assert len(left.recording) == len(left.depths) == len(found.depths) - 1
    assert (
        sum(
            f"1 of {left.model.tried} keyframes are left out: depth contradicts" in note
            for note in left.recording.notes
        )
        == 1
    )
    many = list(range(6))
    refuses(
        lambda: reconstruct(walk, _Bent(many), refine_camera=False),
        DataError,
        "is bent: depth contradicts 6 of . keyframes; film",
    )


def test_recording_is_of_the_placed_frames(walk: RoomRecording, found: Reconstruction) -> None:
    recording = found.recording
    assert recording.frame_names == [walk.frame_names[index] for index in found.model.frames]
    np.testing.assert_array_equal(recording.color(3), walk.color(int(found.model.frames[3])))
    assert recording.notes[0].startswith("poses and depth come from structure from motion, ")
    assert recording.notes[1].startswith("the scale comes from depth of ")


@pytest.mark.parametrize(
    ("is_upright", "down", "note"), [(True, [0.0, 0.0, -1.0], "comes from"), (False, None, "is not known")]
)
def test_gravity_is_written_where_surfaces_tell_it(
    walk: RoomRecording,
    found: Reconstruction,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_upright: bool,
    down: list[float] | None,
    note: str,
) -> None:
    unscaled = found.model.scaled(1.0 / found.scale.metres)
    monkeypatch.setattr(reconstruction, "map_keyframes", lambda *_: unscaled)
    monkeypatch.setattr(reconstruction, "levelled", lambda model, *_: (model, is_upright))
    again = reconstruct(walk, DepthScale(), refine_camera=False)
    assert again.recording.notes[2].startswith(f"the direction of gravity {note}")
    write_folder(tmp_path / "walk", again.recording, again.depths)
    written = recorded_down(open_recording(str(tmp_path / "walk")))
    assert (None if written is None else written.tolist()) == down


@pytest.mark.slow
def test_same_seed_gives_the_same(walk: RoomRecording) -> None:
    first, second = (map_keyframes(walk, np.arange(8), False, 3, NoProgress()) for _ in range(2))
    np.testing.assert_array_equal(first.poses, second.poses)
    np.testing.assert_array_equal(first.points, second.points)


@pytest.mark.slow
def test_unknown_focal_length_is_found_within_its_error(walk: RoomRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    guess = Camera(160, 128, 150.0, 150.0, 79.5, 63.5)
    monkeypatch.setattr(walk, "camera", guess)
    model = reconstruct(walk, DepthScale(), refine_camera=True).model
    assert abs(model.camera.fx - SMALL_CAMERA.fx) < 2.0 * model.camera_sd["f"] < 12.0
    assert model.camera.fy == model.camera.fx and model.camera.cx == guess.cx
    assert model.camera_sd.keys() == {"f", "k1", "k2"}


@pytest.mark.slow
def test_camera_that_turns_on_the_spot_is_refused() -> None:
    turns = make_pose(so3_exp([[0.0, 0.08 * i, 0.0] for i in range(9)]), np.zeros((9, 3)))
    recording = RoomRecording(Room(), turns, SMALL_CAMERA)
    refuses(
        lambda: reconstruct(recording, DepthScale(), refine_camera=False),
        DataError,
        "room: shows no depth: the camera turns on the spot",
    )


def test_frames_of_different_rooms_are_refused() -> None:
    recording = RoomRecording(Room(), make_path(9, rate_hz=3.0), SMALL_CAMERA)
    recording._views = [Room(seed).view(np.eye(4), SMALL_CAMERA) for seed in range(9)]
    refuses(
        lambda: reconstruct(recording, DepthScale(), refine_camera=False),
        DataError,
        "room: only 0 of 9 keyframes could be placed; walk slower",
    )


def test_camera_at_rest_is_refused() -> None:
    recording = RoomRecording(Room(), np.tile(np.eye(4), (6, 1, 1)), SMALL_CAMERA)
    refuses(
        lambda: reconstruct(recording, DepthScale(), refine_camera=False),
        DataError,
        "room: moves so little that it has 1 keyframe; at least 8",
    )


def test_missing_pycolmap_is_named(walk: RoomRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingExtraError, match='a map from images without poses needs the extra "sfm"'):
        reconstruct(walk, DepthScale(), refine_camera=False)


@pytest.mark.parametrize(
    ("camera", "name", "parameters"),
    [
        (Camera(64, 48, 50.0, 51.0, 31.0, 23.0), "OPENCV", [50, 51, 31.5, 23.5, 0, 0, 0, 0]),
        (
            Camera(64, 48, 50.0, 51.0, 31.0, 23.0, (-0.1, 0.02, 0.001, 0.002, 0.03)),
            "FULL_OPENCV",
            [50, 51, 31.5, 23.5, -0.1, 0.02, 0.001, 0.002, 0.03, 0, 0, 0],
        ),
        (
            Camera(64, 48, 50.0, 51.0, 31.0, 23.0, (0.1, 0.2, 0.0, 0.0), "fisheye"),
            "OPENCV_FISHEYE",
            [50, 51, 31.5, 23.5, 0.1, 0.2, 0, 0],
        ),
    ],
)
def test_cameras_are_given_as_colmap_takes_them(camera: Camera, name: str, parameters: list[float]) -> None:
    assert parameters_of(camera) == (name, pytest.approx(parameters))
