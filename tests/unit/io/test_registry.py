"""SOURCE and --frames: formats by name or recognised, and frames selected."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.io.registry import FORMATS, open_recording, select_frames
from refusals import refuses_data, refuses_setting, refuses_to_open
from synthetic_recordings import check_recording


def test_known_formats() -> None:
    assert list(FORMATS) == [
        *("folder", "nerfstudio", "stray-scanner", "record3d", "polycam", "rtabmap", "tum", "7scenes", "12scenes"),
        *("rgbd-scenes-v2", "colmap", "rosbag", "nyu", "flight", "video"),
    ]


def test_existing_path_with_a_colon_is_a_path(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path / "room:2")
    assert len(open_recording(str(tmp_path / "room:2"))) == 3


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ("0:3:2", [0, 2]),
        ("1:", [1, 2]),
        (":2", [0, 1]),
        ("::2", [0, 2]),
        (":", [0, 1, 2]),
        ("0:400", [0, 1, 2]),
        ("0:1,2:", [0, 2]),
    ],
)
def test_frames_are_selected_as_a_slice(tmp_path: Path, frames: str, expected: list[int]) -> None:
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    selection = select_frames(recording, frames)
    check_recording(selection, len(expected))
    np.testing.assert_array_equal(selection.positions, expected)
    assert selection.frame_names == [recording.frame_names[p] for p in expected]
    np.testing.assert_array_equal(selection.color(0), recording.color(expected[0]))
    np.testing.assert_array_equal(selection.depth(0), recording.depth(expected[0]))


@pytest.mark.parametrize("name", ["", *(f"{name}:" for name in FORMATS)])
def test_missing_path_is_named_from_the_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    refuses_data(lambda: open_recording(f"{name}no"), tmp_path / "no", "does not exist|is missing", "")


@pytest.mark.parametrize(
    ("source", "fix"), [("0", "camera:0"), ("/dev/video7", "camera:7"), ("/dev/null", "FORMAT:")]
)
def test_camera_named_as_elsewhere_is_told_its_name_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str, fix: str
) -> None:
    monkeypatch.chdir(tmp_path)
    refuses_data(lambda: open_recording(source), Path(source).absolute(), "(does not exist|is a device)", fix)


def test_file_where_a_folder_is_meant_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "rgb.txt"
    file.write_text("")
    refuses_data(lambda: open_recording(f"tum:{file}"), file, "is a file, not a folder", "give the folder")


def test_folder_of_no_known_format_is_refused(tmp_path: Path) -> None:
    refuses_to_open(tmp_path, tmp_path, "is an empty folder", "give the folder that holds the recording")
    (tmp_path / "notes.md").touch()
    fix = "FORMAT:PATH with one of .*7scenes.*, or describe .* dataset.toml"
    refuses_to_open(tmp_path, tmp_path, "is not recognised", fix)


def test_folder_of_images_is_to_be_described(tmp_path: Path) -> None:
    (tmp_path / "0001.JPG").touch()
    refuses_to_open(tmp_path, tmp_path, "is not recognised", "describe its images in a dataset.toml")


@pytest.mark.parametrize(
    ("parts", "missing", "problem", "fix"),
    [
        (
            ["odometry.csv", "camera_matrix.csv"],
            "rgb.mp4",
            "is missing",
            "Stray Scanner exported, with all its files",
        ),
        (["rgb.mp4", "camera_matrix.csv"], "odometry.csv", "is missing", "Stray Scanner exported"),
        (["keyframes/images/", "keyframes/depth/"], "keyframes", "has no cameras/STAMP.json", "developer mode on"),
        (["x_rgb/", "x_calib/", "x_poses.txt"], ".", "has no X_camera_poses.txt", "export again: .*--poses_camera"),
        (["images/", "sparse/0/images.bin"], ".", "has no COLMAP model", "give the folder of cameras.bin"),
        (["walk_0.mcap"], ".", "is a ROS 2 bag without metadata.yaml", "ros2 bag reindex"),
    ],
)
def test_part_of_a_capture_is_told_what_it_lacks(
    tmp_path: Path, parts: list[str], missing: str, problem: str, fix: str
) -> None:
    for part in parts:
        path = tmp_path / part
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir() if part.endswith("/") else path.touch()
    refuses_to_open(tmp_path, tmp_path / missing, problem, fix)


def test_topics_without_the_format_are_told_how_to_be_chosen(tmp_path: Path) -> None:
    (tmp_path / "walk.bag").touch()
    source = tmp_path / "walk.bag#depth=none"
    refuses_to_open(source, source, "does not exist", f"write rosbag:{source}")


def test_recording_in_a_folder_or_around_a_file_is_named(tmp_path: Path) -> None:
    walk = tmp_path / "unpacked" / "walk"
    walk.mkdir(parents=True)
    synthetic.write_folder(walk)
    (walk / "poses.txt").touch()
    for source in (walk.parent, walk / "poses.txt", walk / "color"):
        refuses_to_open(source, source, "is not recognised", f"give a recording, such as {re.escape(str(walk))}")


@pytest.mark.parametrize(("name", "kind"), [("manifest.json", "bundle"), ("place.json", "place")])
def test_bundle_or_place_in_place_of_a_recording_is_named_as_one(tmp_path: Path, name: str, kind: str) -> None:
    (tmp_path / name).touch()
    refuses_to_open(tmp_path, tmp_path, f"is a {kind}, not a recording", "give the images or the video")


def test_archive_is_to_be_unpacked(tmp_path: Path) -> None:
    (tmp_path / "walk.zip").write_bytes(b"PK")
    refuses_to_open(tmp_path / "walk.zip", tmp_path / "walk.zip", "is an archive", "unpack it")


def test_unknown_format_is_refused() -> None:
    refuses_setting(lambda: open_recording("kinect:room"), "SOURCE", "unknown format 'kinect'", "7scenes.*video")
    for_flights = "monoloc fly and doctor take a camera, by its number as camera:0"
    refuses_setting(lambda: open_recording("camera:0"), "SOURCE", "unknown format 'camera'", for_flights)


@pytest.mark.parametrize(
    ("frames", "problem", "fix"),
    [
        *(
            (frames, "is not START:STOP:STEP", "whole numbers")
            for frames in ("", "5", "a:b", "1:2:3:4", "-5:", "1.5:2", "0:10:-1")
        ),
        ("::0", "step 0", "1 or more"),
        *(
            (frames, "none of the 3 frames", "START below STOP and below 3")
            for frames in ("3:", "2:1", "1:1", "0:2,3:")
        ),
        *((frames, "goes back in time", "in order of time") for frames in ("2:,0:1", "0:2,1:3")),
    ],
)
def test_impossible_frames_are_refused(tmp_path: Path, frames: str, problem: str, fix: str) -> None:
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    refuses_setting(lambda: select_frames(recording, frames), "frames", problem, fix)


def test_readers_import_neither_torch_nor_h5py() -> None:
    code = (
        "import sys, monoloc.io.registry; "
        "assert not {'torch', 'h5py', 'scipy'} & set(sys.modules), sorted(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
