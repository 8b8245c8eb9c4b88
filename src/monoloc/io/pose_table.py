"""Tables of poses with what is known of each: CSV, one row a frame, as ``localize`` and ``fly`` write them.

:func:`monoloc.pose_rows.row` makes a row.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text
from monoloc.io.pose_files import check_increasing, poses_from_quaternions

UPPER = np.triu_indices(6)
_POSE = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UNITS = ("m2", "m_rad", "rad2")


def _covariance_column(row: int, column: int) -> str:
    unit = _UNITS[(row >= 3) + (column >= 3)]
    return f"cov_{_AXES[row]}_{_AXES[column]}_{unit}"


COLUMNS = (
    "time_s",
    "frame",
    "state",
    "reasons",
    "probability_far",
    "restarted",
    "level",
    *_POSE,
    *(_covariance_column(row, column) for row in range(6) for column in range(row, 6)),
)
"""``T_world_camera``, and the upper triangle of its covariance: of position in the camera's axes (m) and of the
rotation vector (rad), see :class:`monoloc.particle_filter.estimate.Estimate`. Semicolons separate reasons."""


ROOM = "room"
"""Column of a table whose poses are in the worlds of several rooms, see :mod:`monoloc.place.place_table`."""


def read_pose_table(path: Path) -> tuple[FloatArray, FloatArray]:
    """The poses of a table, without those of lost frames: increasing times (N,) in seconds, poses (N, 4, 4), N >= 1.

    Raises:
        DataError: the file cannot be read, is no such table, or has a pose for no frame.
    """
    lines = csv.DictReader(read_text(path).splitlines())
    try:
        if not {"time_s", "state", *_POSE} <= set(lines.fieldnames or ()):
            fix = "give a table of monoloc localize --out or monoloc fly --out"
            raise DataError(path, "is no table of poses", fix)
        if ROOM in (lines.fieldnames or ()):
            fix = f"keep the rows of one room, and remove the column {ROOM}"
            raise DataError(path, "has poses in the worlds of several rooms", fix)
        whole = _whole(lines, path)
        rows = [[float(line[name]) for name in ("time_s", *_POSE)] for line in whole if line["state"] != "lost"]
    except (ValueError, csv.Error) as error:
        raise DataError(path, f"line {max(1, lines.line_num)} has no pose", "remove this line") from error
    if not rows:
        raise DataError(path, "has no pose: every frame is lost", "give a trajectory with poses")
    numbers = np.array(rows)
    check_increasing(numbers[:, 0], path)
    return numbers[:, 0], poses_from_quaternions(numbers[:, 4:], numbers[:, 1:4], path)


def _whole(lines: csv.DictReader[str], path: Path) -> Iterator[dict[str, str]]:
    """The rows, each with a value in every column; the last number of a shorter one may lack digits.

    Raises:
        DataError: a row is shorter.
    """
    for line in lines:
        if None in line.values():
            raise DataError(path, f"line {lines.line_num} is cut short", "remove this line")
        yield line
