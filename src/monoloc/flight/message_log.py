"""What a flight sent to the autopilot, as a telemetry log: each message after its time, 8 bytes in microseconds."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

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
        sink: takes the messages; None only writes them.
    """

    def __init__(self, path: Path, sink: MessageSink | None = None) -> None:
        self._file = path.open("wb")
        self._sink = sink
        self._encoder = dialect().MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
        self._now_s = 0.0

    def send(self, message: Any) -> None:
        data: bytes = message.pack(self._encoder)
        self._encoder.seq = (self._encoder.seq + 1) % 256
        self._file.write(struct.pack(">Q", round(self._now_s * 1e6)) + data)
        self._file.flush()
        if self._sink is not None:
            self._sink.send(message)

    def take(self, result: FlightStep) -> None:
        self._now_s = result.done_s

    def idle(self, now_s: float) -> None:
        self._now_s = now_s

    def close(self) -> None:
        self._file.close()
