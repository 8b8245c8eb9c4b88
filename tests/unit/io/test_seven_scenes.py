"""7-Scenes: its layout, its cameras, and what may be missing or wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc import geometry
from monoloc.camera import Camera
from monoloc.io import seven_scenes
from monoloc.io.images import read_depth
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    synthetic.write_seven_scenes(tmp_path, frames=2)
    return tmp_path


def spoil_pose(scene: Path, row: int, column: int, value: float) -> Path:
    path = scene / "seq-01" / "frame-000002.pose.txt"
    pose = np.loadtxt(path)
    pose[row, column] = value
    np.savetxt(path, pose)
    return path


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_scene_joins_its_sequences(tmp_path: Path, suffix: str) -> None:
    T_world_depth = synthetic.write_seven_scenes(tmp_path, sequences=2, frames=2, suffix=suffix)
    recording = open_recording(f"7scenes:{tmp_path}")
    check_recording(recording, 4)
    assert recording.frame_names[::3] == ["seq-01/frame-000000", "seq-02/frame-000002"]
    np.testing.assert_allclose(recording.timestamps_s[:2], [0.0, 2 / 30])
    expected = T_world_depth @ geometry.invert(seven_scenes.T_COLOR_DEPTH)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-7)
    assert recording.camera.fx == 525.5


def test_one_sequence_has_the_scene_s_frame_names(tmp_path: Path) -> None:
    synthetic.write_seven_scenes(tmp_path, sequences=2, frames=2)
    recording = open_recording(str(tmp_path / "seq-02"))
    check_recording(recording, 2)
    assert recording.frame_names == ["seq-02/frame-000000", "seq-02/frame-000002"]


def test_both_marks_of_missing_depth_are_read(tmp_path: Path) -> None:
    synthetic.write_seven_scenes(tmp_path, frames=1)
    depth_m = read_depth(tmp_path / "seq-01/frame-000000.depth.png", 1000.0, seven_scenes.DEPTH_CAMERA)
    assert not depth_m[:2].any()  # stored as 0 and as 65535
    assert (depth_m[2:] == 2.0).all()


def test_depth_camera_is_read_from_the_scene(tmp_path: Path) -> None:
    synthetic.write_seven_scenes(tmp_path, frames=1)
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[600.0, 0, 321], [0, 601, 239], [0, 0, 1]])
    for path in (tmp_path, tmp_path / "seq-01"):
        recording = open_recording(str(path))
        assert recording.camera == seven_scenes.COLOR_CAMERA
        assert recording.registration.depth_camera == Camera(640, 480, 600.0, 601.0, 321.0, 239.0)


def test_depth_images_are_optional(tmp_path: Path) -> None:
    synthetic.write_seven_scenes(tmp_path, frames=1)
    (tmp_path / "seq-01" / "frame-000000.depth.png").unlink()
    assert not open_recording(str(tmp_path)).has_depth


def test_poses_are_optional(tmp_path: Path) -> None:
    synthetic.write_seven_scenes(tmp_path, frames=2)
    for path in (tmp_path / "seq-01").glob("*.pose.txt"):
        path.unlink()
    recording = open_recording(str(tmp_path))
    check_recording(recording, 2)
    assert recording.poses is None and recording.has_depth


def test_nan_pose_is_refused(scene: Path) -> None:
    path = spoil_pose(scene, 0, 3, np.nan)
    refuses_to_open(scene, path, "the pose of seq-01/frame-000002 is NaN", "correct it or remove the frame")


def test_pose_that_is_not_rigid_is_refused(scene: Path) -> None:
    path = spoil_pose(scene, 0, 0, 2.0)
    refuses_to_open(scene, path, "the pose of seq-01/frame-000002 is not rigid", "proper rotation")


def test_pose_that_is_not_four_rows_is_refused(scene: Path) -> None:
    path = scene / "seq-01" / "frame-000000.pose.txt"
    np.savetxt(path, np.eye(4)[:3])
    refuses_to_open(scene, path, "has 3 rows", "write a 4x4 camera-to-world matrix")


def test_one_missing_pose_is_refused(scene: Path) -> None:
    path = scene / "seq-01" / "frame-000002.pose.txt"
    path.unlink()
    refuses_to_open(scene, path, "cannot be read", "restore the file")


def test_one_missing_depth_image_is_refused(scene: Path) -> None:
    path = scene / "seq-01" / "frame-000002.depth.png"
    path.unlink()
    refuses_to_open(scene, path, "is missing", "remove the frame's other files")


def test_empty_sequence_is_refused(scene: Path) -> None:
    (scene / "seq-02").mkdir()
    refuses_to_open(scene, scene / "seq-02", "has no frame-NNNNNN.color images", "unpacked")


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    refuses_data(lambda: open_recording(f"7scenes:{tmp_path}"), tmp_path, "has no frame-", "give a 7-Scenes scene")


def test_images_of_another_size_are_refused(scene: Path) -> None:
    path = scene / "seq-01" / "frame-000000.color.png"
    synthetic.write_color(path, synthetic.make_color(320, 240))
    refuses_to_open(scene, path, "is 320x240, but the intrinsics are for 640x480", "give the intrinsics")


def test_intrinsics_of_another_shape_are_refused(scene: Path) -> None:
    path = scene / "camera-intrinsics.txt"
    np.savetxt(path, np.eye(3)[:2])
    refuses_to_open(scene, path, "has 2 rows instead of 3", "fx 0 cx")


def test_intrinsics_that_do_not_fit_are_refused(scene: Path) -> None:
    path = scene / "camera-intrinsics.txt"
    np.savetxt(path, [[585.0, 0.0, 900.0], [0.0, 585.0, 240.0], [0.0, 0.0, 1.0]])
    refuses_to_open(scene, path, "does not fit.*lies outside the 640x480 image", "fx 0 cx")
