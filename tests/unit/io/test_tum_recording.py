"""TUM sequences: colour, depth and pose associated by time, cameras by name, and what may be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    synthetic.write_tum(tmp_path)
    return tmp_path


def test_frames_are_associated_by_time_and_truth_is_interpolated(tmp_path: Path) -> None:
    folder = tmp_path / "rgbd_dataset_freiburg3_test"
    expected = synthetic.write_tum(folder)
    recording = open_recording(str(folder))
    check_recording(recording, 4)
    np.testing.assert_allclose(recording.poses, expected, atol=1e-6)
    assert recording.camera.fx == 535.4
    assert set(np.unique(recording.depth(0))) == {0.0, 2.0}
    assert open_recording(str(folder), ReaderOptions(depth_scale=1000.0)).depth(0).max() == 10.0


def test_frames_without_depth_or_pose_are_dropped(tmp_path: Path) -> None:
    synthetic.write_tum(tmp_path, frames=5)
    lists = {name: (tmp_path / f"{name}.txt").read_text().splitlines() for name in ("depth", "groundtruth")}
    del lists["depth"][2]  # the depth of frame 1
    lists["groundtruth"] = [
        line for line in lists["groundtruth"] if line.startswith("#") or float(line.split()[0]) < 100.1
    ]  # frame 4, at 100.133, is 43 ms after the last sample
    for name, lines in lists.items():
        (tmp_path / f"{name}.txt").write_text("\n".join(lines) + "\n")
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.timestamps_s, [100.0, 100.066667, 100.1], atol=1e-5)
    assert recording.notes == [
        "2 of 5 frames are left out: 1 without depth within 20 ms, 1 without a pose",
        "the intrinsics are assumed (f = 525 pixels, ROS's default), because the folder's name has no freiburg1, 2 "
        "or 3; give --camera for another camera",
    ]


def test_poses_of_another_rate_are_interpolated(tmp_path: Path) -> None:
    """At 5 Hz, of a constant twist; beyond their ends the nearest is taken, within 20 ms."""
    expected = synthetic.write_tum(tmp_path, frames=10)
    rows = np.loadtxt(tmp_path / "groundtruth.txt")
    kept = rows[np.abs(rows[:, :1] - [100.01, 100.21]).min(axis=1) < 0.001]
    assert len(kept) == 2
    np.savetxt(tmp_path / "groundtruth.txt", kept)
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.timestamps_s, 100.0 + np.arange(7) / 30.0, atol=1e-5)
    np.testing.assert_allclose(recording.poses[1:], expected[1:7], atol=1e-6)
    np.testing.assert_allclose(recording.poses[0], open_recording(str(tmp_path)).poses[0])
    assert recording.notes[0] == "3 of 10 frames are left out: 3 without a pose"


def test_poses_too_far_apart_are_not_interpolated(tmp_path: Path) -> None:
    expected = synthetic.write_tum(tmp_path, frames=10)
    times_s = 100.0 + np.arange(10) / 30.0 + 0.003
    (tmp_path / "groundtruth.txt").write_text(synthetic.tum_lines(times_s[::9], expected[::9]))
    recording = open_recording(str(tmp_path))
    np.testing.assert_allclose(recording.timestamps_s, [100.0, 100.3], atol=1e-5)
    np.testing.assert_allclose(recording.poses, expected[::9], atol=1e-6)


def test_association_is_one_to_one(tmp_path: Path) -> None:
    synthetic.write_tum(tmp_path, frames=2)
    # Two colour images 10 ms apart, and one depth image between them, nearer to the second.
    (tmp_path / "rgb.txt").write_text("100.000 rgb/100.000000.png\n100.010 rgb/100.033333.png\n")
    (tmp_path / "depth.txt").write_text("100.008 depth/100.005000.png\n")
    np.testing.assert_allclose(open_recording(str(tmp_path)).timestamps_s, [100.010])


@pytest.mark.parametrize(("name", "fx"), [("freiburg1_xyz", 517.3), ("freiburg2_desk", 520.9), ("mine", 525)])
def test_cameras_are_known_by_name(tmp_path: Path, name: str, fx: float) -> None:
    synthetic.write_tum(tmp_path / name, frames=1)
    (tmp_path / name / "depth.txt").unlink()
    recording = open_recording(f"tum:{tmp_path / name}")
    assert recording.camera.fx == fx
    assert not recording.has_depth
    assert bool(recording.notes) == (name == "mine")
    given = ReaderOptions(camera=recording.camera)
    assert open_recording(f"tum:{tmp_path / name}", given).notes == []


def test_poses_are_optional(tmp_path: Path) -> None:
    synthetic.write_tum(tmp_path)
    (tmp_path / "groundtruth.txt").unlink()
    recording = open_recording(str(tmp_path))
    check_recording(recording, 4)
    assert recording.poses is None and recording.has_depth


def test_missing_list_is_refused(tmp_path: Path) -> None:
    refuses_data(lambda: open_recording(f"tum:{tmp_path}"), tmp_path / "rgb.txt", "is missing", "TUM sequence")


def test_malformed_list_is_refused(sequence: Path) -> None:
    path = sequence / "depth.txt"
    path.write_text("depth/100.005000.png 100.0\n")
    refuses_to_open(sequence, path, "line 1 is not a time stamp and a file", "t filename")


def test_empty_list_is_refused(sequence: Path) -> None:
    path = sequence / "depth.txt"
    path.write_text("# nothing\n")
    refuses_to_open(sequence, path, "lists no images", "t filename")


def test_listed_image_that_is_missing_is_refused(sequence: Path) -> None:
    path = sequence / "rgb" / "100.000000.png"
    path.unlink()
    refuses_to_open(sequence, path, "is missing", "restore it, or remove its line from rgb.txt")


@pytest.mark.parametrize("name", ["rgb.txt", "groundtruth.txt"])
def test_time_that_does_not_increase_is_refused(sequence: Path, name: str) -> None:
    lines = (sequence / name).read_text().splitlines()
    (sequence / name).write_text("\n".join([*lines, lines[2]]) + "\n")
    refuses_to_open(sequence, sequence / name, r"time stamp of entry \d+ does not increase", "sort")


def test_clocks_that_differ_are_refused(sequence: Path) -> None:
    rows = np.loadtxt(sequence / "groundtruth.txt")
    np.savetxt(sequence / "groundtruth.txt", rows + np.eye(8)[0] * 3600.0)
    refuses_to_open(sequence, sequence, "none of its 4 frames can be used: 4 without a pose", "one clock, in seconds")
