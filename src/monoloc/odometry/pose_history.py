"""Poses by time stamp: what a frame, at a time of its own, needs of a sensor with another clock rate."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray, invert, is_rigid, made_rigid, rotation_angle, se3_exp, se3_log

_LEAST_JUMP_M, _LEAST_JUMP_RAD = 0.1, 0.05  # stamps of two samples may be nearer than the samples
_MOST_SPANS = 4.0  # of the samples that a velocity is taken from, for which it is taken to last


class PoseHistory:
    """The latest poses of a sensor, interpolated on SE(3) between samples.

    Samples arrive later than the frame that they belong to. So the newest velocity is taken to last for half of
    ``max_gap_s``.

    Args:
        max_gap_s: between samples. A longer one is a dropout, across which nothing is known: the sensor may have
            begun anew in it.
        memory_s: for which samples are kept at least.
        most_speed_m_s, most_turn_rad_s: beyond which a pose has jumped, as when the sensor begins anew or corrects
            itself; nothing before a jump counts.
    """

    def __init__(
        self,
        max_gap_s: float,
        memory_s: float = 60.0,
        most_speed_m_s: float = np.inf,
        most_turn_rad_s: float = np.inf,
    ) -> None:
        if not max_gap_s > 0.0:
            raise ValueError(f"max_gap_s must be positive, got {max_gap_s}")
        self._max_gap_s, self._memory_s = max_gap_s, memory_s
        self._most_speed_m_s, self._most_turn_rad_s = most_speed_m_s, most_turn_rad_s
        self._times_s: list[float] = []
        self._poses: list[FloatArray] = []

    def add(self, time_s: float, pose: ArrayLike) -> None:
        """Take a sample, later than all before.

        Args:
            time_s: when it was measured.
            pose: ``T_reference_sensor``, (4, 4), in a frame of reference that the sensor keeps.

        Raises:
            ValueError: the time is not finite or not after the last one, or the pose is not rigid; nothing has
                changed then.
        """
        if not np.isfinite(time_s):
            raise ValueError(f"the time of a sample must be finite, got {time_s}")
        if self._times_s and time_s <= self._times_s[-1]:
            raise ValueError(f"a sample of {time_s:.6f} s came after one of {self._times_s[-1]:.6f} s")
        sample = np.asarray(pose, dtype=np.float64)
        if sample.shape != (4, 4) or not bool(is_rigid(sample)):
            raise ValueError(f"the pose at {time_s:.6f} s must be rigid, (4, 4)")
        sample = made_rigid(sample)
        if self._times_s and self._has_jumped(time_s, sample):
            self._times_s.clear()
            self._poses.clear()
        self._times_s.append(float(time_s))
        self._poses.append(sample)
        if self._times_s[0] < time_s - 2.0 * self._memory_s:  # seldom, as it copies
            old = bisect_left(self._times_s, time_s - self._memory_s)
            del self._times_s[:old], self._poses[:old]

    @property
    def newest(self) -> tuple[float, FloatArray] | None:
        """Time and pose of the last sample."""
        return (self._times_s[-1], self._poses[-1]) if self._times_s else None

    def _has_jumped(self, time_s: float, pose: FloatArray) -> bool:
        elapsed_s, moved = time_s - self._times_s[-1], invert(self._poses[-1]) @ pose
        distance_m, angle_rad = np.linalg.norm(moved[:3, 3]), rotation_angle(moved[:3, :3])
        is_far = distance_m > _LEAST_JUMP_M + self._most_speed_m_s * elapsed_s
        return bool(is_far or angle_rad > _LEAST_JUMP_RAD + self._most_turn_rad_s * elapsed_s)

    def between(self, start_s: float, end_s: float) -> FloatArray | None:
        """``T_start_end``, (4, 4), of the sensor at two times; None if a sample about or between them is missing.

        Args:
            start_s, end_s: the second not before the first.
        """
        times_s = self._times_s
        if len(times_s) < 2 or not times_s[0] <= start_s <= end_s <= times_s[-1] + 0.5 * self._max_gap_s:
            return None
        # The second of the two samples about a time; where it is that of a sample, no gap beyond it counts.
        after_start = min(bisect_right(times_s, start_s), len(times_s) - 1)
        after_end = min(max(bisect_left(times_s, end_s), 1), len(times_s) - 1)
        first = after_start - 1
        if end_s > times_s[-1]:
            first = min(first, self._before(end_s, after_end))
        if np.diff(times_s[first : after_end + 1]).max(initial=0.0) > self._max_gap_s:
            return None
        return invert(self._at(start_s, after_start)) @ self._at(end_s, after_end)

    def _before(self, time_s: float, after: int) -> int:
        """The first of the samples that give the velocity up to a time; beyond the newest, not one just before it."""
        end_s = self._times_s[after]
        return max(min(bisect_right(self._times_s, end_s - (time_s - end_s) / _MOST_SPANS), after) - 1, 0)

    def _at(self, time_s: float, after: int) -> FloatArray:
        before = self._before(time_s, after)
        start_s, end_s = self._times_s[before], self._times_s[after]
        start, end = self._poses[before], self._poses[after]
        twist = se3_log(invert(start) @ end)
        return np.asarray(start @ se3_exp((time_s - start_s) / (end_s - start_s) * twist))
