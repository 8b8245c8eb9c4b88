"""The link over UDP, with another program's library at the other end."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from monoloc.errors import SettingError
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.messages import status_text

mavutil = pytest.importorskip("pymavlink.mavutil")
SOON_S = 5.0


class Peer:
    """An autopilot on a UDP port."""

    def __init__(self, port: int = 0) -> None:
        if port == 0:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(("127.0.0.1", 0))
                port = probe.getsockname()[1]
        self.port = port
        mavutil.set_dialect("common")
        self._connection = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=7, source_component=1)
        self.mav = self._connection.mav

    def wait_for(self, kind: str, condition: Callable[[Any], bool] = lambda message: True) -> Any:
        end_s = time.monotonic() + SOON_S
        while time.monotonic() < end_s:
            message = self._connection.recv_match(type=kind, blocking=True, timeout=0.05)
            if message is not None and condition(message):
                return message
        pytest.fail(f"no {kind}")

    def beat(self) -> None:
        self.mav.heartbeat_send(2, 12, 0, 0, 4)

    def close(self) -> None:
        self._connection.close()


@pytest.fixture
def peer() -> Iterator[Peer]:
    made = Peer()
    yield made
    made.close()


@pytest.fixture
def link(peer: Peer) -> Iterator[AutopilotLink]:
    made = AutopilotLink(f"udpout:127.0.0.1:{peer.port}")
    peer.wait_for("HEARTBEAT")
    yield made
    made.close()


def eventually(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + SOON_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def test_heartbeat_is_that_of_a_visual_odometry(peer: Peer, link: AutopilotLink) -> None:
    beat = peer.wait_for("HEARTBEAT")
    assert (beat.get_srcComponent(), beat.autopilot, beat.type) == (197, 8, 18)
    assert not link.is_alive
    peer.beat()
    eventually(lambda: link.is_alive)
    # It is a part of the vehicle that it heard.
    assert peer.wait_for("HEARTBEAT", lambda m: m.get_srcSystem() == 7).get_srcComponent() == 197


def test_timesync_is_answered_with_the_clock_of_the_images(peer: Peer, link: AutopilotLink) -> None:
    before = time.monotonic_ns()
    peer.mav.timesync_send(0, 123456789)
    answer = peer.wait_for("TIMESYNC", lambda message: message.tc1 != 0)
    assert answer.ts1 == 123456789 and before <= answer.tc1 <= time.monotonic_ns()
    # An answer is not answered.
    peer.mav.timesync_send(5, 6)
    peer.mav.timesync_send(0, 42)
    assert peer.wait_for("TIMESYNC", lambda message: message.tc1 != 0).ts1 == 42


def test_attitude_is_that_of_the_time_of_capture(peer: Peer, link: AutopilotLink) -> None:
    """By the autopilot's stamps, whose zero is another."""
    for index in range(10):
        peer.mav.attitude_send(5000 + 20 * index, 0.01 * index, -0.02, 0.5, 0, 0, 0)
        time.sleep(0.02)
    eventually(lambda: link.counts["received"] >= 10)
    newest = link.attitude_at(time.monotonic())
    assert newest is not None and newest.roll_rad == pytest.approx(0.09) and newest.pitch_rad == pytest.approx(-0.02)
    earlier = link.attitude_at(newest.time_s - 0.06)
    assert earlier is not None and earlier.roll_rad == pytest.approx(0.06, abs=0.011)
    assert link.attitude_at(newest.time_s + 0.2) is None and link.attitude_at(newest.time_s - 5.0) is None


def test_parameters_are_asked_for_until_they_come(peer: Peer, link: AutopilotLink) -> None:
    peer.beat()
    eventually(lambda: link.is_alive)
    assert link.read_parameters(("VISO_TYPE",), 0.05) == {}
    asked = peer.wait_for("PARAM_REQUEST_READ")
    assert asked.param_id == "VISO_TYPE" and asked.target_system == 7
    peer.mav.param_value_send(b"VISO_TYPE", 2.0, 9, 1, 0)
    assert link.read_parameters(("VISO_TYPE",), SOON_S) == {"VISO_TYPE": 2.0}


def test_autopilot_that_restarts_is_heard_again(peer: Peer) -> None:
    """And what is sent meanwhile disturbs nothing."""
    link = AutopilotLink(f"udpout:127.0.0.1:{peer.port}")
    try:
        peer.wait_for("HEARTBEAT")
        peer.close()
        for _ in range(20):
            link.send(status_text("nobody hears this", False))
        again = Peer(peer.port)
        try:
            again.wait_for("HEARTBEAT")
            again.beat()
            eventually(lambda: link.is_alive)
            link.send(status_text("hello", True))
            assert again.wait_for("STATUSTEXT", lambda m: m.text == "hello").severity == 4
        finally:
            again.close()
    finally:
        link.close()


def test_what_is_sent_can_be_recorded(peer: Peer) -> None:
    sent: list[tuple[bytes, float]] = []
    link = AutopilotLink(f"udpout:127.0.0.1:{peer.port}", lambda data, time_s: sent.append((data, time_s)))
    link.send(status_text("hello", False))
    link.close()
    assert any(b"hello" in data for data, _ in sent) and all(data[0] == 0xFD for data, _ in sent)  # version 2


@pytest.mark.parametrize("url", ["127.0.0.1:14550", "udp:", "serial:/dev/ttyAMA0", "udpout:host:port"])
def test_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(SettingError, match="write udpout:HOST:PORT"):
        AutopilotLink(url)
