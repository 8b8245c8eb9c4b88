"""Polycam's raw data, with and without corrected poses, and what may be wrong with it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

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
    write_polycam,
)
from monoloc.io.registry import open_recording
from monoloc.io.stray_scanner import NO_CONFIDENCE
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def capture(capture: Capture) -> Capture:
    return in_world(capture, Y_UP)


@pytest.fixture
def folder(tmp_path: Path, capture: Capture) -> Path:
    write_polycam(tmp_path / "walk", capture)
    return tmp_path / "walk"


def cameras_of(folder: Path) -> list[Path]:
    return sorted((folder / "keyframes/cameras").iterdir())


@pytest.mark.parametrize("corrected", [False, True])
def test_raw_data_opens(tmp_path: Path, capture: Capture, corrected: bool) -> None:
    write_polycam(tmp_path / "walk", capture, corrected)
    kept = [np.where(confidence_of(halved(each)) == HIGH, halved(each), 0) for each in capture.depths_mm]
    for path in (tmp_path / "walk", tmp_path / "walk/keyframes"):
        recording = open_recording(str(path))
        check_recording(recording, len(capture))
        check_opened(recording, capture, [doubled(each) for each in kept])
        assert recording.camera == capture.camera and recording.name == "walk" and recording.notes == []
        np.testing.assert_allclose(np.diff(recording.timestamps_s), np.diff(capture.times_s), atol=1e-5)


def test_files_that_macos_adds_on_other_disks_are_no_frames(folder: Path, capture: Capture) -> None:
    for file in [*cameras_of(folder), *(folder / "keyframes/images").iterdir()]:
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\26\7\0\2\0\0Mac OS X")
    recording = open_recording(str(folder))
    assert len(recording) == len(capture) and recording.notes == []


def test_incomplete_frames_are_counted(folder: Path) -> None:
    files = cameras_of(folder)
    (folder / f"keyframes/images/{files[1].stem}.jpg").unlink()
    (folder / f"keyframes/depth/{files[2].stem}.png").unlink()
    (folder / f"keyframes/confidence/{files[3].stem}.png").unlink()
    recording = open_recording(str(folder))
    assert recording.frame_names == [file.stem for file in (files[0], *files[4:])]
    assert recording.notes == [
        "3 of 12 frames are left out: 1 without an image, 1 without depth, 1 without confidence",
    ]
    shutil.rmtree(folder / "keyframes/confidence")
    assert open_recording(str(folder)).notes[-1] == NO_CONFIDENCE


@pytest.mark.parametrize(
    ("key", "value", "problem", "fix"),
    [
        ("fx", None, "fx is None, not a number", "again"),
        ("fx", -5.0, "camera.fx/fy: is", "positive"),
        ("t_13", "nan", "t_13 is 'nan', not a number", "again"),
        ("t_00", 5.0, "the pose of .* is not rigid", "proper rotation"),
    ],
)
def test_malformed_camera_is_refused(folder: Path, key: str, value: Any, problem: str, fix: str) -> None:
    file = cameras_of(folder)[4]
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))
    refuses_to_open(folder, file, problem, fix)


def test_other_folders_are_refused(folder: Path) -> None:
    odd = folder / "keyframes/cameras/first.json"
    odd.write_text("{}")
    refuses_to_open(folder, odd, "is not named by a time in microseconds", "developer mode")
    for file in cameras_of(folder):
        file.unlink()
    refuses_to_open(folder, folder / "keyframes", "has no cameras/STAMP.json", "developer mode")
    refuses_data(lambda: open_recording(f"polycam:{folder}/no"), folder / "no", "does not exist", "check the path")


def test_depth_of_another_size_than_its_confidence_is_refused(folder: Path) -> None:
    first, second = (folder / f"keyframes/{name}" for name in ("depth", "confidence"))
    stem = cameras_of(folder)[0].stem
    data = (folder / f"keyframes/images/{stem}.jpg").read_bytes()
    recording = open_recording(str(folder))
    (second / f"{stem}.png").write_bytes(data)
    refuses_data(lambda: recording.depth(0), second / f"{stem}.png", "is not a depth image", "one channel")
    import cv2

    cv2.imwrite(str(second / f"{stem}.png"), np.zeros((6, 8), np.uint8))
    problem = f"is 8x6, but its depth image {stem}.png is 80x64"
    refuses_data(lambda: recording.depth(0), second / f"{stem}.png", problem, "export the recording again")
    assert (first / f"{stem}.png").is_file()
