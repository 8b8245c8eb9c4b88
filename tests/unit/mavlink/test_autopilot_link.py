"""The link over UDP, with another program's library at the other end."""

from __future__ import annotations

import os
import random
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from monoloc.errors import DataError, SettingError
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import so3_log
from monoloc.mavlink import autopilot_link
from monoloc.mavlink.autopilot_frames import rotation_of
from monoloc.mavlink.autopilot_link import Attitude, AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.link_port import _SerialPort
from monoloc.mavlink.messages import dialect, heartbeat, obstacle_distance, status_text

mavutil = pytest.importorskip("pymavlink.mavutil")
SOON_S = 5.0
LONG_BAUD = "serial:/dev/ttyAMA0:" + "9" * 5000


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

    def write(self, data: bytes) -> None:
        self._connection.write(data)

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


def newest_attitude(link: AutopilotLink) -> Attitude:
    return link._attitudes[-1]


def test_heartbeat_is_that_of_a_visual_odometry(peer: Peer, link: AutopilotLink) -> None:
    assert not link.is_alive
    peer.beat()
    eventually(lambda: link.is_alive)
    beat = peer.wait_for("HEARTBEAT", lambda message: message.get_srcSystem() == 7)  # a part of the vehicle
    assert (beat.get_srcComponent(), beat.autopilot, beat.type) == (197, 8, 18)


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
    """By the autopilot's stamps, whose zero is another. A message that comes faster than any before moves it."""
    peer.beat()
    for index in range(10):
        peer.mav.attitude_send(5000 + 20 * index, 0.01 * index, -0.02, 0.5, 0, 0, 0)
        time.sleep(0.02)
    eventually(lambda: link.counts["received"] > 10)
    assert link.attitude_hz == pytest.approx(50.0, rel=0.05)  # by the stamps
    newest = newest_attitude(link)
    assert newest.roll_rad == pytest.approx(0.09) and newest.pitch_rad == pytest.approx(-0.02)
    between = link.attitude_at(newest.time_s - 0.07)
    assert between is not None and between.roll_rad == pytest.approx(0.055, abs=0.002)  # by the stamps, 20 ms apart
    # The next one may not have come; the vehicle turns on, but not for long.
    for since_s, roll_rad in ((0.0, 0.09), (0.03, 0.105), (0.06, 0.12), (0.09, 0.12)):
        later = link.attitude_at(newest.time_s + since_s)
        assert later is not None and later.roll_rad == pytest.approx(roll_rad, abs=0.002)
    assert link.attitude_at(newest.time_s + 0.11) is None and link.attitude_at(newest.time_s - 5.0) is None


def test_attitude_between_two_headings_does_not_go_round(peer: Peer, link: AutopilotLink) -> None:
    peer.beat()
    times_s = []
    for index, yaw_rad in enumerate((3.1, -3.1)):
        peer.mav.attitude_send(5000 + 100 * index, 0.0, 0.0, yaw_rad, 0, 0, 0)
        time.sleep(0.1)
        eventually(lambda: link.counts["received"] > 1 + len(times_s))
        times_s.append(newest_attitude(link).time_s)
    between = link.attitude_at(float(np.mean(times_s)))  # a faster message moves the clocks by microseconds
    assert between is not None and abs(between.yaw_rad) == pytest.approx(np.pi, abs=1e-6)


def test_attitude_across_a_dropout_is_not_made_up(peer: Peer, link: AutopilotLink) -> None:
    peer.beat()
    for index in range(2):
        peer.mav.attitude_send(5000 + 300 * index, 0.1 * index, 0.0, 0.0, 0, 0, 0)
        time.sleep(0.3)
    eventually(lambda: link.counts["received"] > 2)
    newest = newest_attitude(link)
    assert link.attitude_at(newest.time_s - 0.15) is None
    assert link.attitude_at(newest.time_s - 0.01) == newest
    assert link.attitude_at(newest.time_s + 0.05) == newest


def test_turn_is_that_of_the_camera_between_two_times_of_capture(peer: Peer) -> None:
    """Half a radian a second to the right, which a camera that looks forward sees about its axis down."""
    made = AutopilotLink(f"udpout:127.0.0.1:{peer.port}", R_body_camera=Mount().T_body_camera[:3, :3])
    with closing(made):
        peer.wait_for("HEARTBEAT")
        peer.beat()
        for index in range(10):
            peer.mav.attitude_send(5000 + 20 * index, 0.3, -0.2, 3.1 + 0.01 * index, 0, 0, 0)
            time.sleep(0.02)
        eventually(lambda: made.counts["received"] > 10)
        newest = newest_attitude(made)
        turn = made.turn_between(newest.time_s - 0.11, newest.time_s - 0.01)
        assert turn is not None and turn.translation == "unknown"
        R_ned_body = rotation_of(0.3, -0.2, 0.0)
        down_camera = Mount().T_body_camera[:3, :3].T @ R_ned_body.T @ [0.0, 0.0, 1.0]
        rotation = so3_log(turn.T_previous_current[:3, :3])
        angle = np.linalg.norm(rotation)
        assert angle == pytest.approx(0.05, abs=0.015)  # the clock of arrivals varies by milliseconds
        np.testing.assert_allclose(rotation / angle, down_camera, atol=1e-6)
        assert made.turn_between(newest.time_s - 0.5, newest.time_s) is None
        assert made.turn_between(newest.time_s, newest.time_s + 0.2) is None


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


def test_messages_are_of_version_2(peer: Peer, link: AutopilotLink) -> None:
    link.send(status_text("hello", False))
    for kind in ("STATUSTEXT", "HEARTBEAT"):
        assert peer.wait_for(kind).get_msgbuf()[0] == 0xFD


@pytest.mark.parametrize("value", [11, -1, 2_000_000_000])
def test_whole_numbers_of_px4_come_as_their_bytes(peer: Peer, link: AutopilotLink, value: int) -> None:
    peer.beat()
    eventually(lambda: link.is_alive)
    (as_float,) = struct.unpack("<f", struct.pack("<i", value))
    peer.mav.param_value_send(b"EKF2_EV_CTRL", as_float, 6, 1, 0)
    eventually(lambda: "EKF2_EV_CTRL" in link.parameters)
    assert link.parameters["EKF2_EV_CTRL"] == value


def test_attitude_that_is_no_number_or_of_another_is_ignored(peer: Peer, link: AutopilotLink) -> None:
    peer.beat()
    eventually(lambda: link.is_alive)
    received = link.counts["received"]
    peer.mav.attitude_send(5000, float("nan"), 0.0, 0.0, 0, 0, 0)
    peer.mav.srcComponent = 154  # a gimbal
    peer.mav.attitude_send(5000, 0.5, 0.0, 0.0, 0, 0, 0)
    eventually(lambda: link.counts["received"] >= received + 2)
    assert link.attitude_at(time.monotonic()) is None


def test_nothing_of_a_vehicle_is_believed_before_an_autopilot_is_heard(peer: Peer, link: AutopilotLink) -> None:
    """It may be another's, whose attitude would turn this one's gravity."""
    peer.mav.srcSystem = 8
    received = link.counts["received"]
    peer.mav.attitude_send(5000, 0.5, 0.0, 0.0, 0, 0, 0)
    peer.mav.param_value_send(b"EKF2_EV_CTRL", 11.0, 9, 1, 0)
    eventually(lambda: link.counts["received"] >= received + 2)
    peer.mav.srcSystem = 7
    peer.beat()
    eventually(lambda: link.is_alive)
    assert link.attitude_at(time.monotonic()) is None and not link.parameters


def test_another_vehicle_on_the_network_is_not_listened_to(
    peer: Peer, link: AutopilotLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even while the first is silent, as when its autopilot starts anew."""
    peer.beat()
    eventually(lambda: link.is_alive)
    peer.mav.srcSystem = 8
    received = link.counts["received"]
    peer.beat()
    peer.mav.attitude_send(5000, 0.5, 0.0, 0.0, 0, 0, 0)
    eventually(lambda: link.counts["received"] >= received + 2)
    assert link.attitude_at(time.monotonic()) is None
    link.send(status_text("whose part?", False))
    assert peer.wait_for("STATUSTEXT").get_srcSystem() == 7
    monkeypatch.setattr(autopilot_link, "_ALIVE_S", 0.0)
    peer.beat()
    peer.mav.attitude_send(5020, 0.5, 0.0, 0.0, 0, 0, 0)
    eventually(lambda: link.counts["received"] >= received + 4)
    assert link.attitude_hz == 0.0 and not link.is_alive
    assert (link.system, link.others) == (7, frozenset({8}))


def test_another_part_of_the_vehicle_that_was_heard_first_gives_way_to_the_autopilot(
    peer: Peer, link: AutopilotLink
) -> None:
    peer.mav.srcComponent = 2
    peer.mav.heartbeat_send(2, 0, 0, 0, 4)
    eventually(lambda: link.is_alive)
    peer.mav.srcComponent = 1
    peer.mav.heartbeat_send(2, 12, 0, 0, 4)
    eventually(lambda: link.firmware is Firmware.PX4)
    assert link.others == frozenset()
    received = link.counts["received"]
    peer.mav.srcComponent = 2  # it does not take over again
    peer.mav.heartbeat_send(2, 3, 0, 0, 4)
    eventually(lambda: link.counts["received"] > received)
    assert link.firmware is Firmware.PX4 and link.others == frozenset()


def test_firmware_is_that_of_the_heartbeat(peer: Peer, link: AutopilotLink) -> None:
    assert link.firmware is None
    peer.mav.heartbeat_send(2, 3, 0, 0, 4)  # ArduPilot
    eventually(lambda: link.firmware is Firmware.ARDUPILOT)
    peer.mav.heartbeat_send(2, 12, 0, 0, 4)
    eventually(lambda: link.firmware is Firmware.PX4)
    peer.mav.heartbeat_send(2, 0, 0, 0, 4)  # a generic one
    eventually(lambda: link.firmware is None)


def test_round_trip_is_measured_by_a_question_of_its_own(peer: Peer, link: AutopilotLink) -> None:
    peer.beat()
    question = peer.wait_for("TIMESYNC", lambda message: message.tc1 == 0)
    peer.mav.timesync_send(99, question.ts1 + 1)  # an answer to another's
    peer.mav.timesync_send(99, question.ts1)
    eventually(lambda: link.round_trip_s is not None)
    assert link.round_trip_s is not None and 0.0 < link.round_trip_s < SOON_S


def test_any_bytes_are_survived(peer: Peer, link: AutopilotLink) -> None:
    """Noise, and frames of every message with right checksums and random contents."""
    from fastcrc.crc16 import mcrf4xx

    rng = random.Random(0)
    for number, message in dialect().mavlink_map.items():
        payload = rng.randbytes(rng.randrange(1, 256))
        head = struct.pack("<6BHB", len(payload), 0, 0, 0, 7, 1, number & 0xFFFF, number >> 16)
        checksum = struct.pack("<H", mcrf4xx(head + payload + bytes([message.crc_extra])))
        peer.write(b"\xfd" + head + payload + checksum)
        peer.write(rng.randbytes(40))
    link.send(status_text("still here", False))
    peer.wait_for("STATUSTEXT", lambda m: m.text == "still here")

    def hears_again() -> bool:
        peer.beat()  # the first ones may end a frame that noise began
        return link.is_alive and link.counts["damaged"] > 0

    eventually(hears_again)


def test_tcp_server_that_restarts_is_connected_to_again() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    address = server.getsockname()
    link = AutopilotLink(f"tcp:127.0.0.1:{address[1]}")
    try:
        connection, _ = server.accept()
        assert connection.recv(1) == b"\xfd"
        server.close()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # frees the port
        connection.close()
        server = socket.create_server(address)
        server.settimeout(SOON_S)
        connection, _ = server.accept()
        connection.settimeout(SOON_S)
        assert connection.recv(1) == b"\xfd"
        assert link.counts["reconnections"] == 1
        connection.close()
    finally:
        link.close()
        server.close()


def test_serial_port_is_read_and_written_and_found_gone() -> None:
    controller, device = os.openpty()
    name = os.ttyname(device)
    link = AutopilotLink(f"serial:{name}:57600")
    parser = dialect().MAVLink(None)
    try:
        data = b""
        while b"hello" not in data:
            link.send(status_text("hello", False))
            assert select.select([controller], [], [], SOON_S)[0]
            data = os.read(controller, 4096)
        assert any(message.get_type() == "STATUSTEXT" for message in parser.parse_buffer(data))
        os.write(controller, bytes(40))  # as at a wrong baud rate
        eventually(lambda: link.hears_noise)
        os.write(
            controller, dialect().MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(dialect().MAVLink(None, 1, 1))
        )
        eventually(lambda: link.is_alive)
        assert not link.hears_noise
        os.close(device)
        os.close(controller)
        eventually(lambda: not link.is_open)
        link.send(status_text("nobody hears this", False))
    finally:
        link.close()


def test_pose_that_a_slow_serial_port_would_send_late_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    controller, device = os.openpty()
    is_full = threading.Event()
    monkeypatch.setattr(_SerialPort, "is_full", property(lambda port: is_full.is_set()))
    link = AutopilotLink(f"serial:{os.ttyname(device)}:57600")
    try:
        is_full.set()
        eventually(lambda: link.queued == 0 or link.counts["sent"] > 0)
        before = link.counts["dropped"]
        link.send(obstacle_distance(1.0, np.zeros(72, np.uint16), 0.2, 8.0))
        eventually(lambda: link.counts["dropped"] > before and link.queued == 0)
        is_full.clear()
        link.send(status_text("on the line", False))
        data = b""
        while b"on the line" not in data:
            assert select.select([controller], [], [], SOON_S)[0]
            data += os.read(controller, 4096)
        kinds = {message.get_type() for message in dialect().MAVLink(None).parse_buffer(data) or []}
        assert "STATUSTEXT" in kinds and "OBSTACLE_DISTANCE" not in kinds
    finally:
        link.close()
        os.close(device)
        os.close(controller)


def test_udp_server_sends_to_who_was_heard() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = AutopilotLink(f"udpin:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(SOON_S)
        client.sendto(b"\0", ("127.0.0.1", port))
        assert client.recv(300)[0] == 0xFD
    assert link.counts["damaged"] > 0 and not link.hears_noise  # UDP has no baud rate
    link.close()


def test_ground_station_that_comes_late_reads_the_last_text_and_no_old_heartbeats() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = AutopilotLink(f"udpin:127.0.0.1:{port}")
    link.send(status_text("lost", True))
    for _ in range(3):  # minutes, in which nobody is there
        for _ in range(60):
            link.send(heartbeat())
        eventually(lambda: link.queued <= 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(SOON_S)
        client.sendto(b"\0", ("127.0.0.1", port))
        parser = dialect().MAVLink(None)
        kinds: list[str] = []
        while "STATUSTEXT" not in kinds:
            kinds += [message.get_type() for message in parser.parse_buffer(client.recv(300))]
    link.close()
    assert kinds.count("HEARTBEAT") <= 2


def test_port_that_takes_nothing_makes_nobody_wait_and_gets_no_old_distances() -> None:
    """A TCP peer that does not read; when it does, texts come, and what went stale does not."""
    server = socket.create_server(("127.0.0.1", 0))
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link = AutopilotLink(f"tcp:127.0.0.1:{server.getsockname()[1]}")
    try:
        connection, _ = server.accept()
        stale = obstacle_distance(1.0, np.full(72, 100, dtype=np.uint16), 0.3, 5.0)
        began_s, sent = time.monotonic(), -1
        while link.counts["sent"] != sent:  # until all buffers between are full
            sent = link.counts["sent"]
            for _ in range(500):
                link.send(stale)
                if link.queued > 90:
                    time.sleep(0.001)
            time.sleep(0.02)
            assert time.monotonic() - began_s < SOON_S
        link.send(status_text("read this", True))
        eventually(lambda: link.queued <= 3)
        connection.settimeout(SOON_S)
        data = b""
        while b"read this" not in data:
            data = data[-64:] + connection.recv(1 << 16)
        connection.close()
    finally:
        link.close()
        server.close()


def test_what_is_queued_is_sent_before_the_end(peer: Peer) -> None:
    link = AutopilotLink(f"udpout:127.0.0.1:{peer.port}")
    for index in range(20):
        link.send(status_text(f"text {index}", False))
    link.close()
    link.close()
    assert peer.wait_for("STATUSTEXT", lambda m: m.text == "text 19")
    link.send(heartbeat())  # goes nowhere, and harms nothing


@pytest.mark.parametrize("url", ["127.0.0.1:14550", "udp:", "serial:/dev/ttyAMA0", "udpout:host:port", LONG_BAUD])
def test_address_that_is_none_is_refused(url: str) -> None:
    with pytest.raises(SettingError, match="write udpout:HOST:PORT"):
        AutopilotLink(url)


def test_port_beyond_the_range_is_refused() -> None:
    with pytest.raises(SettingError, match="a port is a number of 1 to 65535"):
        AutopilotLink("tcp:a:65536")


@pytest.mark.parametrize(
    ("url", "problem"),
    [
        ("serial:/dev/does-not-exist:57600", "No such file"),
        ("serial:/dev/null:57600", "no serial port"),
        ("serial:/dev/null:57601", "no 57601 baud"),
        ("udpin:192.0.2.1:14550", "assign requested address"),
        ("udpout:192.168.1..20:14550", "nothing can have this name"),
        ("udpout:255.255.255.255:14550", "a broadcast address"),
    ],
)
def test_port_that_cannot_be_opened_is_refused(url: str, problem: str) -> None:
    with pytest.raises(DataError, match=problem):
        AutopilotLink(url)
