"""The link to an autopilot: a thread that reads and answers, and one place that sends.

The clock of everything that is sent is ``time.monotonic``: that of times of capture, and of the answers to TIMESYNC.
"""

from __future__ import annotations

import os
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from monoloc.errors import DataError, SettingError
from monoloc.extras import require_mavlink
from monoloc.live.capture_clock import CaptureClock
from monoloc.mavlink.messages import COMPONENT, heartbeat, timesync_answer

_HEARTBEAT_S = 1.0
_ATTITUDES = 200  # that are kept: four seconds at 50 Hz
_ATTITUDE_S = 0.1  # between a frame and the nearest attitude, beyond which there is none
_READ_S = 0.05  # for which the reader waits for a message
_ALIVE_S = 3.0  # since the autopilot's last heartbeat
_PARAMETER_S = 1.0  # to wait for a parameter before it is asked for again
_INVALID_AUTOPILOT = 8  # in the heartbeat of what is no autopilot
_URL = re.compile(r"(?:udpout|udpin|tcp|tcpin):[^:]+:\d+|serial:[^:]+:\d+")


@dataclass(frozen=True)
class Attitude:
    """Roll and pitch of the vehicle.

    Attributes:
        time_s: by ``time.monotonic``.
        roll_rad, pitch_rad, yaw_rad: from north-east-down to the body.
    """

    time_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float


class AutopilotLink:
    """An autopilot over UDP, TCP or a serial port; it may come, go and come back.

    Args:
        url: ``udpout:HOST:PORT``, ``udpin:HOST:PORT``, ``tcp:HOST:PORT`` or ``serial:DEVICE:BAUD``.
        on_sent: is given the bytes of every message and the time it was sent, for a recording.

    Raises:
        SettingError: the address is none of these.
        DataError: the port cannot be opened.
        MissingExtraError: pymavlink is not installed.
    """

    def __init__(self, url: str, on_sent: Callable[[bytes, float], None] | None = None) -> None:
        if not _URL.fullmatch(url):
            fix = "write udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
            raise SettingError("--mavlink", f"is {url!r}", fix)
        require_mavlink()
        self._url, self._on_sent = url, on_sent
        self._connection = _connect(url)
        self._sending = threading.Lock()
        self._state = threading.Lock()
        self._attitudes: deque[Attitude] = deque(maxlen=_ATTITUDES)
        self._clock = CaptureClock()
        self._parameters: dict[str, float] = {}
        self._heard_s = float("-inf")
        self.counts: Counter[str] = Counter()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="autopilot", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        """Whether the autopilot's heartbeat was heard in the last three seconds."""
        return time.monotonic() - self._heard_s < _ALIVE_S

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters that were read."""
        with self._state:
            return MappingProxyType(dict(self._parameters))

    def attitude_at(self, time_s: float) -> Attitude | None:
        """The attitude nearest to a time of capture; None where none is within a tenth of a second."""
        with self._state:
            nearest = min(self._attitudes, key=lambda attitude: abs(attitude.time_s - time_s), default=None)
        return None if nearest is None or abs(nearest.time_s - time_s) > _ATTITUDE_S else nearest

    def send(self, message: Any) -> None:
        """Send a message; a port that does not take it counts as a failure, and the flight goes on."""
        with self._sending:
            connection = self._connection
            data: bytes = message.pack(connection.mav)
            connection.mav.seq = (connection.mav.seq + 1) % 256
            now_s = time.monotonic()
            try:
                connection.write(data)
            except (OSError, ValueError):  # unplugged; the reader opens it again
                self.counts["failed"] += 1
                return
            self.counts["sent"] += 1
        if self._on_sent is not None:
            self._on_sent(data, now_s)

    def read_parameters(self, names: tuple[str, ...], timeout_s: float) -> dict[str, float]:
        """Ask for parameters, as many times as the timeout allows; those that did not come are missing."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s and not self._closing.is_set():
            missing = [name for name in names if name not in self.parameters]
            if not missing:
                break
            for name in missing:
                self.send(self._parameter_request(name))
            again_s = min(time.monotonic() + _PARAMETER_S, end_s)
            while time.monotonic() < again_s and any(name not in self.parameters for name in missing):
                time.sleep(0.01)
        known = self.parameters
        return {name: known[name] for name in names if name in known}

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        with self._sending:
            self._connection.close()

    def _parameter_request(self, name: str) -> Any:
        connection = self._connection
        return connection.mav.param_request_read_encode(
            connection.target_system, connection.target_component, name.encode("ascii"), -1
        )

    def _run(self) -> None:
        beat_s = float("-inf")
        while not self._closing.is_set():
            now_s = time.monotonic()
            if now_s - beat_s >= _HEARTBEAT_S:
                beat_s = now_s
                self.send(heartbeat())
            try:
                message = self._connection.recv_match(blocking=True, timeout=_READ_S)
            except (OSError, ValueError, TypeError):  # pyserial raises TypeError for a port that vanished
                self._reopen()
                continue
            if message is not None:
                self._take(message, time.monotonic())

    def _reopen(self) -> None:
        """Open the port again, until it is there."""
        self.counts["reconnections"] += 1
        while not self._closing.wait(_HEARTBEAT_S / 2.0):
            try:
                connection = _connect(self._url)
            except DataError:
                continue
            with self._sending:
                self._connection.close()
                self._connection = connection
            return

    def _take(self, message: Any, arrived_s: float) -> None:
        """Act on a message of the vehicle."""
        kind = message.get_type()
        if kind == "BAD_DATA" or message.get_srcComponent() == COMPONENT:
            return
        self.counts["received"] += 1
        if kind == "HEARTBEAT" and message.autopilot != _INVALID_AUTOPILOT:
            self._heard_s = arrived_s
            self._connection.target_system = message.get_srcSystem()
            self._connection.target_component = message.get_srcComponent()
            self._connection.mav.srcSystem = message.get_srcSystem()  # a part of the same vehicle
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.send(timesync_answer(time.monotonic_ns(), message.ts1))
        elif kind == "ATTITUDE":
            time_s = self._clock.captured_s(message.time_boot_ms / 1e3, arrived_s)
            with self._state:
                self._attitudes.append(Attitude(time_s, message.roll, message.pitch, message.yaw))
        elif kind == "PARAM_VALUE":
            with self._state:
                self._parameters[message.param_id] = float(message.param_value)


def _connect(url: str) -> Any:
    """A connection of pymavlink, with version 2 of the protocol and the common dialect.

    Raises:
        DataError: the port cannot be opened.
    """
    os.environ["MAVLINK20"] = "1"
    from pymavlink import mavutil

    mavutil.set_dialect("common")
    given: dict[str, Any] = {"source_system": 1, "source_component": COMPONENT}
    try:
        if url.startswith("serial:"):
            _, device, baud = url.split(":")
            return mavutil.mavlink_connection(device, baud=int(baud), **given)
        return mavutil.mavlink_connection(url, **given)
    except (OSError, ValueError) as error:
        raise DataError(url, f"cannot be opened ({error})", "check the address, the cable and your rights") from error
