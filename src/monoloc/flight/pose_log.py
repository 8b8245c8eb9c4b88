"""A table of poses with what is known of each: CSV, one row a frame, written as it comes."""

from __future__ import annotations

import contextlib
import csv
import io
from collections import Counter
from pathlib import Path

from monoloc.errors import DataError
from monoloc.flight.earlier_flight import keep_earlier
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.writer_thread import WriterThread
from monoloc.io.pose_table import COLUMNS, ROOM
from monoloc.pose_rows import row, row_in_place

_MOST_ROWS = 10_000  # that wait for the disk, 6 MB; more are dropped


class PoseLog:
    """Writes the table, as a :class:`~monoloc.flight.flight_loop.FlightOutput`; each row at once, and whole.

    Frames are named by their number among the localised ones, six digits, as are the images of a recorded flight.

    Args:
        path: is written with the first row, not before. What was there is then kept, see
            :mod:`monoloc.flight.earlier_flight`; a flight without a frame leaves it in its place.
        has_rooms: whether the flight is in a place, so that a last column says in which room's world a pose is.

    Raises:
        DataError: it cannot be written, at once or later.
    """

    def __init__(self, path: Path, has_rooms: bool = False) -> None:
        self._path, self._has_rooms = path, has_rooms
        self._file = self._opened()
        self._size = self._count = 0  # bytes of whole rows, and frames

    def take(self, result: FlightStep) -> None:
        """Add a frame: a lost one too, whose pose says nothing."""
        self._write(self._next_row(result))

    def idle(self, now_s: float) -> None:
        """Nothing: the table has a row a frame."""

    def _next_row(self, result: FlightStep) -> tuple[str, ...]:
        self._count += 1
        time_s, name = result.frame.captured_s, f"{self._count - 1:06d}"
        if self._has_rooms:
            return row_in_place(time_s, name, result.step, result.room)
        return row(time_s, name, result.step)

    def _write(self, values: tuple[str, ...]) -> None:
        if self._size == 0:
            self._begin()
        self._write_row(values)

    def _begin(self) -> None:
        if keep_earlier(self._path):
            self._file.close()
            self._file = self._opened()
        self._write_row((*COLUMNS, ROOM) if self._has_rooms else COLUMNS)

    def _opened(self) -> io.FileIO:
        try:
            return self._path.open("ab", buffering=0)  # a buffer would keep the rest of a row for later
        except OSError as error:
            fix = "name a file in a folder you can write to"
            raise DataError(self._path, f"cannot be written ({error.strerror})", fix) from error

    def _write_row(self, values: tuple[str, ...]) -> None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(values)
        content = left = text.getvalue().encode()
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            with contextlib.suppress(OSError):  # what a full disk took of the row, others would read as a pose
                self._file.truncate(self._file.seek(self._size))
            fix = "make room, or choose another disk"
            raise DataError(self._path, f"cannot be written ({error.strerror})", fix) from error
        self._size += len(content)

    def close(self) -> None:
        with contextlib.suppress(OSError):  # every row was taken, or its failure was said
            self._file.close()


class BackgroundPoseLog(PoseLog):
    """A :class:`PoseLog` whose rows a thread writes, so that the flight does not wait for the disk.

    Args:
        path, has_rooms: as :class:`PoseLog`.
        dropped: counts rows that were not written since too many waited.

    Raises:
        DataError: it cannot be written, at once, later, or by :meth:`close`.
    """

    def __init__(self, path: Path, dropped: Counter[str], has_rooms: bool = False) -> None:
        super().__init__(path, has_rooms)
        self._dropped = dropped
        self._thread = WriterThread("poses", self._write, _MOST_ROWS)

    def take(self, result: FlightStep) -> None:
        if not self._thread.put(self._next_row(result)):
            self._dropped["poses"] += 1

    def close(self) -> None:
        self._thread.close(super().close)
