"""What a flight sent to the autopilot, as a telemetry log: each message after its time, 8 bytes in microseconds."""

from __future__ import annotations

import contextlib
import struct
from collections import Counter
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.extras import require_extra
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.pose_sender import MessageSink
from monoloc.flight.writer_thread import WriterThread
from monoloc.mavlink.messages import COMPONENT, dialect, microseconds

_MOST_MESSAGES = 10_000  # that wait for the disk, 3 MB, 100 s of flight; more are dropped


class MessageLog:
    """Writes messages; a sink.

    It is an output, too, which must come before the one that sends, since it takes the time from the results. The
    messages have numbers of their own, and none of the heartbeats and answers of the link, so that a replay gives the
    same bytes.

    Args:
        path: is replaced.

    Raises:
        DataError: the file cannot be written, at once or, by :meth:`take` and :meth:`idle`, later.
        MissingExtraError: pymavlink is not installed.
    """

    def __init__(self, path: Path) -> None:
        require_extra("mavlink")
        self._path = path
        self._failure: DataError | None = None
        self._is_said = False  # to the flight, that it failed
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise self._cannot_be_written(error) from error
        self._encoder = dialect().MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
        self._now_s = 0.0

    def send(self, message: Any) -> None:
        data: bytes = message.pack(self._encoder)
        self._encoder.seq = (self._encoder.seq + 1) % 256
        if self._failure is None:
            try:
                self._hand_over(struct.pack(">Q", microseconds(self._now_s)) + data)
            except DataError as error:
                self._failure = error

    def take(self, result: FlightStep) -> None:
        self.idle(result.done_s)

    def idle(self, now_s: float) -> None:
        self._now_s = now_s
        self._say_failure()

    def close(self) -> None:
        """Raises DataError if the file could not be written, and :meth:`take` did not say so."""
        with contextlib.suppress(OSError):  # only what a write that failed has left is not yet in the file
            self._file.close()
        self._say_failure()

    def _hand_over(self, data: bytes) -> None:
        self._write(data)

    def _write(self, data: bytes) -> None:
        try:
            self._file.write(data)
            self._file.flush()
        except OSError as error:
            raise self._cannot_be_written(error) from error

    def _say_failure(self) -> None:
        if self._failure is not None and not self._is_said:
            self._is_said = True
            raise self._failure

    def _cannot_be_written(self, error: OSError) -> DataError:
        return DataError(self._path, f"cannot be written ({error.strerror})", "make room, or choose another disk")


class BackgroundMessageLog(MessageLog):
    """A :class:`MessageLog` on the way to an autopilot, whose file a thread writes: no message waits for the disk.

    Args:
        path: is replaced.
        sink: takes the messages, also when they can no longer be written.
        dropped: counts messages that were sent but not written, since too many waited.

    Raises:
        DataError: as :class:`MessageLog`.
    """

    def __init__(self, path: Path, sink: MessageSink, dropped: Counter[str]) -> None:
        super().__init__(path)
        self._sink, self._dropped = sink, dropped
        self._thread = WriterThread("messages", self._write, _MOST_MESSAGES)

    def send(self, message: Any) -> None:
        self._sink.send(message)
        super().send(message)

    def close(self) -> None:
        self._thread.close(super().close)

    def _hand_over(self, data: bytes) -> None:
        if not self._thread.put(data):
            self._dropped["messages"] += 1
