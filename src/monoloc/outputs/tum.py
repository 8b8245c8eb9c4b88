"""Trajectories in the TUM format: one line a pose, ``t tx ty tz qx qy qz qw``, seconds and metres.

The format of the TUM RGB-D benchmark, which evo, ROS tools and most SLAM systems read and write.
Poses are ``T_world_camera``; lines that begin with ``#`` are comments.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.geometry import FloatArray, is_rigid, make_pose, quaternion_to_rotation, rotation_to_quaternion

_COLUMNS = "t tx ty tz qx qy qz qw"
_LINE_FIX = f'each line must hold the 8 numbers "{_COLUMNS}"'

# Files carry at least three decimals; a norm further off than this means columns in another order.
NORM_TOLERANCE = 0.01


def write_tum(path: str | Path, timestamps_s: ArrayLike, poses: ArrayLike) -> None:
    """Write a trajectory; a file of that name is replaced whole, or left as it was if anything fails.

    Args:
        path: the file to write, in a folder that exists.
        timestamps_s: (N,) seconds.
        poses: ``T_world_camera``, (N, 4, 4).

    Raises:
        ValueError: shapes that do not fit, times that are not finite, or poses that are not rigid.
        DataError: the file cannot be written.
    """
    times = np.asarray(timestamps_s, dtype=np.float64)
    T_world_camera = np.asarray(poses, dtype=np.float64)
    if times.ndim != 1:
        raise ValueError(f"timestamps_s must have shape (N,), got {times.shape}")
    if T_world_camera.shape != (len(times), 4, 4):
        raise ValueError(f"poses must have shape ({len(times)}, 4, 4), got {T_world_camera.shape}")
    if not np.isfinite(times).all():
        raise ValueError("timestamps_s must be finite")
    if not np.all(rigid := is_rigid(T_world_camera)):
        raise ValueError(f"poses must be rigid, got another matrix in frame {int(np.argmin(rigid))}")

    quaternions = rotation_to_quaternion(T_world_camera[:, :3, :3])
    rows = np.column_stack([times, T_world_camera[:, :3, 3], quaternions])
    lines = [" ".join(f"{value:.9f}" for value in row) for row in rows]
    write_whole(Path(path), "\n".join([f"# {_COLUMNS}", *lines, ""]).encode())


def read_tum(path: str | Path) -> tuple[FloatArray, FloatArray]:
    """Read a trajectory.

    Returns:
        Times (N,) in seconds and ``T_world_camera`` (N, 4, 4), N >= 1, in the order of the file.

    Raises:
        DataError: no such file, no poses in it, or a line that is not a pose; the message names the line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, f"cannot be read ({_reason(error)})", "give a TUM trajectory file") from error

    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            rows.append(_parse_line(path, number, line.split()))
    if not rows:
        raise DataError(path, "holds no poses", _LINE_FIX)
    table = np.array(rows)
    return table[:, 0], make_pose(quaternion_to_rotation(table[:, 4:]), table[:, 1:4])


def _parse_line(path: Path, number: int, words: list[str]) -> list[float]:
    if len(words) != 8:
        raise DataError(path, f"line {number} has {len(words)} columns", _LINE_FIX)
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise DataError(path, f"line {number} holds something that is not a number", _LINE_FIX) from error
    if not np.isfinite(values).all():
        raise DataError(path, f"line {number} holds NaN or infinity", "leave out frames without a pose")
    norm = float(np.linalg.norm(values[4:]))
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise DataError(path, f"line {number} has a quaternion of length {norm:.3g}", f'columns must be "{_COLUMNS}"')
    return values


def _reason(error: OSError | UnicodeDecodeError) -> str:
    return "not text" if isinstance(error, UnicodeDecodeError) else error.strerror or str(error)
