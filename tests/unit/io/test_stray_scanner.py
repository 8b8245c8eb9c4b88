"""Folders of Stray Scanner, of today's and of early versions, and what may be wrong with them."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from capture_writers import (
    HIGH,
    Y_UP,
    Capture,
    check_opened,
    confidence_of,
    doubled,
    halved,
    in_world,
    tag_rotation,
    write_stray_scanner,
)
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from monoloc.io.stray_scanner import NO_CONFIDENCE
from monoloc.io.video_frames import VideoFrames
from refusals import refuses_data, refuses_setting, refuses_to_open
from synthetic_recordings import check_recording


def certain_depths_mm(capture: Capture) -> list[np.ndarray]:
    """Depth of high confidence at colour's size."""
    kept = [np.where(confidence_of(halved(each)) == HIGH, halved(each), 0) for each in capture.depths_mm]
    return [doubled(each) for each in kept]


@pytest.fixture
def capture(capture: Capture) -> Capture:
    return in_world(capture, Y_UP)


@pytest.fixture
def folder(tmp_path: Path, capture: Capture) -> Path:
    write_stray_scanner(tmp_path / "walk", capture)
    return tmp_path / "walk"


@pytest.mark.parametrize("early", [False, True])
def test_folder_opens(tmp_path: Path, capture: Capture, early: bool) -> None:
    write_stray_scanner(tmp_path / "walk", capture, early)
    recording = open_recording(str(tmp_path / "walk"))
    check_recording(recording, len(capture))
    check_opened(recording, capture, certain_depths_mm(capture))
    assert recording.camera == capture.camera and recording.name == "walk" and recording.notes == []
    expected_s = np.arange(len(capture)) / 10.0 if early else capture.times_s + 5000.0
    np.testing.assert_allclose(recording.timestamps_s, expected_s, atol=1e-6)


def test_intrinsics_of_each_frame_are_used(tmp_path: Path, capture: Capture) -> None:
    """A focal length 2 % longer shows the room 2 % larger; another lens is left out. The matrix is of the last."""
    write_stray_scanner(tmp_path / "walk", capture, focal_factors=[1.0] * 8 + [1.02] * 3 + [2.0])
    matrix = tmp_path / "walk/camera_matrix.csv"
    np.savetxt(matrix, np.diag([2.0, 2.0, 1.0]) @ capture.camera.matrix, delimiter=",")
    recording = open_recording(str(tmp_path / "walk"))
    assert recording.camera == capture.camera and len(recording) == 11
    assert recording.notes == ["1 of 12 frames are left out: 1 of another image size or lens"]
    v, u = np.mgrid[10:118:9, 10:150:7]
    for index, factor in ((0, 1.0), (8, 1.02), (10, 1.02)):
        x, y = ((pixel - centre) * factor + centre for pixel, centre in ((u, 75.5), (v, 66.0)))
        columns, rows = np.rint(x).astype(int), np.rint(y).astype(int)
        assert np.abs(recording.color(index)[v, u] - capture.colors[index][rows, columns].astype(float)).mean() < 5.0
        depth_mm = certain_depths_mm(capture)[index][rows, columns]
        np.testing.assert_allclose(recording.depth(index)[v, u], depth_mm / 1000.0, atol=1e-6)


def test_empty_columns_of_intrinsics_leave_the_matrix(tmp_path: Path, capture: Capture) -> None:
    write_stray_scanner(tmp_path / "walk", capture, focal_factors=[1.0] * 12)
    odometry, camera = tmp_path / "walk/odometry.csv", capture.camera
    stated = ", ".join(str(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    text = odometry.read_text()
    for lines in (len(text), 1):  # all, and the first alone
        odometry.write_text(text.replace(stated, ", , , ", lines))
        assert open_recording(str(tmp_path / "walk")).camera == capture.camera


def test_mended_times_of_an_early_version_are_noted(
    tmp_path: Path, capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def mended(_: VideoFrames, notes: list[str]) -> np.ndarray:
        notes.append("mended")
        return np.arange(len(capture)) / 4.0

    monkeypatch.setattr(VideoFrames, "times_s", mended)
    write_stray_scanner(tmp_path / "walk", capture, early=True)
    assert open_recording(str(tmp_path / "walk")).notes == ["mended"]


def test_frames_are_read_in_any_order(folder: Path, capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where not all of them can be kept in memory."""
    monkeypatch.setattr("monoloc.io.stray_scanner._MOST_KEPT_BYTES", 40_000)
    recording = open_recording(str(folder))
    first = {index: recording.color(index) for index in (5, 2, 11, 0)}
    for index, image in first.items():
        np.testing.assert_array_equal(recording.color(index), image)
        assert np.abs(image.astype(float) - capture.colors[index]).mean() < 4.0


def test_rotation_tag_is_ignored(folder: Path, capture: Capture) -> None:
    """Intrinsics and depth are those of the stored pixels."""
    tag_rotation(folder / "rgb.mp4", 1)
    check_opened(open_recording(str(folder)), capture, certain_depths_mm(capture))


def test_frames_without_pose_depth_or_image_are_counted(folder: Path) -> None:
    lines = (folder / "odometry.csv").read_text().splitlines()
    del lines[3]  # frame 2
    lines.append(lines[-1].replace("000011", "000012").replace("5000.", "5001."))
    (folder / "odometry.csv").write_text("\n".join(lines))
    (folder / "depth/000005.png").unlink()
    recording = open_recording(str(folder))
    assert recording.frame_names == [f"{index:06d}" for index in (0, 1, 3, 4, *range(6, 12))]
    assert recording.notes == [
        "2 of 12 frames are left out: 1 without an image in the video, 1 without depth",
    ]


def test_folder_without_depth_or_confidence(folder: Path, capture: Capture) -> None:
    (folder / "confidence/000003.png").unlink()
    assert open_recording(str(folder)).notes == ["1 of 12 frames are left out: 1 without confidence"]
    shutil.rmtree(folder / "confidence")
    recording = open_recording(str(folder))
    check_opened(recording, capture, [doubled(halved(each)) for each in capture.depths_mm])
    assert recording.notes == [NO_CONFIDENCE]
    for file in (folder / "depth").iterdir():
        file.unlink()
    recording = open_recording(str(folder))
    check_opened(recording, capture, None)
    refuses_data(lambda: recording.depth(0), folder, "has no depth images", "predicted depth")


def test_intrinsics_may_be_given(folder: Path, capture: Capture) -> None:
    given = Camera(160, 128, 140.0, 140.0, 80.0, 64.0)
    assert open_recording(str(folder), ReaderOptions(camera=given)).camera == given
    small = ReaderOptions(camera=given.resized(80, 64))
    refuses_data(lambda: open_recording(str(folder), small), folder / "rgb.mp4", "is 160x128.*80x64", "stored images")


@pytest.mark.parametrize(
    ("name", "old", "new", "problem"),
    [
        ("odometry.csv", "qw", "w", "is not 7 numbers"),
        ("odometry.csv", " qx,", " ", "has no column qx"),
        ("odometry.csv", " 000003,", "", "is not 9 numbers"),
        ("odometry.csv", " 000003,", " -3,", "a value that is no frame number"),
        ("odometry.csv", " 000003,", " three,", "is not 9 numbers"),
        ("odometry.csv", "\n", "\n#", "is not 9 numbers"),
        ("camera_matrix.csv", ",", " ", "is not 3 numbers"),
    ],
)
def test_malformed_file_is_refused(folder: Path, name: str, old: str, new: str, problem: str) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    refuses_to_open(folder, folder / name, problem, "export the recording from Stray Scanner again")


def test_missing_or_short_files_are_refused(folder: Path) -> None:
    matrix, odometry = folder / "camera_matrix.csv", folder / "odometry.csv"
    text = odometry.read_text()
    odometry.write_text(text.splitlines()[0])
    refuses_to_open(folder, odometry, "holds no poses", "again")
    odometry.write_text(text)
    lines = matrix.read_text().splitlines()
    matrix.write_text("\n".join([*lines, lines[0]]))
    refuses_to_open(folder, matrix, "has 4 rows instead of 3", "again")
    matrix.write_text("\n".join(["-1,0,80", *lines[1:]]))
    refuses_to_open(folder, matrix, "camera.fx/fy: is", "positive")
    matrix.unlink()
    refuses_to_open(folder, matrix, "is missing", "with all its files")


def test_damaged_video_names_the_frames_that_can_be_used(folder: Path) -> None:
    """By their positions in the recording, which leaves the first frame of the video out."""
    video = folder / "rgb.mp4"
    content = video.read_bytes()
    index = content.index(b"moov") - 4
    video.write_bytes(content[: index // 2] + bytes(index - index // 2) + content[index:])
    (folder / "depth/000000.png").unlink()
    recording = open_recording(str(folder))
    with pytest.raises(DataError) as raised:
        recording.color(len(recording) - 1)
    named = re.search(r"cannot be decoded after frame (\d+); use --frames 0:(\d+),", str(raised.value))
    assert named and int(named[2]) == int(named[1]) > 0
    recording.color(int(named[2]) - 1)


def test_folder_without_common_frames_is_refused(folder: Path) -> None:
    for file in (folder / "depth").iterdir():
        file.rename(file.with_name(f"1{file.name[1:]}"))
    (folder / "depth/000099.png").write_bytes((folder / "depth/100000.png").read_bytes())
    text = (folder / "odometry.csv").read_text()
    (folder / "odometry.csv").write_text(text.replace(" 000011,", " 000099,"))
    problem = "none of its 12 frames can be used: 1 without an image in the video, 11 without depth"
    refuses_to_open(folder, folder, problem, "again")


def test_depth_scale_may_be_given(folder: Path) -> None:
    metres = open_recording(str(folder)).depth(0)
    np.testing.assert_allclose(open_recording(str(folder), ReaderOptions(depth_scale=500.0)).depth(0), 2.0 * metres)
    refuses_setting(lambda: ReaderOptions(depth_scale=0.0), "depth_scale", "is 0.0", "1000")
