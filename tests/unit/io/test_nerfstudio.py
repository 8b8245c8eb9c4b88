"""nerfstudio's transforms.json: intrinsics for all or for each frame, and what may be wrong with it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture_writers import Capture, check_opened, write_nerfstudio
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Remark
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording, write_color

UNTIMED = "the files state no times; frames are taken to be 0.2 s apart"


def rewrite(folder: Path, content: dict[str, Any]) -> Path:
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


def test_transforms_open(tmp_path: Path, capture: Capture) -> None:
    write_nerfstudio(tmp_path / "walk", capture)
    for path in (tmp_path / "walk", tmp_path / "walk/transforms.json"):
        recording = open_recording(str(path))
        check_recording(recording, len(capture))
        check_opened(recording, capture, capture.depths_mm)
        assert recording.camera == capture.camera and recording.name == "walk" and recording.notes == [UNTIMED]
        assert isinstance(recording.notes[0], Remark)  # no warning: all of its recordings are so
        np.testing.assert_allclose(recording.timestamps_s, np.arange(12) / 5.0)
    assert recording.frame_names[1:] == [f"frame_{number}" for number in range(2, 13)]
    assert open_recording(str(path), ReaderOptions(depth_scale=100.0)).depth(0).max() > 5.0


def test_scaled_poses_and_poses_of_three_rows(tmp_path: Path, capture: Capture) -> None:
    content = write_nerfstudio(tmp_path, capture, applied_scale=0.25)
    for frame in content["frames"]:
        matrix = np.array(frame["transform_matrix"])
        matrix[:3, 3] *= 0.25
        frame["transform_matrix"] = matrix[:3].tolist()
    check_opened(open_recording(str(rewrite(tmp_path, content))), capture, capture.depths_mm)


def test_scale_of_poses_that_colmap_may_have_found_is_remarked(tmp_path: Path, capture: Capture) -> None:
    content = write_nerfstudio(tmp_path, capture)
    content["frames"][3]["colmap_im_id"] = 3
    with_depth = open_recording(str(rewrite(tmp_path, content)))
    for frame in content["frames"]:
        frame.pop("colmap_im_id", None)
        del frame["depth_file_path"]
    without_depth = open_recording(str(rewrite(tmp_path, content)))
    for recording in (with_depth, without_depth):
        assert "the poses' unit is taken to be one metre; if COLMAP found them, it is not" in recording.notes[-1]
        assert isinstance(recording.notes[-1], Remark)


def test_intrinsics_may_be_those_of_each_frame(tmp_path: Path, capture: Capture) -> None:
    content = write_nerfstudio(tmp_path, capture)
    for frame in content["frames"]:
        frame |= {key: content[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    recording = open_recording(str(rewrite(tmp_path, content)))
    assert recording.camera == capture.camera
    check_opened(recording, capture, capture.depths_mm)


def angle_of(size_px: int, focal_px: float) -> float:
    return 2.0 * math.atan(0.5 * size_px / focal_px)


def with_angles(folder: Path, capture: Capture, **changes: Any) -> Path:
    """As instant-ngp and Blender may write it: a field of view, and .png images without their suffix."""
    content = write_nerfstudio(folder, capture)
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    for frame, index in zip(content["frames"], (0, 9, 10, 11, *range(1, 9)), strict=True):
        frame["file_path"] = f"./images/r_{index}"
        write_color(folder / f"images/r_{index}.png", capture.colors[index])
    return rewrite(folder, content | {"camera_angle_x": angle_of(capture.camera.width, capture.camera.fx)} | changes)


def test_field_of_view_stands_for_the_intrinsics(tmp_path: Path, capture: Capture) -> None:
    centred = replace(capture.camera, fy=capture.camera.fx, cx=79.5, cy=63.5)
    note = "cx and cy are not stated; the optical axis is taken to be in the centre of the image"
    recording = open_recording(str(with_angles(tmp_path, capture)))
    check_opened(recording, capture, capture.depths_mm)
    assert np.allclose(recording.camera.matrix, centred.matrix) and recording.notes == [note, UNTIMED]
    assert open_recording(str(tmp_path), ReaderOptions(capture.camera)).notes == [UNTIMED]
    whole = {"camera_angle_y": angle_of(128, capture.camera.fy), "cx": 76.0, "cy": 66.5}
    recording = open_recording(str(with_angles(tmp_path, capture, **whole)))
    assert np.allclose(recording.camera.matrix, capture.camera.matrix) and recording.notes == [UNTIMED]


@pytest.mark.parametrize(
    ("changes", "problem", "fix"),
    [
        ({"camera_angle_x": 69.4}, "camera_angle_x is 69.4, no field of view", "in radians"),
        ({"camera_angle_y": 0.0}, "camera_angle_y is 0.0, no field of view", "in radians"),
        ({"fl_x": 136.0}, "w is missing", "write w, h, fl_x, fl_y, cx, cy, or camera_angle_x"),
    ],
)
def test_field_of_view_that_is_none_is_refused(
    tmp_path: Path, capture: Capture, changes: dict[str, Any], problem: str, fix: str
) -> None:
    with_angles(tmp_path, capture, **changes)
    refuses_to_open(tmp_path, tmp_path / "transforms.json", problem, fix)


def test_depth_of_nerfcapture_is_read_in_its_unit(tmp_path: Path, capture: Capture) -> None:
    content = write_nerfstudio(tmp_path, capture)
    known = open_recording(str(tmp_path)).depth(4)
    for frame in content["frames"]:
        frame["depth_path"] = frame.pop("depth_file_path")
    content["integer_depth_scale"] = 10.0 / 65535.0
    depth = open_recording(str(rewrite(tmp_path, content))).depth(4)
    assert known.any()
    np.testing.assert_allclose(depth, known * np.float32(1000.0 * 10.0 / 65535.0), rtol=1e-5)
    for wrong in (0.0, -0.1, 1e9):
        path = rewrite(tmp_path, content | {"integer_depth_scale": wrong}) / "transforms.json"
        refuses_data(lambda path=path: open_recording(str(path)), path, "integer_depth_scale is", "--depth-scale")


def test_incomplete_frames_are_counted(tmp_path: Path, capture: Capture) -> None:
    content = write_nerfstudio(tmp_path, capture)
    (tmp_path / "images/frame_2.jpg").unlink()
    (tmp_path / "depths/frame_3.png").unlink()
    del next(frame for frame in content["frames"] if frame["file_path"].endswith("_4.jpg"))["depth_file_path"]
    recording = open_recording(str(rewrite(tmp_path, content)))
    assert len(recording) == 9
    assert recording.notes == ["3 of 12 frames are left out: 1 without an image, 2 without depth", UNTIMED]


@pytest.mark.parametrize(
    ("changes", "model", "distortion"),
    [
        ({"k1": 0.1, "k2": -0.02, "p1": 0.001, "p2": 0.002}, "brown", (0.1, -0.02, 0.001, 0.002, 0.0)),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "k4": 0.01}, "fisheye", (0.1, 0.0, 0.0, 0.01)),
        ({"is_fisheye": True, "k1": 0.1}, "fisheye", (0.1, 0.0, 0.0, 0.0)),
    ],
)
def test_lens(tmp_path: Path, capture: Capture, changes: dict[str, Any], model: str, distortion: Any) -> None:
    write_nerfstudio(tmp_path, capture, **changes)
    camera = open_recording(str(tmp_path)).camera
    assert (camera.distortion_model, camera.distortion) == (model, distortion)


@pytest.mark.parametrize(
    ("changes", "problem", "fix"),
    [
        ({"frames": []}, "has no list of frames", "ns-process-data"),
        ({"frames": [{"transform_matrix": 3}]}, "entry 0 of frames has no file_path", "ns-process-data"),
        ({"fl_x": "wide"}, "fl_x is 'wide', not a number", "export"),
        ({"fl_x": 10**400}, r"fl_x is 10+\.\.\., not a number", "export"),
        ({"fl_y": -2.0}, "camera.fx/fy: is", "positive"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model is 'EQUIRECTANGULAR'", "colmap image_undistorter"),
        ({"k4": 0.1}, "k4 is 0.1 in a model without it", "colmap image_undistorter"),
        ({"applied_scale": 0}, "applied_scale is 0.0, that of no program", "ns-process-data"),
    ],
)
def test_malformed_transforms_are_refused(
    tmp_path: Path, capture: Capture, changes: dict[str, Any], problem: str, fix: str
) -> None:
    write_nerfstudio(tmp_path, capture, **changes)
    refuses_to_open(tmp_path, tmp_path / "transforms.json", problem, fix)


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        (None, "transform_matrix is not a list of 4 numbers each"),
        ([[10**400, 0, 0, 0]], "transform_matrix is not a list of 4 numbers each"),
        ([["1", 0, 0, 0]], "transform_matrix is not a list of 4 numbers each"),
        ([[1, 0, 0, 0]], "transform_matrix of images/frame_5.jpg has 1 rows"),
        ([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]], "the pose of images/frame_5.jpg is not rigid"),
        ([[1, 0, 0, float("nan")], [0, 1, 0, 0], [0, 0, 1, 0]], "the pose of images/frame_5.jpg is NaN"),
    ],
)
def test_malformed_pose_is_refused(tmp_path: Path, capture: Capture, matrix: Any, problem: str) -> None:
    content = write_nerfstudio(tmp_path, capture)
    next(each for each in content["frames"] if each["file_path"].endswith("_5.jpg"))["transform_matrix"] = matrix
    refuses_to_open(rewrite(tmp_path, content), tmp_path / "transforms.json", problem, "")


def test_missing_files_are_refused(tmp_path: Path, capture: Capture) -> None:
    refuses_data(
        lambda: open_recording(f"nerfstudio:{tmp_path}"), tmp_path / "transforms.json", "is missing", "its folder"
    )
    write_nerfstudio(tmp_path, capture)
    (tmp_path / "images").rename(tmp_path / "pictures")
    problem = "none of its 12 frames can be used: 12 without an image"
    refuses_to_open(tmp_path, tmp_path / "transforms.json", problem, "correct file_path")
