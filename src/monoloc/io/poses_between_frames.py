"""Poses of a recording at other times than those of its frames, as where they are stored late."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.io.pose_files import interpolate_poses

_GAP_FRAMES, _GAP_S = 3.0, 0.5  # between two frames; beyond both, nobody knows what the camera did


def poses_after(
    poses: FloatArray, times_s: FloatArray, rows: NDArray[np.int64], delay_s: float
) -> tuple[NDArray[np.bool_], FloatArray]:
    """The poses that are stored some time after frames, interpolated on SE(3) between those of two frames.

    Args:
        poses: (N, 4, 4), of all frames.
        times_s: (N,) of the frames, increasing.
        rows: (Q,) frames that are asked for.
        delay_s: time after them; negative for before.

    Returns:
        Whether there are poses on both sides, not far apart, (Q,), and the pose (Q, 4, 4), arbitrary where there are
        not.
    """
    return interpolate_poses(times_s[rows] + delay_s, times_s, poses, _longest_step_s(times_s))


def frames_after(
    times_s: FloatArray, rows: NDArray[np.int64], count: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """The frames that come so many after others, without a gap between them.

    Args:
        times_s: (N,) of all frames, increasing.
        rows: (...) frames that are asked for.
        count: of frames after them; negative for before.

    Returns:
        Whether there is such a frame, (...), and its row, (...), arbitrary where there is none.
    """
    is_gap = np.diff(times_s) > _longest_step_s(times_s)
    part = np.concatenate([[0], np.cumsum(is_gap)])  # between gaps
    later = (rows + count).clip(0, len(times_s) - 1)
    return (later == rows + count) & (part[later] == part[rows]), later


def _longest_step_s(times_s: FloatArray) -> float:
    """Between two frames with no gap between them."""
    usual_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
    return max(_GAP_S, _GAP_FRAMES * usual_s)
