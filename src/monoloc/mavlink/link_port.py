"""Ports that a link reads and writes: UDP, TCP and serial, without waiting.

Python's standard library does: pymavlink's own connections need pyserial, print to standard output, and do not find a
TCP peer that restarted.
"""

from __future__ import annotations

import os
import re
import socket
import sys
import time
from dataclasses import dataclass
from typing import Any, Protocol

from monoloc.errors import SettingError

BITS_PER_BYTE = 10
"""Of a serial port, with a start and a stop bit."""

_NETWORK = re.compile(r"(udpout|udpin|tcp):\[?([^\[\]]+?)\]?:([0-9]{1,5})")
_SERIAL = re.compile(r"serial:(.+):([0-9]{1,8})")
_MOST_PORT = 65535
_BYTES = 1 << 16  # of one read
_CONNECT_S = 2.0
_SILENT_S = 3.0  # without a word from the other side's TCP, after which a connection is lost
_WAITING_S = 0.05  # of a serial port's speed: its buffer of kilobytes would hold poses of a second
_CLIENT_S = 5.0  # for which a UDP client that is silent is sent to
_MOST_CLIENTS = 8


@dataclass(frozen=True)
class Address:
    """Where an autopilot is.

    Attributes:
        kind: ``udpout``, ``udpin``, ``tcp`` or ``serial``.
        place: host or device.
        number: port or baud rate.
    """

    kind: str
    place: str
    number: int


class Port(Protocol):
    """An open port; every method raises OSError where the other side or the device is gone."""

    @property
    def has_receiver(self) -> bool:
        """Whether there is someone to write to."""
        ...

    @property
    def is_full(self) -> bool:
        """Whether so much waits to be sent that more would come late, although it would be taken."""
        ...

    def fileno(self) -> int: ...

    def read(self) -> bytes:
        """What has come, after the port became readable; may be empty."""
        ...

    def write(self, data: bytes) -> int:
        """How many bytes were taken; 0 where the port is full."""
        ...

    def close(self) -> None: ...


def parse_address(url: str) -> Address:
    """What a user writes as the address of an autopilot.

    Raises:
        SettingError: it is none.
    """
    if serial := _SERIAL.fullmatch(url):
        return Address("serial", serial[1], int(serial[2]))
    network = _NETWORK.fullmatch(url)
    if network is not None and not 0 < int(network[3]) <= _MOST_PORT:
        raise SettingError("--mavlink", f"is {url!r}", f"a port is a number of 1 to {_MOST_PORT}")
    if network is None:
        fix = "write udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
        raise SettingError("--mavlink", f"is {url!r}", fix)
    return Address(network[1], network[2], int(network[3]))


def open_port(address: Address) -> Port:
    """Open a port; TCP waits up to two seconds for the other side.

    Raises:
        OSError: it cannot be opened.
    """
    try:
        if address.kind == "serial":
            return _SerialPort(address.place, address.number)
        if address.kind == "tcp":
            return _TcpPort(address.place, address.number)
        return _UdpPort(address)
    except ValueError as error:  # such as a host with two dots in a row
        raise OSError("nothing can have this name") from error


class _UdpPort:
    """Sends to one address, or to every client that was heard of late."""

    is_full = False

    def __init__(self, address: Address) -> None:
        is_server = address.kind == "udpin"
        found = socket.getaddrinfo(
            address.place, address.number, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE if is_server else 0
        )
        # Autopilots speak IPv4. Of localhost, many systems name the address of IPv6 first, where nobody listens.
        family, kind, protocol, _, place = min(found, key=lambda each: each[0] != socket.AF_INET)
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        self._target = None if is_server else place
        self._clients: dict[Any, float] = {}
        try:
            if is_server:
                self._socket.bind(place)
            else:
                _refuse_broadcast(family, place)
        except OSError:
            self._socket.close()
            raise

    @property
    def has_receiver(self) -> bool:
        return bool(self._receivers())

    def _receivers(self) -> list[Any]:
        if self._target is not None:
            return [self._target]
        now_s = time.monotonic()
        self._clients = {client: at_s for client, at_s in self._clients.items() if now_s - at_s < _CLIENT_S}
        return list(self._clients)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> bytes:
        try:
            data, client = self._socket.recvfrom(_BYTES)
        except (BlockingIOError, ConnectionError):  # a refusal answers what was sent, and may come here
            return b""
        if client in self._clients or len(self._clients) < _MOST_CLIENTS:
            self._clients[client] = time.monotonic()
        return data

    def write(self, data: bytes) -> int:
        for receiver in self._receivers():
            try:
                self._socket.sendto(data, receiver)
            except BlockingIOError:
                return 0
            except ConnectionError:  # nobody listens yet
                pass
            except OSError:  # such as no route to it
                if self._clients.pop(receiver, None) is None:
                    raise
        return len(data)

    def close(self) -> None:
        self._socket.close()


def _refuse_broadcast(family: int, place: Any) -> None:
    """Raise OSError for the address of all computers of a network, to which no message would ever go out."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(place)  # sends nothing
        except PermissionError as error:
            raise OSError("it is a broadcast address") from error
        except OSError:  # no way leads there yet
            pass


class _TcpPort:
    """A connection to a server."""

    has_receiver, is_full = True, False

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), _CONNECT_S)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):  # Windows has none
            # Else, while the network is gone, TCP takes megabytes: poses of minutes, which it delivers afterwards.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, 1)
        if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
            # Else it tries again ever more rarely, and is silent as long again after the network is back.
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1000.0 * _SILENT_S))

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> bytes:
        try:
            data = self._socket.recv(_BYTES)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionResetError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        self._socket.close()


class _SerialPort:
    """A serial device with 8 data bits, no parity, 1 stop bit and no flow control, which no one else may open."""

    has_receiver = True

    def __init__(self, device: str, baud: int) -> None:
        try:
            import fcntl
            import termios
        except ImportError as error:
            raise OSError("this system has no POSIX serial ports") from error
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise OSError(f"this system has no {baud} baud")
        self._file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            control = termios.tcgetattr(self._file)[6]
            control[termios.VMIN], control[termios.VTIME] = 1, 0  # so that no byte means that the device is gone
            flags = termios.CS8 | termios.CREAD | termios.CLOCAL
            termios.tcsetattr(self._file, termios.TCSANOW, [0, 0, flags, 0, speed, speed, control])
            fcntl.ioctl(self._file, termios.TIOCEXCL)
        except termios.error as error:
            os.close(self._file)
            raise OSError("it is no serial port") from error
        self._most_waiting = round(_WAITING_S * baud / BITS_PER_BYTE)

    @property
    def is_full(self) -> bool:
        import fcntl
        import termios

        waiting = fcntl.ioctl(self._file, termios.TIOCOUTQ, b"\0\0\0\0")
        return int.from_bytes(waiting, sys.byteorder) >= self._most_waiting

    def fileno(self) -> int:
        return self._file

    def read(self) -> bytes:
        try:
            data = os.read(self._file, _BYTES)
        except BlockingIOError:
            return b""
        if not data:  # though it was readable
            raise ConnectionResetError("the device was unplugged")
        return data

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._file, data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        os.close(self._file)
