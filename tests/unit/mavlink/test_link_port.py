"""Ports whose other side is gone say so at once, and ports that take nothing do not wait."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import socket
import struct
import time

import pytest

from monoloc.mavlink import link_port
from monoloc.mavlink.link_port import Address, open_port, parse_address

SOON_S = 5.0


def test_addresses_as_users_write_them() -> None:
    assert parse_address("serial:/dev/ttyAMA0:921600") == Address("serial", "/dev/ttyAMA0", 921600)
    assert parse_address("udpin:0.0.0.0:14550") == Address("udpin", "0.0.0.0", 14550)
    assert parse_address("tcp:[::1]:5760") == Address("tcp", "::1", 5760)


def test_tcp_peer_that_ended_is_gone_at_the_next_read() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(Address("tcp", "127.0.0.1", server.getsockname()[1]))
        connection, _ = server.accept()
        assert port.read() == b""  # nothing came
        connection.sendall(b"abc")
        select.select([port], [], [], SOON_S)
        assert port.read() == b"abc"
        connection.close()
        select.select([port], [], [], SOON_S)
        with pytest.raises(ConnectionResetError):
            port.read()
        port.close()


def test_tcp_peer_that_does_not_read_fills_the_port() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(Address("tcp", "127.0.0.1", server.getsockname()[1]))
        while port.write(bytes(1 << 20)):
            pass  # it ends, without waiting
        port.close()


def test_serial_device_that_was_unplugged_is_gone_at_the_next_read() -> None:
    controller, device = os.openpty()
    port = open_port(Address("serial", os.ttyname(device), 115200))
    assert port.read() == b""
    sent = bytes(range(256))  # also what a terminal would change or act on
    os.write(controller, sent)
    select.select([port], [], [], SOON_S)
    assert port.read() == sent
    assert port.write(sent) == 256 and os.read(controller, 512) == sent
    os.close(device)
    os.close(controller)
    select.select([port], [], [], SOON_S)
    with pytest.raises(OSError):
        port.read()
    port.close()


@pytest.mark.parametrize(("baud", "full"), [(57600, 288), (921600, 4608)])
def test_serial_port_is_full_with_what_takes_it_fifty_milliseconds(
    baud: int, full: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A terminal without a line never has anything to send, so the system's answer is replaced."""
    controller, device = os.openpty()
    port = open_port(Address("serial", os.ttyname(device), baud))
    assert not port.is_full
    for waiting in (full - 1, full):
        monkeypatch.setattr(fcntl, "ioctl", lambda *_, waiting=waiting: struct.pack("i", waiting))
        assert port.is_full == (waiting == full)
    port.close()
    os.close(device)
    os.close(controller)


def test_udp_peer_that_does_not_listen_disturbs_nothing() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as closed:
        closed.bind(("127.0.0.1", 0))
        number = closed.getsockname()[1]
    port = open_port(Address("udpout", "127.0.0.1", number))
    for _ in range(3):
        assert port.write(b"abc") == 3 and port.read() == b""
    port.close()


def test_udp_takes_the_address_that_autopilots_listen_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Debian answers for localhost: the address of IPv6 comes first."""

    def both(host: str, port: int, **_: int) -> list[tuple[int, int, int, str, tuple[str | int, ...]]]:
        kind, protocol = socket.SOCK_DGRAM, socket.IPPROTO_UDP
        return [
            (socket.AF_INET6, kind, protocol, "", ("::1", port, 0, 0)),
            (socket.AF_INET, kind, protocol, "", ("127.0.0.1", port)),
        ]

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
        autopilot.bind(("127.0.0.1", 0))
        autopilot.settimeout(SOON_S)
        number = autopilot.getsockname()[1]
        monkeypatch.setattr(socket, "getaddrinfo", both)
        port = open_port(Address("udpout", "localhost", number))
        assert port.write(b"pose") == 4 and autopilot.recv(9) == b"pose"
        port.close()


def test_udp_client_that_no_way_leads_to_any_more_takes_nothing_from_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A ground station whose network went down, beside the autopilot."""
    gone = list[int]()

    class Network(socket.socket):
        def sendto(self, data: bytes, place: tuple[str, int]) -> int:  # type: ignore[override]
            if place[1] in gone:
                raise OSError(errno.ENETUNREACH, "Network is unreachable")
            return super().sendto(data, place)

    monkeypatch.setattr(socket, "socket", Network)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    port = open_port(Address("udpin", "127.0.0.1", number))
    udp = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*udp) as station, socket.socket(*udp) as autopilot:
        autopilot.settimeout(SOON_S)
        for client in (station, autopilot):
            client.connect(("127.0.0.1", number))
            client.send(b"hello")
            select.select([port], [], [], SOON_S)
            assert port.read() == b"hello"
        gone.append(station.getsockname()[1])
        for _ in range(2):
            assert port.write(b"pose") == 4
            assert autopilot.recv(9) == b"pose"
        gone.append(autopilot.getsockname()[1])
        assert port.write(b"pose") == 4 and not port.has_receiver
    port.close()


def test_tcp_holds_few_poses_of_a_peer_that_takes_none() -> None:
    """What is written is delivered, however old: more must wait where it can be dropped."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        port = open_port(Address("tcp", "127.0.0.1", server.getsockname()[1]))
        taken = 0
        while taken < 10_000 and port.write(b"\0" * 250):
            taken += 1
        port.close()
    assert taken < 100


def test_tcp_peer_that_takes_nothing_any_more_is_gone_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """TCP itself tries again for a quarter of an hour, ever more rarely."""
    monkeypatch.setattr(link_port, "_SILENT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(Address("tcp", "127.0.0.1", server.getsockname()[1]))
        end_s = time.monotonic() + SOON_S
        with pytest.raises(TimeoutError):
            while time.monotonic() < end_s:
                port.write(b"\0" * 1000)
        port.close()
