"""Writer of TUM trajectories: one line per pose, ``t tx ty tz qx qy qz qw``, in seconds and metres.

The format comes from the TUM RGB-D benchmark; evo, ROS tools and most SLAM systems support it. Poses are
``T_world_camera``. :func:`monoloc.io.pose_files.read_tum` reads the files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from monoloc.files import write_whole
from monoloc.geometry import is_rigid, rotation_to_quaternion

_COLUMNS = "t tx ty tz qx qy qz qw"


def write_tum(path: str | Path, timestamps_s: ArrayLike, poses: ArrayLike) -> None:
    """Write a trajectory atomically; on failure an existing file is unchanged.

    Args:
        path: the file to write, in an existing folder.
        timestamps_s: (N,) seconds.
        poses: ``T_world_camera``, (N, 4, 4).

    Raises:
        ValueError: shapes do not match, a time stamp is not finite, or a pose is not rigid.
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
