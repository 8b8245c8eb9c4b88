"""Lines for a person, written by a thread: nobody who hands one over waits for a pipe that is full."""

from __future__ import annotations

import os
import queue
import select
import threading

_MOST_QUEUED = 100  # lines; more are dropped
_CLOSE_S = 0.5  # for which the last lines may take


class LineWriter:
    """Writes lines to a file, a terminal or a pipe that nobody may read.

    The thread writes to the descriptor itself. Through Python's own streams, a write that hangs would hang the end of
    the program too.

    Args:
        descriptor: number of an open file.

    Attributes:
        dropped: number of lines that were not written: too many waited, or the other side is gone.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.dropped = 0
        self._queue: queue.Queue[str | None] = queue.Queue(_MOST_QUEUED)
        self._is_gone = False
        self._thread = threading.Thread(target=self._run, name="lines", daemon=True)
        self._thread.start()

    def write(self, line: str) -> None:
        """Hand over a line, without its end."""
        try:
            self._queue.put_nowait(line)
        except queue.Full:
            self.dropped += 1

    def close(self) -> None:
        """Wait half a second for the lines that are not written yet; more is lost with the program's end."""
        try:
            self._queue.put(None, timeout=_CLOSE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        said = 0
        while (line := self._queue.get()) is not None:
            if self.dropped > said and not self._is_gone:
                said = self.dropped
                self._write(f"({said} lines were not written: nobody read them)")
            self._write(line)

    def _write(self, line: str) -> None:
        data = line.encode("utf-8", "replace") + b"\n"
        try:
            while data and not self._is_gone:
                try:
                    data = data[os.write(self._descriptor, data) :]
                except BlockingIOError:  # full, and does not wait: another program that shares it may have set that
                    select.select([], [self._descriptor], [])
        except OSError:  # a terminal that hung up, a pipe that was closed
            self._is_gone = True
        self.dropped += self._is_gone
