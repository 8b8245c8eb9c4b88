"""Folders that a dataset.toml describes: frames, names, poses, and every key that may be wrong."""

from __future__ import annotations

import os
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
    refuses_to_open(folder, folder / "dataset.toml", problem, "correct")


@pytest.mark.parametrize(("key", "nearest"), [("depthscale", "depth_scale, "), ("focal_x", "[a-z_, ]*fx")])
def test_unknown_key_is_refused_with_those_it_may_mean(folder: Path, key: str, nearest: str) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + f"{key} = 5000\n")
    problem = f"{key} is unknown, the nearest are {nearest}"
    refuses_to_open(folder, folder / "dataset.toml", problem, "correct its name")


@pytest.mark.parametrize("key", ["kind", "color", "width", "height", "fx", "fy", "cx", "cy", "depth_scale", "poses"])
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
        ("color", '"color/{index:6d}.jpg"', "not a pattern of {index}"),  # a slip: names with spaces
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
        ("fx", "1" + "0" * 400, "0..., not a number"),
        ("depth_scale", "0", "is 0, not from 1e-06 to 1e+09"),
        ("depth_scale", "1e-300", "is 1e-300, not from 1e-06 to 1e+09"),
        ("distortion", "[0.1, 0.2]", "not the 5 numbers k1, k2, p1, p2, k3 of brown"),
        ("distortion", '["a", 0, 0, 0, 0]', "not the 5 numbers"),
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


@pytest.mark.parametrize("count", ["count = 3\n", ""])
def test_folder_that_may_not_be_read_is_refused_as_such(
    folder: Path, monkeypatch: pytest.MonkeyPatch, count: str
) -> None:
    """Its files seem to be missing. A stand-in forbids it, since the superuser may read everything."""
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("count = 3\n", count))
    for image in (folder / "color").iterdir():
        image.unlink()
    monkeypatch.setattr(os, "access", lambda path, mode: path != folder / "color" or mode == os.F_OK)
    refuses_to_open(folder, folder / "color", "may not be read", "chmod -R a\\+rX .*color")


def test_image_name_that_is_too_long_is_refused(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("depth/", "depth/" + 300 * "d"))
    with pytest.raises(DataError, match="is missing; restore it, or correct depth"):
        open_recording(str(folder))


def test_files_that_begin_later_name_the_start(folder: Path) -> None:
    """As images that are numbered from 1, with a count."""
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("start = 10\n", ""))
    first = folder / "color" / "000000.jpg"
    refuses_to_open(folder, first, "is missing", "write start = 10 in dataset.toml, where the files begin")


def test_missing_pose_file_is_refused(folder: Path) -> None:
    (folder / "poses.txt").unlink()
    refuses_to_open(folder, folder / "poses.txt", "is missing", "correct poses in dataset.toml")


def test_poses_of_another_count_are_refused(folder: Path) -> None:
    lines = (folder / "poses.txt").read_text().splitlines(keepends=True)
    (folder / "poses.txt").write_text("".join(lines[:-1]))
    fix = "one line for each frame, with nan in place of an unknown pose's seven numbers; or give rate_hz"
    refuses_to_open(folder, folder / "poses.txt", "has 2 poses for 3 frames", fix)


def test_deleted_image_of_a_numbered_sequence_is_named(folder: Path) -> None:
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace("count = 3\n", ""))
    deleted = folder / "color/000015.jpg"
    deleted.unlink()
    problem = "is missing, and poses.txt has 3 poses for 2 frames"
    refuses_to_open(folder, deleted, problem, "restore what is missing, or delete its line of poses.txt")


def test_advice_about_unknown_poses_leads_to_a_recording(folder: Path) -> None:
    """Of the frames that have poses, or of all frames without poses."""
    path = folder / "poses.txt"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([lines[0], lines[1], "5.1" + 7 * " nan" + "\n", lines[3]]))
    recording = open_recording(str(folder))
    assert recording.frame_names == ["000010", "000020"] and len(recording.poses) == 2
    np.testing.assert_allclose(recording.timestamps_s, [5.0, 5.2])
    assert recording.notes == ["1 of 3 frames are left out: 1 without a pose"]
    path.write_text("".join(lines[:-1]))
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', "rate_hz = 10"))
    assert open_recording(str(folder)).poses is None


@pytest.mark.parametrize("rate", ["1e-320", "1e300"])
def test_rate_of_no_camera_is_refused(folder: Path, rate: str) -> None:
    toml = synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', f"rate_hz = {rate}")
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", "the rate of no camera", "write rate_hz = 30")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("{index:06d}.jpg", "{index:0999999999d}.jpg", "not a pattern of {index}"),
        ("{index:06d}.jpg", "{index.__class__}.jpg", "not a pattern of {index}"),
        ("{index:06d}.jpg", "{index!r}.jpg", "not a pattern of {index}"),
        ("poses.txt", "/dev/zero", "is missing"),
        ("poses.txt", "a\\u0000b", "is missing"),
    ],
)
def test_paths_that_are_none_are_refused(folder: Path, old: str, new: str, problem: str) -> None:
    text = synthetic.SEQUENCE_TOML
    assert old in text
    (folder / "dataset.toml").write_text(text.replace(old, new))
    with pytest.raises(DataError, match=problem):
        open_recording(str(folder))


@pytest.mark.parametrize("end", ["1000000000", 30 * "9"])
def test_frames_without_end_are_refused(folder: Path, end: str) -> None:
    text = synthetic.SEQUENCE_TOML.replace("count = 3", f"stop = {end}")
    (folder / "dataset.toml").write_text(text)
    refuses_to_open(folder, folder / "dataset.toml", "makes more than 1000000 frames", "write stop = 400")


def test_pose_beyond_any_room_is_refused(folder: Path) -> None:
    path = folder / "poses.txt"
    lines = path.read_text().splitlines()
    time, _, *rest = lines[-1].split()
    path.write_text("\n".join([*lines[:-1], " ".join([time, "1e300", *rest])]))
    refuses_to_open(folder, path, "is 1e.300 m from the origin", "subtract the same offset")


@pytest.mark.parametrize("rate", ["0", "-1", "true", '"30"'])
def test_impossible_rate_is_refused(folder: Path, rate: str) -> None:
    toml = synthetic.SEQUENCE_TOML.replace('poses = "poses.txt"', f"rate_hz = {rate}")
    (folder / "dataset.toml").write_text(toml)
    refuses_to_open(folder, folder / "dataset.toml", "rate_hz is .*, not (positive|a number)", "write rate_hz = 30")


# --- Frames that exist ---


def changed(*changes: tuple[str, str]) -> str:
    """The description with lines replaced, by their keys; an empty line removes one."""
    toml = synthetic.SEQUENCE_TOML
    for key, line in changes:
        toml, count = re.subn(rf"(?m)^{key} = .*\n", f"{line}\n" if line else "", toml)
        assert count == 1 or not line or key not in synthetic.SEQUENCE_TOML
        if count == 0:
            toml += f"{line}\n"
    return toml


EXISTING = (("count", ""), ("start", ""), ("step", ""))


def test_frames_are_those_that_exist_where_none_are_stated(folder: Path) -> None:
    """Their numbers may have gaps, which the times have too."""
    toml = changed(*EXISTING, ("poses", "rate_hz = 20"))
    (folder / "dataset.toml").write_text(toml)
    (folder / "depth/000015.png").unlink()
    (folder / "color/notes.jpg").write_text("")
    (folder / "color/17.jpg").write_bytes((folder / "color/000010.jpg").read_bytes())  # not as the pattern writes it
    recording = open_recording(str(folder))
    check_recording(recording, 2)
    assert recording.frame_names == ["000010", "000020"]
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.5])
    assert recording.notes == ["1 of 3 frames are left out: 1 without depth"]
    (folder / "dataset.toml").write_text(toml + "start = 5\nstep = 10\n")
    (folder / "depth/000015.png").write_bytes((folder / "depth/000010.png").read_bytes())
    assert open_recording(str(folder)).frame_names == ["000015"]


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ('color = "color/{index:06d}.png"', "which no file matches"),
        ('color = "color/{index}{index}.jpg"', "not a pattern with one {index}"),
        ('color = "color/{index"', "not a pattern of {index}"),
    ],
)
def test_pattern_that_finds_nothing_is_refused(folder: Path, line: str, problem: str) -> None:
    (folder / "dataset.toml").write_text(changed(*EXISTING, ("color", line)))
    refuses_to_open(folder, folder / "dataset.toml", f"color .*{problem}", "write color = ")


@pytest.mark.parametrize(
    ("line", "problem"),
    [("start = 21", "start is 21"), ("start = 11\nstep = 10", "step is 10"), ("step = 7", "step is 7")],
)
def test_selection_that_leaves_nothing_is_refused_by_its_key(folder: Path, line: str, problem: str) -> None:
    (folder / "dataset.toml").write_text(f"{changed(*EXISTING)}{line}\n")
    problem += ", by which no frame remains of the colour images 10 to 20"
    refuses_to_open(folder, folder / "dataset.toml", problem, f"write {problem.split()[0]} = ")


# --- Poses of other kinds ---


def write_pose_files(folder: Path, poses: np.ndarray, suffix: str) -> None:
    (folder / "pose").mkdir()
    for index, pose in zip((10, 15, 20), poses, strict=True):
        path = folder / f"pose/{index}.{suffix}"
        np.save(path, pose) if suffix == "npy" else np.savetxt(path, pose)


@pytest.mark.parametrize("suffix", ["txt", "npy"])
@pytest.mark.parametrize("axes", ["opencv", "opengl"])
@pytest.mark.parametrize("direction", ["camera-to-world", "world-to-camera"])
def test_pose_files_of_other_conventions(folder: Path, suffix: str, axes: str, direction: str) -> None:
    expected = synthetic.make_poses(3)
    poses = expected @ np.diag([1.0, -1.0, -1.0, 1.0]) if axes == "opengl" else expected
    poses = np.linalg.inv(poses) if direction == "world-to-camera" else poses.copy()
    poses[:, :3, 3] *= 1000.0
    write_pose_files(folder, poses, suffix)
    lines = [
        f'poses = "pose/{{index}}.{suffix}"',
        f'rate_hz = 10\npose_axes = "{axes}"\npose_direction = "{direction}"\npose_unit_m = 0.001',
    ]
    (folder / "dataset.toml").write_text(changed(("poses", "\n".join(lines))))
    recording = open_recording(str(folder))
    check_recording(recording, 3)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-8)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.1, 0.2])


def test_frames_without_a_pose_are_counted(folder: Path) -> None:
    """Some tools write no file, others infinity."""
    poses = synthetic.make_poses(3)
    poses[1] = -np.inf
    write_pose_files(folder, poses, "txt")
    (folder / "pose/10.txt").unlink()
    toml = changed(("poses", 'poses = "pose/{index}.txt"\nrate_hz = 10'))
    (folder / "dataset.toml").write_text(toml)
    recording = open_recording(str(folder))
    assert recording.frame_names == ["000020"] and recording.timestamps_s[0] == 0.2
    np.testing.assert_allclose(recording.poses, poses[2:], atol=1e-8)
    assert recording.notes == ["2 of 3 frames are left out: 2 without a pose"]
    (folder / "pose/20.txt").unlink()
    problem = "none of its 3 frames can be used: 3 without a pose"
    refuses_to_open(folder, folder / "dataset.toml", problem, "correct depth and poses")


def test_pose_files_that_are_no_poses_are_refused(folder: Path) -> None:
    write_pose_files(folder, synthetic.make_poses(3), "npy")
    toml = changed(("poses", 'poses = "pose/{index}.npy"\nrate_hz = 10'))
    (folder / "dataset.toml").write_text(toml)
    np.save(folder / "pose/15.npy", np.eye(3))
    refuses_to_open(folder, folder / "pose/15.npy", r"holds float64 of shape \(3, 3\)", "a 4x4")
    np.save(folder / "pose/15.npy", 2.0 * np.eye(4))
    refuses_to_open(folder, folder / "pose/15.npy", "the pose of 15 is not rigid", "proper rotation")
    (folder / "dataset.toml").write_text(toml.replace("rate_hz = 10\n", ""))
    refuses_to_open(folder, folder / "dataset.toml", "rate_hz is missing; files of one pose", "write rate_hz = 30")


# --- Depth and lenses of other kinds ---

DEPTH_CAMERA = """\
depth_width = 40
depth_height = 30
depth_fx = 50.0
depth_fy = 50.0
depth_cx = 19.5
depth_cy = 14.5
"""
T_COLOR_DEPTH = "T_color_depth = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"


def test_depth_of_a_camera_of_its_own_is_registered(folder: Path) -> None:
    """A wall at 1.5 m that the depth camera, 10 cm to the right, sees in its narrower field of view."""
    for index in (10, 15, 20):
        synthetic.write_depth(folder / f"depth/{index:06d}.png", np.full((30, 40), 1500, np.uint16))
    toml = changed(("distortion", "")) + DEPTH_CAMERA + T_COLOR_DEPTH
    (folder / "dataset.toml").write_text(toml)
    recording = open_recording(str(folder))
    check_recording(recording, 3)
    # Columns of colour: 15.5 + 30 (x / 1.5 + 0.1 / 1.5), where x / 1.5 is from -19.5 / 50 to 19.5 / 50.
    columns = np.flatnonzero(recording.depth(0).any(axis=0))
    assert columns[0] == pytest.approx(15.5 - 30.0 * 0.39 + 2.0, abs=1.0)
    assert columns[-1] == pytest.approx(15.5 + 30.0 * 0.39 + 2.0, abs=1.0)
    assert set(np.unique(recording.depth(0))) == {0.0, 1.5}


def test_uncertain_depth_is_unknown(folder: Path) -> None:
    confidence = np.arange(32 * 24, dtype=np.uint8).reshape(24, 32) % 3
    for index in (10, 15, 20):
        synthetic.write_depth(folder / f"depth/{index:06d}.png", np.full((24, 32), 1500, np.uint16))
        synthetic.write_depth(folder / f"confidence/{index}.png", confidence)
    toml = synthetic.SEQUENCE_TOML + 'confidence = "confidence/{index}.png"\nleast_confidence = 1\n'
    (folder / "dataset.toml").write_text(toml)
    np.testing.assert_array_equal(open_recording(str(folder)).depth(1), np.where(confidence >= 1, 1.5, 0.0))
    (folder / "confidence/15.png").unlink()
    refuses_to_open(folder, folder / "confidence/15.png", "is missing", "correct confidence")


@pytest.mark.parametrize(
    ("model", "values"), [("fisheye", [0.1, 0.0, 0.0, 0.0]), ("rational", [0.1, 0, 0, 0, 0, 0.1, 0, 0])]
)
def test_lenses(folder: Path, model: str, values: list[float]) -> None:
    line = f'distortion = {values}\ndistortion_model = "{model}"'
    (folder / "dataset.toml").write_text(changed(("distortion", line)))
    assert open_recording(str(folder)).camera == Camera(32, 24, 30.0, 31.0, 15.5, 11.5, tuple(values), model)


@pytest.mark.parametrize(
    ("line", "key", "problem"),
    [
        ('pose_axes = "unity"', "pose_axes", "is 'unity'"),
        ('pose_direction = "both"', "pose_direction", "is 'both'"),
        ("pose_unit_m = 0", "pose_unit_m", "is 0.0, not positive"),
        ('distortion_model = "fov"', "distortion_model", "is 'fov'"),
        ('distortion_model = "fisheye"', "distortion", "not the 4 numbers k1, k2, k3, k4 of fisheye"),
        ("least_confidence = 2", "confidence", "is missing, without which least_confidence has no meaning"),
        ('confidence = "c/{index}.png"', "least_confidence", "is missing"),
        (T_COLOR_DEPTH, "depth_fx", "is missing, without which T_color_depth has no meaning"),
        ("depth_fx = 50.0", "depth_width", "is missing"),
        (DEPTH_CAMERA.replace("depth_fx = 50.0", "depth_fx = -1.0"), "depth camera fx/fy", "is .-1.0, 50.0."),
        (DEPTH_CAMERA + "T_color_depth = [[1, 0], [0, 1]]", "T_color_depth", "not a rigid 4x4 matrix"),
        (DEPTH_CAMERA + 'T_color_depth = "near"', "T_color_depth", "not a rigid 4x4 matrix"),
        (DEPTH_CAMERA + T_COLOR_DEPTH.replace("[1,", '["1",'), "T_color_depth", "not a rigid 4x4 matrix"),
        (DEPTH_CAMERA + T_COLOR_DEPTH.replace("0.1", "25"), "T_color_depth", "puts the cameras 25 m apart; its unit"),
        ("pose_unit_m = 1e-300", "pose_unit_m", "is 1e-300, the unit of no program"),
        ("down = [true, false, false]", "down", "is .*, not a direction"),
    ],
)
def test_keys_that_do_not_fit_are_refused(folder: Path, line: str, key: str, problem: str) -> None:
    for index in (10, 15, 20):
        synthetic.write_depth(folder / f"c/{index}.png", np.zeros((24, 32), np.uint8))
    (folder / "dataset.toml").write_text(synthetic.SEQUENCE_TOML + line + "\n")
    refuses_to_open(folder, folder / "dataset.toml", f"{re.escape(key)}:? .*{problem}", "")


@pytest.mark.parametrize("key", ["pose_axes", "pose_direction"])
def test_keys_of_poses_need_poses(folder: Path, key: str) -> None:
    (folder / "dataset.toml").write_text(changed(("poses", f'rate_hz = 10\n{key} = "opengl"')))
    refuses_to_open(folder, folder / "dataset.toml", f"poses is missing, without which {key}", "write poses")
