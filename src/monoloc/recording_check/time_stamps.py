"""Frame rate, gaps and units of a recording's time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, invert, rotation_angle
from monoloc.io.recording import Recording, selected_from

_GAP_FACTOR, _GAP_S = 3.0, 0.5  # a gap is longer than both: so many frames, and the time that odometry coasts over
_MOST_RATE_HZ, _SLOW_FRAME_S = 1000.0, 4.0  # beyond these, times are not in seconds
_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_RATES_HZ = (1.0, 240.0)  # of cameras
_UNEVEN = 0.1  # relative difference of two rates that is said
_SLOW_M_S, _SLOW_RAD_S = 0.02, 0.05  # slower is no walk and no flight


@dataclass(frozen=True)
class TimeCheck:
    """Time stamps of a recording.

    Attributes:
        frames: number of frames.
        rate_hz: one over the median interval; None of a single frame.
        duration_s: from the first to the last frame.
        gaps_s: intervals that are three times the median and half a second, or longer.
        problem: why the times are not seconds; None if they may be.
        remedy: what to do about it.
        is_certain: whether no camera has such times.
    """

    frames: int
    rate_hz: float | None
    duration_s: float
    gaps_s: list[float]
    problem: str | None = None
    remedy: str = ""
    is_certain: bool = False

    @property
    def rate_words(self) -> str:
        """The rate, and its mean where frames are missing or come unevenly."""
        if self.rate_hz is None:
            return "one frame"
        mean_hz = (self.frames - 1) / self.duration_s
        uneven = f", {mean_hz:.3g} on average" if abs(mean_hz / self.rate_hz - 1.0) > _UNEVEN else ""
        return f"{self.rate_hz:.3g} Hz{uneven}"


def check_times(recording: Recording) -> TimeCheck:
    """Look at the time stamps of the recording, or of the one that its frames are selected from."""
    whole = selected_from(recording)
    times_s = whole.timestamps_s
    if len(times_s) < 2:
        return TimeCheck(len(recording), None, 0.0, [])
    intervals = np.diff(times_s)
    usual = float(np.median(intervals))
    selected = np.diff(recording.timestamps_s)
    between = float(np.median(selected)) if len(selected) else None
    longest = np.inf if between is None else max(_GAP_S, _GAP_FACTOR * between)
    gaps = [float(value) for value in selected if value > longest]
    duration = float(recording.timestamps_s[-1] - recording.timestamps_s[0])
    found = _in_another_unit(usual, times_s, whole.poses)
    rate_hz = None if between is None else 1.0 / between
    return TimeCheck(len(recording), rate_hz, duration, gaps, *(found or ()))


def _in_another_unit(usual_s: float, times_s: FloatArray, poses: FloatArray | None) -> tuple[str, str, bool] | None:
    """Problem, remedy and certainty of times that are no seconds; None if they may be."""
    if 1.0 / usual_s > _MOST_RATE_HZ:
        problem = f"time stamps are {usual_s:.2g} s apart, {1.0 / usual_s:.0f} frames a second: they are not seconds"
        return problem, "write the times in seconds", True
    is_slow = poses is None or _is_slow(times_s, poses)
    if usual_s >= _SLOW_FRAME_S and is_slow:
        for unit, factor in _UNITS.items():
            if _RATES_HZ[0] <= factor / usual_s <= _RATES_HZ[1]:
                problem = f"time stamps are {usual_s:.4g} s apart: they look like {unit}"
                return problem, f"divide them by {factor:.0f}", poses is not None
    if usual_s == 1.0 and np.array_equal(times_s, np.round(times_s)):
        problem = "time stamps are whole numbers, one frame a second: they look like frame numbers"
        return problem, "divide them by the frame rate, unless the camera took one image a second", False
    return None


def _is_slow(times_s: FloatArray, poses: FloatArray) -> bool:
    """Whether the camera hardly moves in a second."""
    relative = invert(poses[:-1]) @ poses[1:]
    elapsed = np.diff(times_s)
    speed = float(np.median(np.linalg.norm(relative[:, :3, 3], axis=1) / elapsed))
    turn = float(np.median(rotation_angle(relative[:, :3, :3]) / elapsed))
    return speed < _SLOW_M_S and turn < _SLOW_RAD_S
