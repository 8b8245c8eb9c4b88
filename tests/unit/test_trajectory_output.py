"""The trajectory that localize writes: by its suffix, with the lost frames marked or left out."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from mavlink_helpers import BLACK, CAMERA, step_at
from monoloc.bundle import Bundle
from monoloc.errors import SettingError
from monoloc.geometry import se3_exp
from monoloc.io.pose_files import read_tum
from monoloc.io.pose_table import COLUMNS
from monoloc.supervision.state import Reason
from monoloc.trajectory_output import check_trajectory, trajectory_output
from refusals import refuses, refuses_data
from synthetic_room import room_bundle

POSES = se3_exp(np.random.default_rng(1).standard_normal((4, 6)))


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(60, 6)


def write(path: Path, bundle: Bundle) -> None:
    output = trajectory_output(path, bundle, CAMERA)
    for index, pose in enumerate(POSES):
        lost = {"state": "lost", "reasons": frozenset({Reason.SEARCHING})} if index == 1 else {}
        output.add(10.0 + index, f"frame-{index}", BLACK, step_at(pose, **lost))
    assert not path.exists()  # not before all is there
    output.write()
    output.close()


@pytest.mark.parametrize("suffix", [".txt", ".tum", ".TUM"])
def test_a_tum_trajectory_leaves_out_lost_frames(bundle: Bundle, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"trajectory{suffix}"
    write(path, bundle)
    times_s, poses = read_tum(path)
    np.testing.assert_array_equal(times_s, [10.0, 12.0, 13.0])
    np.testing.assert_allclose(poses, POSES[[0, 2, 3]], atol=1e-8)


def test_a_table_has_every_frame_with_its_state(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.csv"
    write(path, bundle)
    with path.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert tuple(rows[0]) == COLUMNS
    assert [(row["frame"], row["state"], row["reasons"]) for row in rows] == [
        ("frame-0", "tracking", ""),
        ("frame-1", "lost", "searching"),
        ("frame-2", "tracking", ""),
        ("frame-3", "tracking", ""),
    ]
    assert [float(row["cov_rx_rx_rad2"]) for row in rows] == [1e-4] * 4


def test_an_mcap_file_has_poses_of_frames_that_are_not_lost(bundle: Bundle, tmp_path: Path) -> None:
    path = tmp_path / "trajectory.mcap"
    write(path, bundle)
    with path.open("rb") as file:
        times_ns = [each.log_time for *_, each in make_reader(file).iter_messages(topics=["/monoloc/pose"])]
    assert times_ns == [10 * 10**9, 12 * 10**9, 13 * 10**9]
    assert list(tmp_path.iterdir()) == [path]


def test_an_mcap_file_is_whole_or_not_there(bundle: Bundle, tmp_path: Path) -> None:
    """One that is given up, and one whose times ROS cannot hold, which is said at the end: others are written too."""
    path = tmp_path / "trajectory.mcap"
    output = trajectory_output(path, bundle, CAMERA)
    output.add(10.0, "a", BLACK, step_at(POSES[0]))
    output.close()
    output = trajectory_output(path, bundle, CAMERA)
    output.add(-1.0, "a", BLACK, step_at(POSES[0]))
    refuses_data(output.write, path, "cannot hold the time -1.000 s", "another format")
    output.close()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["trajectory", "trajectory.json"])
def test_another_suffix_is_refused(name: str) -> None:
    fix = r"choose from \.txt, \.tum, \.csv, \.mcap"
    refuses(lambda: check_trajectory(Path(name)), SettingError, f"^--out: {name} has no suffix .*; {fix}")
