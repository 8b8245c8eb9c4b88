"""Folders that a dataset.toml describes: frames, names, poses, and every key that may be wrong."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A described folder with three frames of JPEG colour and PNG depth, 32x24."""
    synthetic.write_folder(tmp_path)
    return tmp_path


def test_sequence_is_read_as_described(tmp_path: Path) -> None:
    expected = synthetic.write_folder(tmp_path)
    for source in (f"folder:{tmp_path}", str(tmp_path), str(tmp_path / "dataset.toml")):
        recording = open_recording(source)
        check_recording(recording, 3)
        assert recording.frame_names == ["000010", "000015", "000020"]
        np.testing.assert_allclose(recording.timestamps_s, [5.0, 5.1, 5.2])
        np.testing.assert_allclose(recording.poses, expected, atol=1e-8)
        assert recording.depth(2).max() == 1.5
        assert recording.camera == Camera(32, 24, 30.0, 31.0, 15.5, 11.5, (0.1, -0.2, 0.0, 0.001, 0.0))


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("{index:03d}/color.jpg", ["010/color", "015/color", "020/color"]),
        ("f{index}/rgb/left.jpg", ["f10/rgb/left", "f15/rgb/left", "f20/rgb/left"]),
        ("../images/{index}/0.jpg", ["../images/10/0", "../images/15/0", "../images/20/0"]),
        ("color/frame.{index}", ["color/frame", "color/frame.15", "color/frame.20"]),
    ],
)
def test_frame_names_differ(tmp_path: Path, pattern: str, names: list[str]) -> None:
    folder = tmp_path / "frames"
    synthetic.write_folder(folder, synthetic.SEQUENCE_TOML.replace("color/{index:06d}.jpg", pattern))
    for index in (10, 15, 20):
        image = folder / pattern.format(index=index)
        image.parent.mkdir(parents=True, exist_ok=True)
        (folder / f"color/{index:06d}.jpg").rename(image)
    recording = open_recording(str(folder))
    check_recording(recording, 3)
    assert recording.frame_names == names


def test_stop_may_replace_count_and_depth_is_optional(tmp_path: Path) -> None:
    toml = synthetic.SEQUENCE_TOML.replace("count = 3", "stop = 21")
    toml = "\n".join(line for line in toml.splitlines() if not line.startswith("depth"))
    synthetic.write_folder(tmp_path, toml)
    recording = open_recording(str(tmp_path))
    check_recording(recording, 3)
    assert not recording.has_depth


def test_rate_may_replace_poses(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path, synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 20"))
    recording = open_recording(str(tmp_path))
    check_recording(recording, 3)
    assert recording.poses is None and recording.has_depth
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.05, 0.1])


def test_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path)
    path = tmp_path / "dataset.toml"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    check_recording(open_recording(str(tmp_path)), 3)


def test_missing_description_is_refused(tmp_path: Path) -> None:
    refuses_data(lambda: open_recording(f"folder:{tmp_path}"), tmp_path / "dataset.toml", "is missing", "write one")


@pytest.mark.parametrize(
    ("text", "problem"),
    [("kind = \n", "is not valid TOML .*line 1"), (f"kind = {100_000 * '['}", "is not valid TOML")],
)
def test_description_that_is_not_toml_is_refused(folder: Path, text: str, problem: str) -> None:
    """The second is nested deeper than a parser's stack."""
    (folder / "dataset.toml").write_text(text)
    refuses_to_open(folder, folder / "dataset.toml", problem, "correct that line")


def test_unknown_key_is_refused(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + "depthscale = 5000\n")
    refuses_to_open(folder, folder / "dataset.toml", "depthscale is not a known", "known are: .*depth_scale")


@pytest.mark.parametrize(
    "key", ["kind", "color", "count", "width", "height", "fx", "fy", "cx", "cy", "depth_scale", "poses"]
)
def test_missing_key_is_refused(folder: Path, key: str) -> None:
    lines = synthetic.SEQUENCE_TOML.splitlines()
    toml = "\n".join(line for line in lines if not line.startswith(f"{key} "))
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", f"{key} is missing", f"write {key} = ")


def test_pairs_need_depth(folder: Path) -> None:
    lines = synthetic.SEQUENCE_TOML.replace('"sequence"', '"pairs"').splitlines()
    toml = "\n".join(line for line in lines if not line.startswith("depth "))
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", "depth is missing", "write depth = ")


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
def test_value_of_another_kind_is_refused(folder: Path, key: str, value: str, problem: str) -> None:
    toml = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", synthetic.SEQUENCE_TOML)
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", f"{key} .*{re.escape(problem)}", f"write {key} = ")


def test_count_and_stop_exclude_each_other(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + "stop = 20\n")
    refuses_to_open(folder, folder / "dataset.toml", "stop is given beside count", "write stop")


def test_intrinsics_that_do_not_fit_are_refused(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("cx = 15.5", "cx = 320"))
    refuses_to_open(folder, folder / "dataset.toml", "camera.cx/cy: .*outside the 32x24", "intrinsics belong")


def test_missing_image_is_refused(folder: Path) -> None:
    (folder / "depth/000020.png").unlink()
    refuses_to_open(folder, folder / "depth/000020.png", "is missing", "correct depth or count in dataset.toml")


def test_image_name_that_is_too_long_is_refused(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("06d}.png", "0999d}.png"))
    with pytest.raises(DataError, match="is missing; restore it, or correct depth"):
        open_recording(str(folder))


def test_missing_pose_file_is_refused(folder: Path) -> None:
    (folder / "poses.txt").unlink()
    refuses_to_open(folder, folder / "poses.txt", "is missing", "correct poses in dataset.toml")


def test_poses_of_another_count_are_refused(folder: Path) -> None:
    lines = (folder / "poses.txt").read_text().splitlines(keepends=True)
    (folder / "poses.txt").write_text("".join(lines[:-1]))
    fix = "one line for each frame; if some have no pose, renumber the images of the others, or give rate_hz"
    refuses_to_open(folder, folder / "poses.txt", "has 2 poses for 3 frames", fix)


def test_advice_about_unknown_poses_leads_to_a_recording(folder: Path) -> None:
    """Of the frames that have poses, or of all frames without poses."""
    path = folder / "poses.txt"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:-1], "5.2 nan nan nan 0 0 0 1\n"]))
    refuses_to_open(folder, path, "pose 3 is NaN", "leave out frames without a pose")
    path.write_text("".join(lines[:-1]))
    description = folder / "dataset.toml"
    description.write_text(synthetic.SEQUENCE_TOML.replace("count = 3", "count = 2"))
    assert len(open_recording(str(folder)).poses) == 2
    description.write_text(synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 10"))
    assert open_recording(str(folder)).poses is None


@pytest.mark.parametrize("rate", ["0", "-1", "true", '"30"'])
def test_impossible_rate_is_refused(folder: Path, rate: str) -> None:
    toml = synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', f"rate_hz = {rate}")
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", "rate_hz is .*, not (positive|a number)", "write rate_hz = 30")
