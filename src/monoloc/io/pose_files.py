"""Poses out of files: parsed, checked to be rigid, rid of rounding; and which belong together in time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc import geometry
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_rows

# Of a quaternion's length: files carry 3 to 6 digits; what is further off is columns in another order.
UNIT_TOLERANCE = 1e-2


def checked_poses(poses: FloatArray, files: Sequence[Path], names: Sequence[str]) -> FloatArray:
    """The poses with exact rotations, after a check that each is rigid.

    Args:
        poses: (N, 4, 4), ``T_a_b`` of any frames.
        files: N files they were read from (the same one N times where one file holds all).
        names: N names of what each belongs to, for the message.

    Raises:
        DataError: a pose that is not finite, or not rigid to 1e-3.
    """
    rigid = geometry.is_rigid(poses)
    if not rigid.all():
        bad = int(np.argmin(rigid))
        if not np.isfinite(poses[bad]).all():
            raise DataError(
                files[bad], f"the pose of {names[bad]} is NaN or infinite", "correct it or remove the frame"
            )
        raise DataError(
            files[bad],
            f"the pose of {names[bad]} is not rigid",
            "write camera-to-world [R t; 0 0 0 1] with a proper rotation R",
        )
    # Files round rotations to a few digits; inverse-by-transpose wants them exact.
    return geometry.make_pose(geometry.nearest_rotation(poses[:, :3, :3]), poses[:, :3, 3])


def read_matrix_pose(path: Path) -> FloatArray:
    """The 4x4 matrix in a text file, not yet checked to be rigid.

    Raises:
        DataError: the file is not four rows of four numbers.
    """
    rows = read_rows(path, 4, "four numbers of a 4x4 camera-to-world matrix")
    if len(rows) != 4:
        raise DataError(path, f"has {len(rows)} rows", "write a 4x4 camera-to-world matrix")
    return rows


def poses_from_quaternions(quaternions_xyzw: FloatArray, translations_m: FloatArray, file: Path) -> FloatArray:
    """Poses of (N, 4) quaternions (x, y, z, w) and (N, 3) translations, all out of one file: (N, 4, 4).

    Raises:
        DataError: a row that is not finite, or a quaternion that is not of unit length.
    """
    finite = np.isfinite(quaternions_xyzw).all(axis=1) & np.isfinite(translations_m).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite)) + 1
        raise DataError(file, f"pose {row} is NaN or infinite", "correct it, or leave out frames without a pose")
    norms = np.linalg.norm(quaternions_xyzw, axis=1)
    unit = np.abs(norms - 1.0) < UNIT_TOLERANCE
    if not unit.all():
        row = int(np.argmin(unit))
        raise DataError(
            file,
            f"pose {row + 1} is not rigid: its quaternion has length {norms[row]:.3g}",
            "write unit quaternions, in this format's order",
        )
    return geometry.make_pose(geometry.quaternion_to_rotation(quaternions_xyzw), translations_m)


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    """A trajectory in TUM's format: time stamps (N,) in seconds, which increase, and poses (N, 4, 4), N >= 1.

    Raises:
        DataError: the file cannot be read, a line of it is no pose, or time does not increase.
    """
    rows = read_rows(path, 8, "t tx ty tz qx qy qz qw")
    check_increasing(rows[:, 0], path)
    return rows[:, 0], poses_from_quaternions(rows[:, 4:], rows[:, 1:4], path)


def check_increasing(times_s: FloatArray, path: Path) -> None:
    """Raise DataError unless the time stamps (N,) are finite and strictly increase."""
    increases = np.diff(times_s, prepend=-np.inf) > 0.0
    if not (np.isfinite(times_s).all() and increases.all()):
        row = int(np.argmin(np.isfinite(times_s) & increases)) + 1
        raise DataError(path, f"the time stamp of entry {row} does not increase", "sort the entries by time")


def nearest_times(query_s: FloatArray, times_s: FloatArray) -> NDArray[np.int64]:
    """Index of the entry of ``times_s`` (N,), which increase, nearest to each query (Q,): (Q,)."""
    after = np.searchsorted(times_s, query_s).clip(max=len(times_s) - 1)
    before = (after - 1).clip(min=0)
    return np.where(np.abs(query_s - times_s[before]) < np.abs(times_s[after] - query_s), before, after)
