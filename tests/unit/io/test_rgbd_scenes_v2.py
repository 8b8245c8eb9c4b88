"""RGB-D Scenes v2: its layout, poses by frame number, and what may be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.camera import Camera
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from monoloc.io.rgbd_scenes_v2 import read_pose_file
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def room(tmp_path: Path) -> Path:
    synthetic.write_rgbd_scenes_v2(tmp_path)
    return tmp_path


def test_scene_is_read_as_stored(tmp_path: Path) -> None:
    expected = synthetic.write_rgbd_scenes_v2(tmp_path)
    for source in (f"rgbd-scenes-v2:{tmp_path}/imgs/scene_01", str(tmp_path)):
        recording = open_recording(source)
        check_recording(recording, 3)
        np.testing.assert_allclose(recording.poses, expected, atol=1e-9)
        assert recording.frame_names[1] == "00001"
        assert recording.depth(0).max() == 2.0  # 20000 / 10000
        assert recording.camera.fx == 570.3
    options = ReaderOptions(depth_scale=1000.0, camera=Camera(640, 480, 525.0, 525.0, 320.0, 240.0))
    overridden = open_recording(str(tmp_path), options)
    assert overridden.depth(0).max() == 20.0
    assert overridden.camera.fx == 525.0


def test_poses_are_paired_with_frame_numbers(tmp_path: Path) -> None:
    expected = synthetic.write_rgbd_scenes_v2(tmp_path)
    for kind in ("color", "depth"):
        (tmp_path / "imgs" / "scene_01" / f"00001-{kind}.png").unlink()
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.poses, expected[[0, 2]], atol=1e-9)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 2 / 30])


def test_several_scenes_are_refused(room: Path) -> None:
    synthetic.write_rgbd_scenes_v2(room, scene="02", frames=1)
    refuses_to_open(room, room, r"holds several scenes \(scene_01, scene_02\)", "give one of them, such as")


def test_folder_without_scene_number_is_refused(room: Path) -> None:
    folder = (room / "imgs" / "scene_01").rename(room / "imgs" / "kitchen")
    refuses_to_open(folder, folder, "is not named scene_NN", "ROOT/imgs/scene_NN")


def test_empty_scene_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "imgs" / "scene_01"
    folder.mkdir(parents=True)
    refuses_to_open(tmp_path, folder, "has no NNNNN-color.png images", "unpack")


def test_missing_depth_image_is_refused(room: Path) -> None:
    path = room / "imgs" / "scene_01" / "00001-depth.png"
    path.unlink()
    refuses_to_open(room, path, "is missing", "restore it or remove")


def test_missing_pose_file_is_refused(room: Path) -> None:
    (room / "pc" / "01.pose").unlink()
    refuses_to_open(room, room.resolve() / "pc" / "01.pose", "is missing", "ROOT/pc beside ROOT/imgs")


def test_pose_file_of_another_scene_is_refused(room: Path) -> None:
    path = room / "pc" / "01.pose"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    refuses_to_open(room, path, "has 2 poses, but frame 2 exists", "this scene's own")


def test_quaternion_of_zero_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "01.pose"
    path.write_text("1 0 0 0 0 0 0\n0 0 0 0 1 2 3\n")
    refuses_data(lambda: read_pose_file(path), path, "pose 2 is not rigid: its quaternion has length 0", "unit")
