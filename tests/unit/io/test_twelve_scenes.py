"""12-Scenes: its layout, its cameras, frames that are left out, and what may be missing or wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.camera import Camera
from monoloc.io.registry import open_recording
from refusals import refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    synthetic.write_twelve_scenes(tmp_path / "kitchen", [1, 2])
    return tmp_path / "kitchen"


def replace_in(file: Path, old: str, new: str) -> Path:
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    return file


def test_scene_joins_its_sequences(tmp_path: Path) -> None:
    poses = synthetic.write_twelve_scenes(tmp_path / "kitchen", [1, 2])
    recording = open_recording(str(tmp_path / "kitchen"))
    check_recording(recording, 3)
    assert recording.frame_names == ["sequence0/frame-000000", "sequence1/frame-000001", "sequence1/frame-000002"]
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 1.0 + 1 / 30, 1.0 + 2 / 30])
    np.testing.assert_allclose(recording.poses, poses, atol=1e-9)
    assert recording.camera == Camera(64, 48, 50.0, 50.0, 31.2, 23.2)


def test_depth_is_registered_to_colour_of_twice_its_size(scene: Path) -> None:
    depth_m = open_recording(f"12scenes:{scene}").depth(0)
    seen = depth_m > 0.0
    np.testing.assert_allclose(depth_m[seen], 2.0)
    assert 0.7 < seen.mean() < 1.0


@pytest.mark.parametrize("word", ["-INF", "inf", "-1.#INF", "nan"])
def test_frames_without_a_pose_or_depth_are_left_out_and_counted(scene: Path, word: str) -> None:
    (scene / "data/frame-000000.pose.txt").write_text("\n".join([" ".join([word] * 4)] * 4))
    (scene / "data/frame-000001.depth.png").unlink()
    recording = open_recording(str(scene))
    assert recording.frame_names == ["sequence1/frame-000002"]
    assert recording.notes == ["2 of 3 frames are left out: 1 without depth, 1 without a pose"]


def test_frames_in_no_sequence_and_without_pose_files_are_left_out(scene: Path) -> None:
    replace_in(scene / "split.txt", "end=2", "end=1")
    (scene / "data/frame-000000.pose.txt").unlink()
    notes = open_recording(str(scene)).notes
    assert notes == ["2 of 3 frames are left out: 1 in no sequence of split.txt, 1 without a pose"]


def test_scene_without_poses_is_refused(scene: Path) -> None:
    for file in (scene / "data").glob("*.pose.txt"):
        file.unlink()
    refuses_to_open(scene, scene, "none of its 3 frames can be used: 3 without a pose", "unpack")


@pytest.mark.parametrize(
    ("old", "new", "problem", "fix"),
    [
        ("m_depthShift = 1000", "", "m_depthShift is not 1 numbers", "unpack"),
        ("m_depthShift = 1000", "m_depthShift = 0", "m_depthShift is 0.0, not from", "stored value of one metre"),
        ("Intrinsic = 50.0", "Intrinsic = x", "m_calibrationColorIntrinsic is not 16 numbers", "unpack"),
        ("Intrinsic = 50.0", "Intrinsic = -50", "camera.fx/fy: is", "positive pixels"),
        ("DepthExtrinsic = 1 0 0 0", "DepthExtrinsic = 1 0 0 0.02", "DepthExtrinsic is not the identity", "share a"),
        ("m_depthWidth = 32", "m_depthWidth = 30000000", "camera.width/height: is", "at most"),
        ("m_depthHeight = 24", "m_depthHeight = 10000000", "camera.width/height: is", "at most"),
    ],
)
def test_wrong_calibration_is_refused(scene: Path, old: str, new: str, problem: str, fix: str) -> None:
    refuses_to_open(scene, replace_in(scene / "info.txt", old, new), problem, fix)


def test_depth_larger_than_any_sensor_s_is_refused_before_it_is_allocated(scene: Path) -> None:
    info = replace_in(scene / "info.txt", "m_depthWidth = 32", "m_depthWidth = 4000")
    replace_in(info, "m_depthHeight = 24", "m_depthHeight = 4000")
    refuses_to_open(scene, info, "says that depth is 4000x4000", "give the size of its depth images")


@pytest.mark.parametrize(
    ("old", "new"), [("start=1", "start=0"), ("end=2", "end=0"), ("[start=1 ; end=2]", ""), ("end=2", "end=x")]
)
def test_line_that_is_no_sequence_is_refused(scene: Path, old: str, new: str) -> None:
    split = replace_in(scene / "split.txt", old, new)
    refuses_to_open(
        scene, split, "line 2 is not the frames of a sequence", "sequence0 .frames=357. .start=0 ; end=356"
    )


def test_missing_files_are_named(scene: Path) -> None:
    (scene / "split.txt").write_text("\n")
    refuses_to_open(scene, scene / "split.txt", "names no sequence", "unpack")
    (scene / "split.txt").unlink()
    refuses_to_open(scene, scene / "split.txt", "is missing", "unpack the scene's archive again")
