"""The table of a recording that was localised in a place: CSV, one row a frame, with the room."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from monoloc.files import write_whole
from monoloc.flight.pose_log import row_in_place
from monoloc.io.pose_table import COLUMNS, ROOM
from monoloc.place.place_localizer import PlaceStep


class PlaceTable:
    """A :mod:`monoloc.io.pose_table` with a column that says in which room's world a pose is.

    Of a frame in no room only time, name, state and reason are known, and the rest of its row is empty.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow((*COLUMNS, ROOM))

    def add(self, time_s: float, name: str, step: PlaceStep) -> None:
        """Take a frame, as :class:`monoloc.place.place_run.PlaceOutput`."""
        self._rows.writerow(row_in_place(time_s, name, step.step, step.room))

    def write(self) -> None:
        """Write the file, whole or not at all.

        Raises:
            DataError: it cannot be written.
        """
        write_whole(self._path, self._text.getvalue().encode())
