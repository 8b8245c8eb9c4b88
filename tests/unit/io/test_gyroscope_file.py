"""Samples of a gyroscope: other columns are ignored, and what is no sample is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.io.gyroscope_file import read_gyroscope
from refusals import refuses_data

TEXT = "t_s,wx,wy,wz,fx,fy,fz\n0.000,0.1,-0.2,0.3,0,0,9.8\n0.005,0.2,-0.3,0.4,0,0,9.8\n"


def test_samples_are_read_by_the_names_of_their_columns(tmp_path: Path) -> None:
    path = tmp_path / "imu.csv"
    for text in (TEXT, "wz,wy,wx,t_s\n0.3,-0.2,0.1,0\n0.4,-0.3,0.2,0.005\n"):
        path.write_text(text)
        times_s, rates = read_gyroscope(path)
        np.testing.assert_array_equal(times_s, [0.0, 0.005])
        np.testing.assert_array_equal(rates, [[0.1, -0.2, 0.3], [0.2, -0.3, 0.4]])


@pytest.mark.parametrize(
    ("text", "problem", "fix"),
    [
        ("time,gx,gy,gz\n0,0,0,0\n", "has no columns of a gyroscope", "write t_s,wx,wy,wz in the first line"),
        ("t_s,wx,wy,wz\n", "has no samples", "at least one"),
        ("t_s,wx,wy,wz\n0,0,0\n", "line 2 is no sample", "remove this line"),
        ("t_s,wx,wy,wz\n0,0,0,fast\n", "line 2 is no sample", "remove this line"),
        ("t_s,wx,wy,wz\n0,0,0," + "0" * 200_000, "is no sample", "remove this line"),
        ("t_s,wx,wy,wz\n0,0,0,0\n1,0,inf,0\n", "sample 2 is NaN or infinite", "remove this line"),
        ("t_s,wx,wy,wz\n0,0,0,0\n1,0,0,-120\n", "sample 2 turns by 120 rad/s", "not degrees"),
        ("t_s,wx,wy,wz\n1,0,0,0\n0,0,0,0\n", "time stamp of entry 2 does not increase", "sort"),
    ],
)
def test_what_is_no_table_of_samples_is_refused(tmp_path: Path, text: str, problem: str, fix: str) -> None:
    path = tmp_path / "imu.csv"
    path.write_text(text)
    refuses_data(lambda: read_gyroscope(path), path, problem, fix)
