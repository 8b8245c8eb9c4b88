"""Rows of tables of poses, see :mod:`monoloc.io.pose_table`, and tables that are written at the end."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from monoloc.files import write_whole
from monoloc.geometry import FloatArray, rotation_to_quaternion
from monoloc.io.pose_table import COLUMNS, UPPER
from monoloc.step import Step
from monoloc.supervision.state import Reason


class WholeTable:
    """Keeps the rows of a table until they are written."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._path = path
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow(columns)

    def take(self, values: Sequence[str]) -> None:
        """Take a row."""
        self._rows.writerow(values)

    def write(self) -> None:
        """Write the file, whole or not at all.

        Raises:
            DataError: it cannot be written.
        """
        write_whole(self._path, self._text.getvalue().encode())


def row(time_s: float, frame: str, step: Step) -> tuple[str, ...]:
    """The texts of a row of :data:`monoloc.io.pose_table.COLUMNS`. Numbers are read as the same bits.

    Args:
        time_s: of capture.
        frame: its name.
        step: the localizer's result.
    """
    pose: FloatArray = step.estimate.pose
    numbers = [*pose[:3, 3], *rotation_to_quaternion(pose[:3, :3]), *step.estimate.covariance[UPPER]]
    reasons = ";".join(sorted(reason.value for reason in step.reasons))
    state = (repr(time_s), frame, step.state, reasons, repr(step.probability_far), str(int(step.restarted)))
    return (*state, str(int(step.level)), *(repr(float(number)) for number in numbers))


def row_in_place(time_s: float, frame: str, step: Step | None, room: str | None) -> tuple[str, ...]:
    """The texts of a row whose last column is the room; arguments as :func:`row`.

    Without a room the place is searched: the frame is *lost*, and only time, name, state and reason are known.
    """
    if step is None or room is None:
        known = (repr(time_s), frame, "lost", Reason.SEARCHING.value)
        return (*known, *[""] * (len(COLUMNS) - len(known)), "")
    return (*row(time_s, frame, step), room)
