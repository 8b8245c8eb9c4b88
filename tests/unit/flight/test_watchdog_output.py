"""What systemd hears, through a real socket."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.flight.flight_loop import FlightStep, FlightSummary
from monoloc.flight.watchdog_output import WatchdogOutput


@pytest.fixture
def systemd() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.setblocking(False)
        yield listener


def heard(listener: socket.socket) -> list[bytes]:
    texts = []
    try:
        while True:
            texts.append(listener.recv(100))
    except BlockingIOError:
        return texts


def result(done_s: float) -> FlightStep:
    return result_at(done_s, step_at(np.eye(4)), age_s=0.0)


def test_it_says_ready_at_the_first_frame_watchdog_twice_a_second_and_stopping_at_the_end(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with closing(WatchdogOutput(FlightSummary())) as output:
        output.idle(10.0)  # a camera that gives nothing yet
        assert heard(systemd) == [b"WATCHDOG=1"]
        output.take(result(10.1))
        output.take(result(10.3))
        assert heard(systemd) == [b"READY=1"]
        output.take(result(10.5))
        output.idle(10.7)
        output.idle(11.0)
        assert heard(systemd) == [b"WATCHDOG=1", b"WATCHDOG=1"]
    assert heard(systemd) == [b"STOPPING=1"]


def test_it_says_ready_again_where_the_socket_was_full(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service that does not say it would be restarted, in flight."""
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other, pytest.raises(BlockingIOError):
        other.setblocking(False)
        while True:
            other.sendto(b"other", str(tmp_path / "notify"))
    with closing(WatchdogOutput(FlightSummary())) as output:
        output.take(result(10.0))
        assert set(heard(systemd)) == {b"other"}
        output.take(result(10.1))
        output.take(result(10.2))
        assert heard(systemd) == [b"READY=1"]


def test_it_says_ready_while_a_flight_waits_for_its_marker(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    summary = FlightSummary()
    output = WatchdogOutput(summary)
    output.idle(10.0)
    summary.dropped["without start"] += 1
    output.idle(10.1)
    output.idle(10.2)
    assert heard(systemd) == [b"WATCHDOG=1", b"READY=1"]
    output.close()


def test_an_address_without_a_file(systemd: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    systemd.bind("\0monoloc test @ watchdog")
    monkeypatch.setenv("NOTIFY_SOCKET", "@monoloc test @ watchdog")
    WatchdogOutput(FlightSummary()).idle(0.0)
    assert heard(systemd) == [b"WATCHDOG=1"]


@pytest.mark.parametrize("address", [None, "", "/absent/notify"])
def test_without_systemd_nothing_happens(address: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    if address is not None:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    output = WatchdogOutput(FlightSummary())
    output.take(result(0.0))
    output.close()
    output.close()


def test_a_listener_that_reads_nothing_does_not_hold_the_flight_up(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    systemd.bind(str(tmp_path / "notify"))
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    output = WatchdogOutput(FlightSummary())
    for index in range(5000):
        output.idle(float(index))
    assert 0 < len(heard(systemd)) < 5000
    output.close()
