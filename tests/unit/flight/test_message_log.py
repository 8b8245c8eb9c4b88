"""Messages on disk: a telemetry log that other programs read, and a full disk that keeps none from the autopilot."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from mavlink_helpers import Wire, result_at, step_at
from monoloc.errors import DataError
from monoloc.flight.message_log import MessageLog
from monoloc.mavlink.messages import status_text


def test_pymavlink_reads_the_messages_and_their_times(tmp_path: Path) -> None:
    wire = Wire()
    log = MessageLog(tmp_path / "messages.tlog", wire)
    for index in range(300):  # past the last sequence number
        log.take(result_at(1000.0 + index, step_at(np.eye(4)), age_s=0.25))
        log.send(status_text(f"text {index}", False))
    log.idle(2000.5)
    log.send(status_text("no image", True))
    log.close()
    read = mavutil.mavlink_connection(str(tmp_path / "messages.tlog"))
    messages = [read.recv_match(blocking=False) for _ in range(301)]
    assert [message.text for message in messages] == [*(f"text {index}" for index in range(300)), "no image"]
    times_s = [message._timestamp for message in messages]
    assert times_s == pytest.approx([*(1000.25 + index for index in range(300)), 2000.5], abs=1e-6)
    assert [message.get_seq() for message in messages[254:258]] == [254, 255, 0, 1]
    assert len(wire.received) == 301 and read.recv_match(blocking=False) is None


def test_a_full_disk_is_said_by_the_log_and_keeps_no_message_from_the_autopilot(tmp_path: Path) -> None:
    wire = Wire()
    log = MessageLog(tmp_path / "messages.tlog", wire)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        for _ in range(50):
            log.send(status_text("monoloc: tracking", False))
        with pytest.raises(DataError, match=r"messages\.tlog: cannot be written \(File too large\); make room"):
            log.take(result_at(1.0, step_at(np.eye(4))))
        log.send(status_text("monoloc: lost", True))
        log.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(wire.received) == 51
    with pytest.raises(DataError, match=r"cannot be written \(Is a directory\)"):
        MessageLog(tmp_path)
