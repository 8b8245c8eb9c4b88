"""Poses out of files: increasing times, unit quaternions, and which times belong together."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from monoloc.io.pose_files import nearest_times, poses_from_quaternions, read_tum
from refusals import refuses_data


def test_nearest_times_agree_with_brute_force() -> None:
    rng = np.random.default_rng(0)
    for query_count, time_count in itertools.product((1, 5, 40), (1, 2, 30)):
        query, times = np.sort(rng.uniform(size=query_count)), np.sort(rng.uniform(size=time_count))
        brute = np.abs(query[:, None] - times).argmin(axis=1)
        np.testing.assert_array_equal(nearest_times(query, times), brute)


@pytest.mark.parametrize("times", [(1.0, 0.0), (1.0, 1.0), (0.0, np.nan)])
def test_trajectory_whose_time_does_not_increase_is_refused(tmp_path: Path, times: tuple[float, float]) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_text("".join(f"{time} 0 0 0 0 0 0 1\n" for time in times))
    refuses_data(lambda: read_tum(path), path, "the time stamp of entry 2 does not increase", "by time")


def test_trajectory_with_times_in_nanoseconds_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.txt"
    path.write_text("1.7e18 0 0 0 0 0 0 1\n")
    refuses_data(lambda: read_tum(path), path, r"the time stamp of entry 1 is 1\.7e\+18 s", "write seconds")


@pytest.mark.parametrize(
    ("row", "problem", "fix"),
    [
        ([np.nan, 0, 0, 0, 0, 0, 1], "pose 2 is NaN or infinite", "leave out frames"),
        ([0, 0, 0, 0, 0, 0, np.inf], "pose 2 is NaN or infinite", "leave out frames"),
        ([0, 0, 0, 0, 0, 0, 5], "pose 2 is not rigid: its quaternion has length 5", "unit quaternions"),
    ],
)
def test_impossible_pose_is_refused(tmp_path: Path, row: list[float], problem: str, fix: str) -> None:
    rows, path = np.array([[0, 0, 0, 0, 0, 0, 1], row]), tmp_path / "trajectory.txt"
    refuses_data(lambda: poses_from_quaternions(rows[:, 3:], rows[:, :3], path), path, problem, fix)
