"""The table of a recording that was localised in a place: CSV, one row a frame, with the room."""

from __future__ import annotations

from pathlib import Path

from monoloc.io.pose_table import COLUMNS, ROOM
from monoloc.place.place_localizer import PlaceStep
from monoloc.pose_rows import WholeTable, row_in_place


class PlaceTable(WholeTable):
    """A :mod:`monoloc.io.pose_table` with a column that says in which room's world a pose is.

    Of a frame in no room only time, name, state and reason are known, and the rest of its row is empty.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, (*COLUMNS, ROOM))

    def add(self, time_s: float, name: str, step: PlaceStep) -> None:
        """Take a frame: its time, its name in the recording, and the result."""
        self.take(row_in_place(time_s, name, step.step, step.room))
