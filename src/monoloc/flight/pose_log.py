"""A table of poses with what is known of each: CSV, one row a frame, written as it comes."""

from __future__ import annotations

import contextlib
import csv
from pathlib import Path

import numpy as np

from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightStep
from monoloc.geometry import FloatArray, rotation_to_quaternion
from monoloc.localizer import Step

_UPPER = np.triu_indices(6)
_POSE = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
_AXES = ("x", "y", "z", "rx", "ry", "rz")
COLUMNS = (
    "time_s",
    "state",
    "reasons",
    "probability_far",
    "restarted",
    *_POSE,
    *(f"cov_{_AXES[row]}_{_AXES[column]}" for row, column in zip(*_UPPER, strict=True)),
)
"""``T_world_camera``, and the upper triangle of its covariance: of position in the camera's axes (m) and of the
rotation vector (rad), see :class:`monoloc.particle_filter.estimate.Estimate`. Semicolons separate reasons."""


class PoseLog:
    """Writes the table, as a :class:`~monoloc.flight.flight_loop.FlightOutput`; each row at once.

    Args:
        path: is replaced.

    Raises:
        DataError: it cannot be written, at once or later.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("w", encoding="utf-8", newline="")
        except OSError as error:
            fix = "name a file in a folder you can write to"
            raise DataError(path, f"cannot be written ({error.strerror})", fix) from error
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._write(COLUMNS)

    def take(self, result: FlightStep) -> None:
        """Add the frame of a flight."""
        self.add(result.frame.captured_s, result.step)

    def add(self, time_s: float, step: Step) -> None:
        """Add a frame: a lost one too, whose pose says nothing."""
        self._write(row(time_s, step))

    def idle(self, now_s: float) -> None:
        """Nothing: the table has a row a frame."""

    def _write(self, values: tuple[str, ...]) -> None:
        try:
            self._rows.writerow(values)
            self._file.flush()
        except OSError as error:
            fix = "make room, or choose another disk"
            raise DataError(self._path, f"cannot be written ({error.strerror})", fix) from error

    def close(self) -> None:
        with contextlib.suppress(OSError):  # only what a write that failed has left is not yet in the file
            self._file.close()


def row(time_s: float, step: Step) -> tuple[str, ...]:
    """The texts of a row. Numbers are written so that reading gives the same bits."""
    pose: FloatArray = step.estimate.pose
    numbers = [*pose[:3, 3], *rotation_to_quaternion(pose[:3, :3]), *step.estimate.covariance[_UPPER]]
    reasons = ";".join(sorted(reason.value for reason in step.reasons))
    state = (repr(time_s), step.state, reasons, repr(step.probability_far), str(int(step.restarted)))
    return (*state, *(repr(float(number)) for number in numbers))
