"""What a flight sent to the autopilot, as a telemetry log: each message after its time, 8 bytes in microseconds."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path
from typing import Any

from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.pose_sender import MessageSink
from monoloc.mavlink.messages import COMPONENT, dialect


class MessageLog:
    """Writes messages and passes them on.

    It is an output, too, which must come before the one that sends, since it takes the time from the results. The
    messages have numbers of their own, and none of the heartbeats and answers of the link, so that a replay gives the
    same bytes.

    Args:
        path: is replaced.
        sink: takes the messages, also when they can no longer be written; None only writes them.

    Raises:
        DataError: the file cannot be written, at once or, by :meth:`take` and :meth:`idle`, later.
    """

    def __init__(self, path: Path, sink: MessageSink | None = None) -> None:
        self._path, self._sink = path, sink
        self._failure: DataError | None = None
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise self._cannot_be_written(error) from error
        self._encoder = dialect().MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
        self._now_s = 0.0

    def send(self, message: Any) -> None:
        if self._sink is not None:
            self._sink.send(message)
        if self._failure is None:
            try:
                self._write(message)
            except OSError as error:
                self._failure = self._cannot_be_written(error)

    def take(self, result: FlightStep) -> None:
        self.idle(result.done_s)

    def idle(self, now_s: float) -> None:
        self._now_s = now_s
        if self._failure is not None:
            raise self._failure

    def close(self) -> None:
        with contextlib.suppress(OSError):  # only what a write that failed has left is not yet in the file
            self._file.close()

    def _write(self, message: Any) -> None:
        data: bytes = message.pack(self._encoder)
        self._encoder.seq = (self._encoder.seq + 1) % 256
        self._file.write(struct.pack(">Q", round(self._now_s * 1e6)) + data)
        self._file.flush()

    def _cannot_be_written(self, error: OSError) -> DataError:
        return DataError(self._path, f"cannot be written ({error.strerror})", "make room, or choose another disk")
