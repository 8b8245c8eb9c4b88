"""Reading poses from files: parsing, checks for rigidity, exact rotations, and association by time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import decode_array
from monoloc.errors import DataError
from monoloc.geometry import (
    MAX_DISTANCE_M,
    FloatArray,
    invert,
    is_rigid,
    make_pose,
    nearest_rotation,
    quaternion_to_rotation,
    se3_exp,
    se3_log,
)
from monoloc.io.file_access import read_bytes, read_rows
from monoloc.io.image_header import is_numpy
from monoloc.io.recording import Remark

# Tolerance of a quaternion's length. Files have 3 to 6 digits; a larger deviation means columns in another order.
UNIT_TOLERANCE = 1e-2

OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
"""``T_opengl_opencv``: camera axes x right, y up, z backward, from x right, y down, z forward; (4, 4)."""
DOWN_OF_ARKIT = np.array([0.0, -1.0, 0.0])
"""Direction of gravity in ARKit's world, whose y axis points up, (3,)."""

# Between samples further apart, a hand-held camera departs from constant velocity by more than its poses' errors:
# 1 m/s^2 over 0.25 s is 8 mm.
MAX_POSE_GAP_S = 0.25
MAX_POSE_OFFSET_S = 0.02  # a pose this near is that of the image, without interpolation

_LATEST_S = 1e10  # of a time stamp: milliseconds since 1970 are more, and ROS has no later nanoseconds

UNTIMED_RATE_HZ = 5.0
UNTIMED = Remark(f"the files state no times; frames are taken to be {1.0 / UNTIMED_RATE_HZ:g} s apart")


def checked_poses(poses: FloatArray, files: Sequence[Path], names: Sequence[str]) -> FloatArray:
    """Check that poses are rigid, and return them with exact rotations, (N, 4, 4).

    Args:
        poses: (N, 4, 4), ``T_a_b`` of any frames.
        files: file of each pose, N (the same file N times if it contains all poses).
        names: name of the frame of each pose, N, for error messages.

    Raises:
        DataError: a pose is not finite, or not rigid to 1e-3.
    """
    rigid = is_rigid(poses)
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
    _check_reach(poses[:, :3, 3], files, names)
    # Files round rotations to a few digits, but inversion by the transpose requires exact ones.
    return make_pose(nearest_rotation(poses[:, :3, :3]), poses[:, :3, 3])


def read_matrix_pose(path: Path) -> FloatArray:
    """Read a 4x4 matrix from a text file or a NumPy file, without a check that it is rigid.

    Raises:
        DataError: the file is not four rows of four numbers.
    """
    data = read_bytes(path)
    if is_numpy(data):
        matrix = decode_array(data, path)
        if matrix.shape != (4, 4) or matrix.dtype.kind not in "fiu":
            raise DataError(
                path, f"holds {matrix.dtype} of shape {matrix.shape}", "write a 4x4 camera-to-world matrix"
            )
        return matrix.astype(np.float64)
    rows = read_rows(path, 4, "four numbers of a 4x4 camera-to-world matrix")
    if len(rows) != 4:
        raise DataError(path, f"has {len(rows)} rows", "write a 4x4 camera-to-world matrix")
    return rows


def poses_from_quaternions(quaternions_xyzw: FloatArray, translations_m: FloatArray, file: Path) -> FloatArray:
    """Make poses (N, 4, 4) from quaternions (N, 4), order (x, y, z, w), and translations (N, 3) of one file.

    Raises:
        DataError: a row is not finite, or a quaternion does not have unit length.
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
    count = len(translations_m)
    _check_reach(translations_m, [file] * count, [str(row + 1) for row in range(count)])
    return make_pose(quaternion_to_rotation(quaternions_xyzw), translations_m)


def _check_reach(translations_m: FloatArray, files: Sequence[Path], names: Sequence[str]) -> None:
    """Raise DataError unless translations (N, 3) are so near that a map in single precision resolves centimetres."""
    distances_m = np.abs(translations_m).max(axis=1, initial=0.0)
    if not (distances_m <= MAX_DISTANCE_M).all():
        bad = int(np.argmax(distances_m))
        fix = "subtract the same offset from all poses, in metres"
        raise DataError(files[bad], f"the pose of {names[bad]} is {distances_m[bad]:.3g} m from the origin", fix)


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read a TUM trajectory: increasing time stamps (N,) in seconds and poses (N, 4, 4), N >= 1.

    Raises:
        DataError: the file cannot be read, a line is not a pose, or the time stamps do not increase.
    """
    rows = read_rows(path, 8, "t tx ty tz qx qy qz qw")
    check_increasing(rows[:, 0], path)
    return rows[:, 0], poses_from_quaternions(rows[:, 4:], rows[:, 1:4], path)


def read_tum_with_gaps(path: Path, unit_m: float = 1.0) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Read a TUM trajectory of which some lines have a time stamp and no pose (NaN or infinity).

    Args:
        unit_m: of its positions.

    Returns:
        Increasing time stamps (N,) in seconds, whether the pose is known (N,), and the poses (N, 4, 4), the identity
        where unknown.

    Raises:
        DataError: see :func:`read_tum`.
    """
    rows = read_rows(path, 8, "t tx ty tz qx qy qz qw")
    check_increasing(rows[:, 0], path)
    known = np.asarray(np.isfinite(rows[:, 1:]).all(axis=1), dtype=np.bool_)
    rows[~known, 1:] = np.eye(7)[6]
    return rows[:, 0], known, poses_from_quaternions(rows[:, 4:], unit_m * rows[:, 1:4], path)


def check_increasing(times_s: FloatArray, path: Path) -> None:
    """Raise DataError unless the time stamps (N,) are finite, strictly increasing and seconds."""
    is_late = np.abs(times_s) > _LATEST_S
    if is_late.any():
        row = int(np.argmax(is_late))
        problem = f"the time stamp of entry {row + 1} is {times_s[row]:.3g} s"
        raise DataError(path, problem, "write seconds, not milliseconds or nanoseconds")
    increases = np.diff(times_s, prepend=-np.inf) > 0.0
    if not (np.isfinite(times_s).all() and increases.all()):
        row = int(np.argmin(np.isfinite(times_s) & increases)) + 1
        if row > 1 and times_s[row - 1] == times_s[row - 2]:
            problem = f"the time stamp of entry {row} does not increase: it is doubled"
            raise DataError(path, problem, "keep one of the two entries, sorted by time")
        raise DataError(path, f"the time stamp of entry {row} does not increase", "sort the entries by time")


def nearest_times(query_s: FloatArray, times_s: FloatArray) -> NDArray[np.int64]:
    """Index of the nearest entry of the increasing ``times_s`` (N,) for each query (Q,): (Q,)."""
    after = np.searchsorted(times_s, query_s).clip(max=len(times_s) - 1)
    before = (after - 1).clip(min=0)
    return np.where(np.abs(query_s - times_s[before]) < np.abs(times_s[after] - query_s), before, after)


def interpolate_poses(
    query_s: FloatArray, times_s: FloatArray, poses: FloatArray, max_gap_s: float = MAX_POSE_GAP_S
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Poses at other times than they were sampled at.

    Between samples at most ``max_gap_s`` apart, the pose is interpolated on SE(3) with a constant twist; elsewhere it
    is the nearest sample within 20 ms.

    Args:
        query_s: (Q,) seconds.
        times_s: (N,) seconds, increasing, N >= 1.
        poses: (N, 4, 4).
        max_gap_s: seconds.

    Returns:
        Whether the pose is known at each query, (Q,), and the pose (Q, 4, 4), which is arbitrary where it is unknown.
    """
    nearest = nearest_times(query_s, times_s)
    known = np.abs(times_s[nearest] - query_s) <= MAX_POSE_OFFSET_S
    result = poses[nearest]
    if len(times_s) == 1:
        return known, result
    after = np.searchsorted(times_s, query_s).clip(1, len(times_s) - 1)
    start_s, end_s = times_s[after - 1], times_s[after]
    inside = (query_s >= start_s) & (query_s <= end_s) & (end_s - start_s <= max_gap_s)
    fraction = ((query_s - start_s) / (end_s - start_s))[inside, None]
    start = poses[after[inside] - 1]
    step = se3_log(invert(start) @ poses[after[inside]])
    result[inside] = start @ se3_exp(fraction * step)
    return known | inside, result
