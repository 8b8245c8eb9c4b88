"""RTAB-Map's exports in formats 10 and 11, named by id and by stamp, and what may be wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_writers import (
    Z_UP,
    Capture,
    check_opened,
    doubled,
    halved,
    in_world,
    write_rtabmap,
    write_rtabmap_calibration,
)
from monoloc.camera import Camera
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def capture(capture: Capture) -> Capture:
    return in_world(capture, Z_UP)


@pytest.fixture
def folder(tmp_path: Path, capture: Capture) -> Path:
    write_rtabmap(tmp_path / "export", capture)
    return tmp_path / "export"


@pytest.mark.parametrize(("poses_format", "by_stamp"), [(11, False), (11, True), (10, False), (10, True)])
def test_export_opens(tmp_path: Path, capture: Capture, poses_format: int, by_stamp: bool) -> None:
    write_rtabmap(tmp_path, capture, poses_format=poses_format, by_stamp=by_stamp)
    recording = open_recording(str(tmp_path))
    check_recording(recording, len(capture))
    check_opened(recording, capture, [doubled(halved(each)) for each in capture.depths_mm])
    assert recording.camera == capture.camera and recording.name == "room" and recording.notes == []
    np.testing.assert_allclose(recording.timestamps_s, capture.times_s + 1.7e9, atol=1e-5)
    if not by_stamp:
        assert recording.frame_names == [str(9 + 3 * index) for index in range(12)]  # 9 before 12


def test_files_that_macos_adds_on_other_disks_are_no_images(tmp_path: Path, capture: Capture) -> None:
    write_rtabmap(tmp_path, capture, poses_format=10)
    for file in list((tmp_path / "room_rgb").iterdir()):
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\26\7\0\2\0\0Mac OS X")
    recording = open_recording(str(tmp_path))
    assert len(recording) == len(capture) and recording.notes == []


def test_images_without_pose_calibration_or_depth_are_counted(folder: Path) -> None:
    poses = folder / "room_camera_poses.txt"
    poses.write_text("".join(line for line in poses.read_text().splitlines(True) if not line.endswith(" 12\n")))
    (folder / "room_calib/15.yaml").unlink()
    (folder / "room_depth/18.png").unlink()
    recording = open_recording(str(folder))
    assert recording.frame_names == ["9", *(str(node) for node in range(21, 45, 3))]
    assert recording.notes == [
        "3 of 12 frames are left out: 1 without a pose, 1 without a calibration, 1 without depth",
    ]


@pytest.mark.parametrize(
    ("distortion", "projected", "expected"),
    [
        ((0.1, -0.05, 0.001, 0.002), False, ("brown", (0.1, -0.05, 0.001, 0.002, 0.0))),
        ((0.1, -0.05, 0.001, 0.002, 0.0, 0.1, 0.0, 0.0), False, ("rational", None)),
        ((0.1, -0.05, 0.0, 0.0, 0.01, -0.002), False, ("fisheye", (0.1, -0.05, 0.01, -0.002))),
        ((0.1, -0.05, 0.001, 0.002, 0.0), True, ("brown", (0.0,) * 5)),
    ],
)
def test_lens_is_that_of_the_images(
    folder: Path, distortion: tuple[float, ...], projected: bool, expected: tuple[str, tuple[float, ...] | None]
) -> None:
    """Images with a projection matrix are rectified by it."""
    camera, rectified = Camera(160, 128, 136.0, 138.0, 75.5, 66.0), Camera(160, 128, 130.0, 131.0, 80.0, 63.0)
    for file in (folder / "room_calib").iterdir():
        write_rtabmap_calibration(file, camera, distortion, rectified if projected else None)
    opened = open_recording(str(folder)).camera
    assert opened.distortion_model == expected[0]
    assert opened.distortion == (expected[1] or distortion)
    assert opened.fx == (130.0 if projected else 136.0) and opened.cy == (63.0 if projected else 66.0)


def test_images_of_a_moving_focus_are_rendered_as_one(folder: Path, capture: Capture) -> None:
    """Nodes are sorted by time, and each keeps its own calibration."""
    longer = Camera(160, 128, 1.03 * 136.0, 1.03 * 138.0, 75.5, 66.0)
    write_rtabmap_calibration(folder / "room_calib/18.yaml", longer)
    recording = open_recording(str(folder))
    assert recording.camera == capture.camera
    v, u = np.mgrid[10:118:9, 10:150:7]
    x, y = (u - 75.5) * 1.03 + 75.5, (v - 66.0) * 1.03 + 66.0
    stored = capture.colors[3][np.rint(y).astype(int), np.rint(x).astype(int)].astype(float)
    assert np.abs(recording.color(3)[v, u] - stored).mean() < 5.0
    np.testing.assert_allclose(recording.depth(2), doubled(halved(capture.depths_mm[2])) / 1000.0, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("no yaml", "cannot be read as a calibration|has no camera_matrix"),
        ("%YAML:1.0\n---\nimage_width: 160\nimage_height: 128\n", "has no camera_matrix of 9 numbers"),
        ("%YAML:1.0\n---\nimage_width: [\n", "cannot be read as a calibration"),
    ],
)
def test_malformed_calibration_is_refused(
    folder: Path, text: str, problem: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder / "room_calib/12.yaml").write_text(text)
    refuses_to_open(folder, folder / "room_calib/12.yaml", problem, "rtabmap-export")
    assert capfd.readouterr().err == ""


def test_unknown_lens_is_refused(folder: Path, capture: Capture) -> None:
    path = folder / "room_calib/12.yaml"
    write_rtabmap_calibration(path, capture.camera, [0.1] * 12)
    refuses_to_open(folder, path, "has 12 distortion coefficients", "rectify the images")
    write_rtabmap_calibration(path, capture.camera.resized(16, 12))
    assert "1 of another image size or lens" in open_recording(str(folder)).notes[0]


def test_poses_without_ids_must_be_as_many_as_images(tmp_path: Path, capture: Capture) -> None:
    write_rtabmap(tmp_path, capture, poses_format=10)
    (tmp_path / "room_rgb/12.jpg").unlink()
    path = tmp_path / "room_camera_poses.txt"
    refuses_to_open(tmp_path, path, "has 12 poses without an id for 11 images", "--poses_format 11")


def test_several_exports_are_told_apart(folder: Path, capture: Capture) -> None:
    write_rtabmap(folder, capture, name="attic")
    refuses_data(
        lambda: open_recording(f"rtabmap:{folder}"), folder, "holds several exports", "attic_camera_poses.txt"
    )
    assert open_recording(str(folder / "attic_camera_poses.txt")).name == "attic"


@pytest.mark.parametrize(
    ("name", "problem", "fix"),
    [
        ("room_camera_poses_0.txt", "is an export of several cameras", "one camera"),
        ("room_left", "is an export of a stereo camera", "depth camera"),
        ("room_poses.txt", "has no X_camera_poses.txt", "--poses_camera"),
    ],
)
def test_other_exports_are_refused(tmp_path: Path, name: str, problem: str, fix: str) -> None:
    (tmp_path / name).write_text("")
    refuses_data(lambda: open_recording(f"rtabmap:{tmp_path}"), tmp_path, problem, fix)


def test_export_without_images_is_refused(folder: Path) -> None:
    for file in (folder / "room_rgb").iterdir():
        file.unlink()
    refuses_to_open(folder, folder / "room_rgb", "has no images", "rtabmap-export")
