"""The table of a recording that was localised in a place: CSV, one row a frame, with the room."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from monoloc.files import write_whole
from monoloc.flight.pose_log import row
from monoloc.io.pose_table import COLUMNS, ROOM
from monoloc.place.place_localizer import PlaceStep


class PlaceTable:
    """A :mod:`monoloc.io.pose_table` with a column that says in which room's world a pose is.

    A frame in no room is *lost*, and the rest of its row is empty.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text = io.StringIO()
        self._rows = csv.writer(self._text, lineterminator="\n")
        self._rows.writerow((*COLUMNS, ROOM))

    def add(self, time_s: float, name: str, step: PlaceStep) -> None:
        """Take a frame, as :class:`monoloc.place.place_run.PlaceOutput`."""
        if step.step is None or step.room is None:
            known = (repr(time_s), name, step.state)
            self._rows.writerow((*known, *[""] * (len(COLUMNS) - len(known)), ""))
        else:
            self._rows.writerow((*row(time_s, name, step.step), step.room))

    def write(self) -> None:
        """Write the file, whole or not at all.

        Raises:
            DataError: it cannot be written.
        """
        write_whole(self._path, self._text.getvalue().encode())
