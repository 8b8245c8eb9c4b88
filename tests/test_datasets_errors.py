"""Bad input: every message of the readers, one line that names the file and the fix."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.camera import Camera
from monoloc.errors import DataError, MissingExtraError, SettingError
from monoloc.io.file_access import read_rows
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording, select_frames
from monoloc.io.rgbd_scenes_v2 import read_pose_file


def fails(action: Callable[[], object], path: Path, problem: str, fix: str) -> None:
    """The action raises DataError, in one line: the path, then the problem, then the fix."""
    with pytest.raises(DataError) as raised:
        action()
    message = str(raised.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    assert re.search(f"{problem}.*; .*{fix}", message.removeprefix(str(path))), message


def fails_to_open(source: Path, path: Path, problem: str, fix: str) -> None:
    fails(lambda: open_recording(str(source)), path, problem, fix)


def refuses(action: Callable[[], object], field: str, problem: str, fix: str) -> None:
    """The action raises SettingError, in one line: the field, then the problem, then the fix."""
    with pytest.raises(SettingError) as raised:
        action()
    assert "\n" not in str(raised.value)
    assert re.fullmatch(f"{field}: .*{problem}.*; .*{fix}.*", str(raised.value)), str(raised.value)


# --- SOURCE and --frames ---


def test_missing_path(tmp_path):
    fails_to_open(tmp_path / "no", tmp_path / "no", "does not exist", "check the path")


@pytest.mark.parametrize("name", ["7scenes", "tum", "rgbd-scenes-v2", "folder"])
def test_missing_folder_of_a_format(tmp_path, name):
    missing = tmp_path / "no"
    fails(lambda: open_recording(f"{name}:{missing}"), missing, "does not exist", "check the path")


@pytest.mark.parametrize("name", ["nyu", "video"])
def test_missing_file_of_a_format(tmp_path, name):
    fails(lambda: open_recording(f"{name}:{tmp_path / 'no'}"), tmp_path / "no", "is missing", "")


@pytest.mark.parametrize("source", ["no", "7scenes:no", "nyu:no", "video:no"])
def test_a_missing_path_is_named_from_the_root(tmp_path, monkeypatch, source):
    monkeypatch.chdir(tmp_path)
    fails(lambda: open_recording(source), tmp_path / "no", "does not exist|is missing", "")


def test_file_where_a_folder_is_meant(tmp_path):
    file = tmp_path / "rgb.txt"
    file.write_text("")
    fails(lambda: open_recording(f"tum:{file}"), file, "is a file, not a folder", "give the folder")


def test_folder_of_no_known_format(tmp_path):
    fails_to_open(tmp_path, tmp_path, "is not recognised", "FORMAT:PATH with one of .*7scenes")


def test_unknown_format():
    refuses(lambda: open_recording("kinect:room"), "SOURCE", "unknown format 'kinect'", "7scenes.*video")


@pytest.mark.parametrize("frames", ["", "5", "a:b", "1:2:3:4", "-5:", "1.5:2", "0:10:-1"])
def test_malformed_frames(tmp_path, frames):
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    refuses(lambda: select_frames(recording, frames), "frames", "is not START:STOP:STEP", "whole numbers")


def test_frames_with_step_zero(tmp_path):
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    refuses(lambda: select_frames(recording, "::0"), "frames", "step 0", "1 or more")


@pytest.mark.parametrize("frames", ["3:", "2:1", "1:1"])
def test_frames_that_select_nothing(tmp_path, frames):
    synthetic.write_folder(tmp_path)
    recording = open_recording(str(tmp_path))
    refuses(
        lambda: select_frames(recording, frames), "frames", "none of the 3 frames", "START below STOP and below 3"
    )


# --- Overrides ---


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf, 1e-300, 1e300])
def test_impossible_depth_scale(scale):
    problem = re.escape(f"is {scale!r}, not from 1e-06 to 1e+09")
    refuses(lambda: ReaderOptions(depth_scale=scale), "depth_scale", problem, "such as 1000")


def test_override_that_a_format_does_not_take(tmp_path):
    for name in ("nyu", "video"):
        refuses(
            lambda name=name: open_recording(f"{name}:{tmp_path}", ReaderOptions(depth_scale=1000.0)),
            "depth_scale",
            f"no meaning for a {name} recording",
            "leave this option out",
        )


def test_given_intrinsics_that_do_not_fit_the_images(tmp_path):
    synthetic.write_folder(tmp_path)
    options = ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 32.0, 24.0))
    fails(
        lambda: open_recording(str(tmp_path), options),
        tmp_path / "color/000010.jpg",
        "is 32x24, but the intrinsics are for 64x48",
        "give the intrinsics of these images",
    )


# --- Images ---


@pytest.fixture
def folder(tmp_path):
    """A described folder with three frames of JPEG colour and PNG depth, 32x24."""
    synthetic.write_folder(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, -1])
@pytest.mark.parametrize("kind", ["color", "depth"])
def test_truncated_image(folder, kind, kept, capfd):
    recording = open_recording(str(folder))
    image = folder / kind / ("000015.jpg" if kind == "color" else "000015.png")
    data = image.read_bytes()
    image.write_bytes(data[: kept if kept < 0 else int(kept * len(data))])
    fails(lambda: getattr(recording, kind)(1), image, "is cut short", "copy the file again")
    assert capfd.readouterr().err == ""


def test_empty_image(folder):
    recording = open_recording(str(folder))
    (folder / "depth/000015.png").write_bytes(b"")
    fails(lambda: recording.depth(1), folder / "depth/000015.png", "is empty", "copy the file again")


def test_image_that_vanished(folder):
    recording = open_recording(str(folder))
    (folder / "depth/000015.png").unlink()
    fails(lambda: recording.depth(1), folder / "depth/000015.png", "cannot be read", "restore the file")


def test_image_that_is_none(folder, capfd):
    recording = open_recording(str(folder))
    (folder / "color/000015.jpg").write_text("not an image")
    fails(lambda: recording.color(1), folder / "color/000015.jpg", "cannot be decoded", "copy or convert")
    assert capfd.readouterr().err == ""


def test_colour_of_another_size(folder):
    synthetic.write_color(folder / "color/000015.jpg", synthetic.make_color(16, 12))
    recording = open_recording(str(folder))
    fails(lambda: recording.color(1), folder / "color/000015.jpg", "is 16x12.*for 32x24", "intrinsics")


def test_depth_of_another_size(folder):
    synthetic.write_depth(folder / "depth/000015.png", synthetic.constant_depth(16, 12, 1000))
    recording = open_recording(str(folder))
    fails(lambda: recording.depth(1), folder / "depth/000015.png", "is 16x12.*for 32x24", "images of that")


def test_depth_that_is_a_colour_image(folder):
    synthetic.write_color(folder / "depth/000015.png", synthetic.make_color(32, 24))
    recording = open_recording(str(folder))
    fails(lambda: recording.depth(1), folder / "depth/000015.png", "is not a depth image", "one channel")


def test_depth_of_a_recording_that_has_none(folder):
    toml = synthetic.SEQUENCE_TOML.replace('depth = "', '# "')
    (folder / "dataset.toml").write_text(toml)
    recording = open_recording(str(folder))
    fails(lambda: recording.depth(0), folder, "has no depth images", "predicted depth")


# --- Files of numbers ---


@pytest.mark.parametrize("content", ["1 2\n", "1 2 three\n", "# fine\n1 2 3 4\n"])
def test_row_that_is_not_numbers(tmp_path, content):
    path = tmp_path / "rows.txt"
    path.write_text(content)
    fails(lambda: read_rows(path, 3, "a b c"), path, "line [12] is not 3 numbers", "each line holds: a b c")


def test_file_without_rows(tmp_path):
    path = tmp_path / "rows.txt"
    path.write_text("# only a comment\n")
    fails(lambda: read_rows(path, 3, "a b c"), path, "has no lines of numbers", "each line holds: a b c")


def test_binary_file_where_text_is_meant(tmp_path):
    path = tmp_path / "rows.txt"
    path.write_bytes(b"\xff\xfe\x00\x80")
    fails(lambda: read_rows(path, 3, "a b c"), path, "is not a text file", "copy the file again")


# --- Poses and layout of 7-Scenes ---


@pytest.fixture
def scene(tmp_path):
    synthetic.write_seven_scenes(tmp_path, frames=2)
    return tmp_path


def spoil_pose(scene: Path, row: int, column: int, value: float) -> Path:
    path = scene / "seq-01" / "frame-000002.pose.txt"
    pose = np.loadtxt(path)
    pose[row, column] = value
    np.savetxt(path, pose)
    return path


def test_seven_scenes_nan_pose(scene):
    path = spoil_pose(scene, 0, 3, np.nan)
    fails_to_open(scene, path, "the pose of seq-01/frame-000002 is NaN", "correct it or remove the frame")


def test_seven_scenes_pose_that_is_not_rigid(scene):
    path = spoil_pose(scene, 0, 0, 2.0)
    fails_to_open(scene, path, "the pose of seq-01/frame-000002 is not rigid", "proper rotation")


def test_seven_scenes_pose_that_is_not_four_rows(scene):
    path = scene / "seq-01" / "frame-000000.pose.txt"
    np.savetxt(path, np.eye(4)[:3])
    fails_to_open(scene, path, "has 3 rows", "write a 4x4 camera-to-world matrix")


def test_seven_scenes_with_one_pose_missing(scene):
    path = scene / "seq-01" / "frame-000002.pose.txt"
    path.unlink()
    fails_to_open(scene, path, "cannot be read", "restore the file")


def test_seven_scenes_with_one_depth_image_missing(scene):
    path = scene / "seq-01" / "frame-000002.depth.png"
    path.unlink()
    fails_to_open(scene, path, "is missing", "remove the frame's other files")


def test_seven_scenes_empty_sequence(scene):
    (scene / "seq-02").mkdir()
    fails_to_open(scene, scene / "seq-02", "has no frame-NNNNNN.color images", "unpacked")


def test_seven_scenes_empty_folder(tmp_path):
    fails(lambda: open_recording(f"7scenes:{tmp_path}"), tmp_path, "has no frame-", "give a 7-Scenes scene")


def test_seven_scenes_images_of_another_size(scene):
    path = scene / "seq-01" / "frame-000000.color.png"
    synthetic.write_color(path, synthetic.make_color(320, 240))
    fails_to_open(scene, path, "is 320x240, but the intrinsics are for 640x480", "give the intrinsics")


def test_seven_scenes_intrinsics_of_another_shape(scene):
    path = scene / "camera-intrinsics.txt"
    np.savetxt(path, np.eye(3)[:2])
    fails_to_open(scene, path, "has 2 rows instead of 3", "fx 0 cx")


def test_seven_scenes_intrinsics_that_do_not_fit(scene):
    path = scene / "camera-intrinsics.txt"
    np.savetxt(path, [[585.0, 0.0, 900.0], [0.0, 585.0, 240.0], [0.0, 0.0, 1.0]])
    fails_to_open(scene, path, "does not fit.*lies outside the 640x480 image", "fx 0 cx")


# --- TUM ---


@pytest.fixture
def sequence(tmp_path):
    synthetic.write_tum(tmp_path)
    return tmp_path


def test_tum_without_list(tmp_path):
    fails(lambda: open_recording(f"tum:{tmp_path}"), tmp_path / "rgb.txt", "is missing", "TUM sequence")


def test_tum_malformed_list(sequence):
    path = sequence / "depth.txt"
    path.write_text("depth/100.005000.png 100.0\n")
    fails_to_open(sequence, path, "line 1 is not a time stamp and a file", "t filename")


def test_tum_empty_list(sequence):
    path = sequence / "depth.txt"
    path.write_text("# nothing\n")
    fails_to_open(sequence, path, "lists no images", "t filename")


def test_tum_list_that_names_a_missing_image(sequence):
    path = sequence / "rgb" / "100.000000.png"
    path.unlink()
    fails_to_open(sequence, path, "is missing, but listed in rgb.txt", "restore it")


@pytest.mark.parametrize("name", ["rgb.txt", "groundtruth.txt"])
def test_tum_time_that_does_not_increase(sequence, name):
    lines = (sequence / name).read_text().splitlines()
    (sequence / name).write_text("\n".join([*lines, lines[2]]) + "\n")
    fails_to_open(sequence, sequence / name, r"time stamp of entry \d+ does not increase", "sort")


def test_tum_clocks_that_differ(sequence):
    rows = np.loadtxt(sequence / "groundtruth.txt")
    np.savetxt(sequence / "groundtruth.txt", rows + np.eye(8)[0] * 3600.0)
    fails_to_open(sequence, sequence, "has no frame whose colour, depth and pose", "one clock")


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        (1, np.nan, "pose 3 is NaN or infinite"),
        (7, np.inf, "pose 3 is NaN or infinite"),
        (7, 5.0, "pose 3 is not rigid: its quaternion has length 5"),
    ],
)
def test_tum_impossible_pose(sequence, column, value, problem):
    rows = np.loadtxt(sequence / "groundtruth.txt")
    rows[2, column] = value
    np.savetxt(sequence / "groundtruth.txt", rows)
    fails_to_open(sequence, sequence / "groundtruth.txt", problem, "")


# --- RGB-D Scenes v2 ---


@pytest.fixture
def room(tmp_path):
    synthetic.write_rgbd_scenes_v2(tmp_path)
    return tmp_path


def test_rgbd_scenes_v2_several_scenes(room):
    synthetic.write_rgbd_scenes_v2(room, scene="02", frames=1)
    fails_to_open(room, room, r"holds several scenes \(scene_01, scene_02\)", "give one of them, such as")


def test_rgbd_scenes_v2_folder_without_number(room):
    folder = (room / "imgs" / "scene_01").rename(room / "imgs" / "kitchen")
    fails_to_open(folder, folder, "is not named scene_NN", "ROOT/imgs/scene_NN")


def test_rgbd_scenes_v2_empty_scene(tmp_path):
    folder = tmp_path / "imgs" / "scene_01"
    folder.mkdir(parents=True)
    fails_to_open(tmp_path, folder, "has no NNNNN-color.png images", "unpack")


def test_rgbd_scenes_v2_without_a_depth_image(room):
    path = room / "imgs" / "scene_01" / "00001-depth.png"
    path.unlink()
    fails_to_open(room, path, "is missing", "restore it or remove")


def test_rgbd_scenes_v2_without_poses(room):
    (room / "pc" / "01.pose").unlink()
    fails_to_open(room, room.resolve() / "pc" / "01.pose", "is missing", "ROOT/pc beside ROOT/imgs")


def test_rgbd_scenes_v2_with_poses_of_another_scene(room):
    path = room / "pc" / "01.pose"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    fails_to_open(room, path, "has 2 poses, but frame 2 exists", "this scene's own")


def test_rgbd_scenes_v2_pose_of_zero(tmp_path):
    path = tmp_path / "01.pose"
    path.write_text("1 0 0 0 0 0 0\n0 0 0 0 1 2 3\n")
    fails(lambda: read_pose_file(path), path, "pose 2 is not rigid: its quaternion has length 0", "unit")


# --- NYU ---


def test_nyu_file_that_is_not_hdf5(tmp_path):
    path = tmp_path / "nyu.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    fails_to_open(path, path, "is cut short or not an HDF5 .mat file", "copy the file again")


def test_nyu_file_without_images(tmp_path):
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file["labels"] = np.zeros(3)
    fails_to_open(path, path, "has no images and depths", "nyu_depth_v2_labeled.mat")


def test_nyu_file_of_another_size(tmp_path):
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file["images"] = np.zeros((1, 3, 32, 24), dtype=np.uint8)
        file["depths"] = np.zeros((1, 32, 24), dtype=np.float32)
    fails_to_open(path, path, r"holds images \(1, 3, 32, 24\)", "expected N images of 640x480")


def test_nyu_file_whose_data_are_damaged(tmp_path):
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("images", data=np.zeros((1, 3, 640, 480), np.uint8), compression="gzip")
        depths = file.create_dataset("depths", data=np.ones((1, 640, 480), np.float32), compression="gzip")
        chunk = depths.id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(data)
    recording = open_recording(str(path))
    fails(lambda: recording.depth(0), path, "frame 0 cannot be read", "copy the file again")


def test_nyu_without_h5py(tmp_path, monkeypatch):
    path = tmp_path / "nyu.mat"
    path.write_bytes(b"")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r'pip install "\.\[train\]"'):
        open_recording(str(path))


# --- Described folders ---


def test_folder_without_description(tmp_path):
    fails(lambda: open_recording(f"folder:{tmp_path}"), tmp_path / "dataset.toml", "is missing", "write one")


def test_folder_description_that_is_not_toml(folder):
    (folder / "dataset.toml").write_text("kind = \n")
    fails_to_open(folder, folder / "dataset.toml", "is not valid TOML .*line 1", "correct that line")


def test_folder_description_that_is_too_deep(folder):
    (folder / "dataset.toml").write_text(f"kind = {100_000 * '['}")
    fails_to_open(folder, folder / "dataset.toml", "is not valid TOML", "correct that line")


def test_folder_unknown_key(folder):
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + "depthscale = 5000\n")
    fails_to_open(folder, folder / "dataset.toml", "depthscale is not a known", "known are: .*depth_scale")


@pytest.mark.parametrize(
    "key",
    ["kind", "color", "count", "width", "height", "fx", "fy", "cx", "cy", "depth_scale", "poses"],
)
def test_folder_missing_key(folder, key):
    lines = synthetic.SEQUENCE_TOML.splitlines()
    toml = "\n".join(line for line in lines if not line.startswith(f"{key} "))
    (folder / "dataset.toml").write_text(toml)
    fails_to_open(folder, folder / "dataset.toml", f"{key} is missing", f"write {key} = ")


def test_folder_pairs_without_depth(folder):
    lines = synthetic.SEQUENCE_TOML.replace('"sequence"', '"pairs"').splitlines()
    toml = "\n".join(line for line in lines if not line.startswith("depth "))
    (folder / "dataset.toml").write_text(toml)
    fails_to_open(folder, folder / "dataset.toml", "depth is missing", "write depth = ")


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("kind", '"video"', "is 'video'"),
        ("kind", "3", "is 3, not a text"),
        ("color", "3", "is 3, not a text"),
        ("color", '"color/{number}.jpg"', "not a pattern of {index}"),
        ("color", '"color/{index:q}.jpg"', "not a pattern of {index}"),
        ("color", '"color/{index:99999999999d}"', "not a pattern of {index}"),  # more than memory holds
        ("color", '"color/{index:99999999999999999999d}"', "not a pattern of {index}"),
        ("color", '"color/000010.jpg"', "the same file for every index"),
        ("count", "3.5", "is 3.5, not a whole number"),
        ("count", "0", "leaves no frames"),
        ("start", "true", "is True, not a whole number"),
        ("step", "0", "is 0, not positive"),
        ("width", '"32"', "is '32', not a whole number"),
        ("fx", '"30"', "is '30', not a number"),
        ("fx", "nan", "is nan, not a number"),
        ("fx", "true", "is True, not a number"),
        ("depth_scale", "0", "is 0, not from 1e-06 to 1e+09"),
        ("depth_scale", "1e-300", "is 1e-300, not from 1e-06 to 1e+09"),
        ("distortion", "[0.1, 0.2]", "not five numbers"),
        ("distortion", '["a", 0, 0, 0, 0]', "not five numbers"),
    ],
)
def test_folder_mistyped_key(folder, key, value, problem):
    toml = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", synthetic.SEQUENCE_TOML)
    (folder / "dataset.toml").write_text(toml)
    fails_to_open(folder, folder / "dataset.toml", f"{key} .*{re.escape(problem)}", f"write {key} = ")


def test_folder_count_beside_stop(folder):
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + "stop = 20\n")
    fails_to_open(folder, folder / "dataset.toml", "stop is given beside count", "write stop")


def test_folder_intrinsics_that_do_not_fit(folder):
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("cx = 15.5", "cx = 320"))
    fails_to_open(folder, folder / "dataset.toml", "camera.cx/cy: .*outside the 32x24", "intrinsics belong")


def test_folder_image_missing(folder):
    (folder / "depth/000020.png").unlink()
    fails_to_open(folder, folder / "depth/000020.png", "is missing", "correct depth or count in dataset.toml")


def test_folder_pose_file_missing(folder):
    (folder / "poses.txt").unlink()
    fails_to_open(folder, folder / "poses.txt", "is missing", "correct poses in dataset.toml")


def test_folder_poses_of_another_count(folder):
    lines = (folder / "poses.txt").read_text().splitlines(keepends=True)
    (folder / "poses.txt").write_text("".join(lines[:-1]))
    fix = "one line for each frame; without some, number the others' images anew, or give rate_hz"
    fails_to_open(folder, folder / "poses.txt", "has 2 poses for 3 frames", fix)


def test_folder_pose_that_is_not_known(folder):
    """What is advised leads to a recording: of the frames that have poses, or of all without."""
    path = folder / "poses.txt"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:-1], "5.2 nan nan nan 0 0 0 1\n"]))
    fails_to_open(folder, path, "pose 3 is NaN", "leave out frames without a pose")
    path.write_text("".join(lines[:-1]))
    description = folder / "dataset.toml"
    description.write_text(synthetic.SEQUENCE_TOML.replace("count = 3", "count = 2"))
    assert len(open_recording(str(folder)).poses) == 2
    description.write_text(synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 10"))
    assert open_recording(str(folder)).poses is None


def test_folder_image_whose_name_is_too_long(folder):
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("06d}.png", "0999d}.png"))
    with pytest.raises(DataError, match="is missing; restore it, or correct depth"):
        open_recording(str(folder))


@pytest.mark.parametrize("rate", ["0", "-1", "true", '"30"'])
def test_folder_rate_in_place_of_poses(folder, rate):
    toml = synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', f"rate_hz = {rate}")
    (folder / "dataset.toml").write_text(toml)
    fails_to_open(folder, folder / "dataset.toml", "rate_hz is .*, not (positive|a number)", "write rate_hz = 30")


# --- Video ---


VIDEO = ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 31.0, 23.0))


def test_video_without_intrinsics(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    problem = "without poses, without depth, and says nothing of its camera"
    fails_to_open(path, path, problem, "monoloc localize or inspect --intrinsics 64,48,FX,FY,CX,CY")


def test_video_that_cannot_be_decoded(tmp_path, capfd):
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"not a video")
    fails_to_open(path, path, "cannot be decoded as a video", "convert it to .mp4")
    assert capfd.readouterr().err == ""


class Capture:
    """A cv2.VideoCapture of a stream without times, and with another frame rate. (Its subclasses crash.)"""

    rate_hz = 0.0

    def __init__(self, path: str) -> None:
        self._capture = OpenCVCapture(path)

    def get(self, key: int) -> float:
        return {cv2.CAP_PROP_POS_MSEC: 0.0, cv2.CAP_PROP_FPS: self.rate_hz}.get(key, self._capture.get(key))

    def __getattr__(self, name: str):
        return getattr(self._capture, name)


OpenCVCapture = cv2.VideoCapture


def test_video_without_times_or_rate(tmp_path, monkeypatch):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    fails(lambda: open_recording(str(path), VIDEO), path, "states neither times .* nor a frame rate", "convert it")
    monkeypatch.setattr(Capture, "rate_hz", 4.0)
    np.testing.assert_allclose(open_recording(str(path), VIDEO).timestamps_s, np.arange(6) / 4.0)


def test_video_that_was_cut_while_it_was_read(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO)
    synthetic.write_video(path, frames=4)
    recording.color(3)
    recording.color(0)  # from the beginning, of what is there now
    fails(lambda: recording.color(5), path, "cannot be decoded after frame 3", "0:4")


def test_video_whose_name_opencv_cannot_take(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9.avi")
    path.write_bytes(b"")
    fails(lambda: open_recording(str(path), VIDEO), path, "has a name that is not UTF-8", "rename the file")


def test_video_with_a_camera_of_another_size(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    options = ReaderOptions(camera=Camera(640, 480, 500.0, 500.0, 320.0, 240.0))
    refuses(lambda: open_recording(str(path), options), "camera", "for 640x480, but .* is 64x48", "intrinsics")


def test_depth_of_a_video(tmp_path):
    path = tmp_path / "walk.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO)
    fails(lambda: recording.depth(0), path, "is a video and has no depth", "use predicted depth")
