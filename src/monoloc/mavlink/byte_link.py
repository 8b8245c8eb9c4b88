"""A thread that keeps a port open, writes what is queued and hands on what comes."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from monoloc.errors import DataError
from monoloc.mavlink.link_port import Port, open_port, parse_address

_TICK_S = 0.05
_FULL_S = 0.005  # between looks at a port that has enough to send
_FIRST_RETRY_S, _LAST_RETRY_S = 0.2, 2.0  # between attempts to open a port that is gone
_MOST_QUEUED = 100
_STALE_S = 0.2  # after which a queued pose would mislead
_FLUSH_S, _JOIN_S = 0.3, 3.0
_WAKES = 4096


@dataclass
class _Queued:
    data: bytes
    queued_s: float
    goes_stale: bool


class ByteLink:
    """Bytes to and from an autopilot that may go and come back; nothing that it does makes the caller wait.

    Args:
        url: see :func:`monoloc.mavlink.link_port.parse_address`.
        on_bytes: is given what comes, in the link's thread.
        on_tick: is called about twenty times a second, in the link's thread.

    Attributes:
        counts: frames sent and dropped, and reconnections.

    Raises:
        SettingError: the address is none.
        DataError: the port cannot be opened.
    """

    def __init__(self, url: str, on_bytes: Callable[[bytes], None], on_tick: Callable[[], None]) -> None:
        self._address = parse_address(url)
        try:
            self._port: Port | None = open_port(self._address)
        except OSError as error:
            problem = f"cannot be opened ({error.strerror or error})"
            fix = "check the address, the cable and your permissions"
            raise DataError(url, problem, fix, page="how-to/mavlink") from error
        self.counts: Counter[str] = Counter()
        self._on_bytes, self._on_tick = on_bytes, on_tick
        self._queue: deque[_Queued] = deque()
        self._rest = b""  # of a frame that the port took in part
        self._queueing = threading.Lock()
        self._wake_out, self._wake_in = socket.socketpair()
        self._wake_out.setblocking(False)
        self._retry_s, self._retry_at_s = _FIRST_RETRY_S, 0.0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="autopilot", daemon=True)

    @property
    def is_open(self) -> bool:
        """Whether the port is open; whether anyone is there, only what is heard tells."""
        return self._port is not None

    @property
    def is_serial(self) -> bool:
        """Whether it is a serial port, which has a baud rate."""
        return self._address.kind == "serial"

    @property
    def queued(self) -> int:
        """How many frames wait."""
        return len(self._queue)

    def start(self) -> None:
        """Begin to read and write."""
        self._thread.start()

    def send(self, data: bytes, goes_stale: bool) -> None:
        """Queue a frame.

        Args:
            data: of the frame.
            goes_stale: whether it is dropped rather than sent late.
        """
        with self._queueing:
            if len(self._queue) >= _MOST_QUEUED:
                self._queue.popleft()
                self.counts["dropped"] += 1
            self._queue.append(_Queued(data, time.monotonic(), goes_stale))
        self._wake()

    def close(self) -> None:
        """Write what is queued, if the port takes it, and close; a second call does nothing."""
        if self._closing.is_set():
            return
        end_s = time.monotonic() + _FLUSH_S
        while self._has_work(self._port) and time.monotonic() < end_s:
            time.sleep(0.002)
        self._closing.set()
        self._wake()
        self._thread.join(_JOIN_S)

    def _wake(self) -> None:
        with contextlib.suppress(OSError):  # it is awake already, or has ended
            self._wake_out.send(b"\0")

    def _has_work(self, port: Port | None) -> bool:
        return port is not None and port.has_receiver and bool(self._rest or self._queue)

    def _run(self) -> None:
        tick_s = float("-inf")
        try:
            while not self._closing.is_set():
                if time.monotonic() - tick_s >= _TICK_S:
                    tick_s = time.monotonic()
                    self._drop_stale()
                    self._on_tick()
                self._reopen_if_due()
                try:
                    self._transfer()
                except OSError:
                    self._lose_port()
        finally:
            self._close_port()
            self._wake_in.close()
            self._wake_out.close()

    def _transfer(self) -> None:
        """Wait for the port or for something to send, no longer than a tick."""
        port, to_read, to_write, wait_s = self._port, [self._wake_in.fileno()], list[int](), _TICK_S
        if port is not None:
            to_read.append(port.fileno())
            if self._has_work(port) and port.is_full:
                wait_s = _FULL_S
            elif self._has_work(port):
                to_write.append(port.fileno())
        readable, writable, _ = select.select(to_read, to_write, [], wait_s)
        if self._wake_in.fileno() in readable:
            self._wake_in.recv(_WAKES)
        if port is not None and writable:
            self._write(port)
        if port is not None and port.fileno() in readable:
            self._on_bytes(port.read())

    def _write(self, port: Port) -> None:
        """Write as much as the port takes at once, and would not send late."""
        while not port.is_full and (data := self._rest or self._next()):
            taken = port.write(data)
            self._rest = data[taken:]
            if self._rest:
                return
            self.counts["sent"] += 1

    def _next(self) -> bytes:
        self._drop_stale()  # this thread itself may have stood still, as on a busy computer
        with self._queueing:
            return self._queue.popleft().data if self._queue else b""

    def _drop_stale(self) -> None:
        with self._queueing:
            now_s = time.monotonic()
            fresh = [item for item in self._queue if not (item.goes_stale and now_s - item.queued_s > _STALE_S)]
            if len(fresh) < len(self._queue):
                self.counts["dropped"] += len(self._queue) - len(fresh)
                self._queue = deque(fresh)

    def _lose_port(self) -> None:
        self._close_port()
        self._rest = b""
        self._retry_at_s = time.monotonic() + self._retry_s

    def _close_port(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None

    def _reopen_if_due(self) -> None:
        if self._port is not None or time.monotonic() < self._retry_at_s:
            return
        try:
            self._port = open_port(self._address)
        except OSError:
            self._retry_s = min(2.0 * self._retry_s, _LAST_RETRY_S)
            self._retry_at_s = time.monotonic() + self._retry_s
            return
        self._retry_s = _FIRST_RETRY_S
        self.counts["reconnections"] += 1
