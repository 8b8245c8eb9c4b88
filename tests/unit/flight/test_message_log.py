"""Messages on disk: a telemetry log that other programs read, and a full disk that keeps none from the autopilot."""

from __future__ import annotations

import resource
import sys
import threading
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil

from mavlink_helpers import Wire, result_at, step_at
from monoloc.errors import DataError, MissingExtraError
from monoloc.flight.message_log import BackgroundMessageLog, MessageLog
from monoloc.mavlink.messages import status_text
from refusals import refuses


def messages_of(path: Path) -> list[Any]:
    with closing(mavutil.mavlink_connection(str(path))) as read:
        return list(iter(lambda: read.recv_match(blocking=False), None))


def test_pymavlink_reads_the_messages_and_their_times(tmp_path: Path) -> None:
    wire = Wire()
    log = BackgroundMessageLog(tmp_path / "messages.tlog", wire, Counter())
    for index in range(300):  # past the last sequence number
        log.take(result_at(1000.0 + index, step_at(np.eye(4)), age_s=0.25))
        log.send(status_text(f"text {index}", False))
    log.idle(2000.5)
    log.send(status_text("no image", True))
    log.close()
    messages = messages_of(tmp_path / "messages.tlog")
    assert [message.text for message in messages] == [*(f"text {index}" for index in range(300)), "no image"]
    times_s = [message._timestamp for message in messages]
    assert times_s == pytest.approx([*(1000.25 + index for index in range(300)), 2000.5], abs=1e-6)
    assert [message.get_seq() for message in messages[254:258]] == [254, 255, 0, 1]
    assert len(wire.received) == len(messages) == 301


def test_without_pymavlink_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where a flight is replayed on another computer."""
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    refuses(lambda: MessageLog(tmp_path / "messages.tlog"), MissingExtraError, r"MAVLink .* extra \"mavlink\"")


def test_a_full_disk_is_said_once_and_keeps_no_message_from_the_autopilot(tmp_path: Path) -> None:
    wire = Wire()
    direct, background = tmp_path / "a.tlog", tmp_path / "b.tlog"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for log in (MessageLog(direct), BackgroundMessageLog(background, wire, Counter())):
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
        try:
            with pytest.raises(DataError, match=r"[ab]\.tlog: cannot be written \(File too large\); make room"):
                for _ in range(50):
                    log.send(status_text("monoloc: tracking", False))
                    log.take(result_at(1.0, step_at(np.eye(4))))
                log.close()
            log.take(result_at(2.0, step_at(np.eye(4))))
            for _ in range(50):
                log.send(status_text("monoloc: lost", True))
            log.close()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert sum(message.text == "monoloc: lost" for message in wire.received) == 50
    assert direct.stat().st_size == background.stat().st_size == 500
    with pytest.raises(DataError, match=r"cannot be written \(Is a directory\)"):
        MessageLog(tmp_path)


def test_a_failure_after_the_last_frame_is_said_when_the_flight_closes(tmp_path: Path) -> None:
    log = MessageLog(Path("/dev/full"))  # every write to it finds no space
    log.send(status_text("monoloc: lost", True))
    with pytest.raises(DataError, match="cannot be written"):
        log.close()
    log.close()


def test_a_disk_that_stands_still_delays_no_message_and_what_is_left_out_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, goes_on = threading.Event(), threading.Event()
    write = BackgroundMessageLog._write

    def stalled(self: BackgroundMessageLog, data: bytes) -> None:
        begun.set()
        assert goes_on.wait(30.0)
        write(self, data)

    monkeypatch.setattr(BackgroundMessageLog, "_write", stalled)
    monkeypatch.setattr("monoloc.flight.message_log._MOST_MESSAGES", 5)
    wire, dropped = Wire(), Counter[str]()
    path = tmp_path / "messages.tlog"
    log = BackgroundMessageLog(path, wire, dropped)
    log.send(status_text("text 0", False))
    assert begun.wait(30.0)
    for index in range(1, 20):
        log.send(status_text(f"text {index}", False))
    assert len(wire.received) == 20 and dropped == {"messages": 14} and path.stat().st_size == 0
    goes_on.set()
    log.close()
    assert [message.text for message in messages_of(path)] == [f"text {index}" for index in range(6)]
