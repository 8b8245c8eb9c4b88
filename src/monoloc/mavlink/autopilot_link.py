"""The link to an autopilot: what it says is kept, its questions are answered, and one place sends.

The clock of everything that is sent is ``time.monotonic``: that of times of capture, and of the answers to TIMESYNC.
"""

from __future__ import annotations

import bisect
import contextlib
import math
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from monoloc.extras import require_extra
from monoloc.live.capture_clock import CaptureClock
from monoloc.mavlink.autopilot_frames import rotation_of
from monoloc.mavlink.byte_link import ByteLink
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.link_port import parse_address
from monoloc.mavlink.messages import AUTOPILOT_COMPONENT, COMPONENT, dialect, heartbeat, parameter_request, timesync
from monoloc.odometry.attitude import AttitudeHistory
from monoloc.odometry.motion import Motion

_SECOND_S = 1.0  # between heartbeats, and between questions for the time and for a parameter
_ATTITUDES = 200  # that are kept: four seconds at 50 Hz
# Between two attitudes, between which one is interpolated; between a frame and an attitude that holds for it; and
# between a frame and the last attitude, as long as the next has not come, of which the vehicle turns on for a part.
_MOST_GAP_S, _SAME_S, _LAST_S, _TURNS_ON_S = 0.12, 0.02, 0.1, 0.06
_ALIVE_S = 3.0  # since the autopilot's last heartbeat
_INVALID_AUTOPILOT = 8  # HEARTBEAT's autopilot, of what is none
_GOES_STALE = {"HEARTBEAT", "ODOMETRY", "VISION_POSITION_ESTIMATE", "OBSTACLE_DISTANCE", "TIMESYNC"}
_MAGIC_2, _HEADER_2_BYTES, _HEADER_1_BYTES = 0xFD, 10, 6  # of MAVLink 2 and 1
# MAV_PARAM_TYPE of the whole numbers, which PX4 sends as their bytes in place of a float's.
_BYTES_OF = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}


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
        R_body_camera: turns the camera's axes into the body's, forward, right, down; (3, 3).

    Attributes:
        round_trip_s: of the last TIMESYNC that the autopilot answered; None before.

    Raises:
        SettingError: the address is none of these.
        DataError: the port cannot be opened.
        MissingExtraError: pymavlink is not installed.
    """

    def __init__(self, url: str, R_body_camera: ArrayLike = np.eye(3)) -> None:
        parse_address(url)  # a wrong address is refused with and without pymavlink
        require_extra("mavlink")
        self.round_trip_s: float | None = None
        self._packing = threading.Lock()
        self._packer = dialect().MAVLink(None, srcSystem=1, srcComponent=COMPONENT)
        self._parser = _parser()
        self._changed = threading.Condition()
        self._attitudes: deque[Attitude] = deque(maxlen=_ATTITUDES)
        self._history = AttitudeHistory(R_body_camera)
        self._clock = CaptureClock()
        self._parameters: dict[str, float] = {}
        self._vehicle: tuple[int, int] | None = None  # system and component of the autopilot
        self._others: set[int] = set()
        self._firmware: Firmware | None = None
        self._heard_s = self._beat_s = float("-inf")
        self._asked_ns = 0
        self._bytes = ByteLink(url, self._take_bytes, self._tick)
        self._bytes.start()

    @property
    def counts(self) -> Counter[str]:
        """Frames sent, dropped, received and damaged, and reconnections."""
        return self._bytes.counts

    @property
    def is_open(self) -> bool:
        """Whether the port is open; of a device that is unplugged it is not."""
        return self._bytes.is_open

    @property
    def queued(self) -> int:
        """How many frames wait for the port to take them."""
        return self._bytes.queued

    @property
    def hears_noise(self) -> bool:
        """Whether a serial port gave bytes, but never a message, as at a wrong baud rate."""
        return self._bytes.is_serial and self.counts["damaged"] > 0 and self.counts["received"] == 0

    @property
    def is_alive(self) -> bool:
        """Whether the autopilot's heartbeat was heard in the last three seconds."""
        return time.monotonic() - self._heard_s < _ALIVE_S

    @property
    def system(self) -> int | None:
        """The autopilot's system; None before its first heartbeat."""
        return None if self._vehicle is None else self._vehicle[0]

    @property
    def others(self) -> frozenset[int]:
        """Systems of other autopilots that were heard, and are not listened to."""
        return frozenset(self._others)

    @property
    def firmware(self) -> Firmware | None:
        """That the autopilot says it has; None before its first heartbeat, or of one that is neither."""
        return self._firmware

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters that were read."""
        with self._changed:
            return dict(self._parameters)

    @property
    def attitude_hz(self) -> float:
        """How often attitudes come; 0 where none came in the last second."""
        with self._changed:
            times_s = [attitude.time_s for attitude in self._attitudes]
        if len(times_s) < 2 or time.monotonic() - times_s[-1] > _SECOND_S:
            return 0.0
        return (len(times_s) - 1) / (times_s[-1] - times_s[0])

    def attitude_at(self, time_s: float) -> Attitude | None:
        """The attitude at a time of capture, between the two around it; None where these are missing.

        Up to 0.1 s after the last one, since the next may not have come, the vehicle is taken to turn on for 0.06 s
        as it did between the last two. An attitude of 20 ms beside that time will do as well.
        """
        with self._changed:
            known = list(self._attitudes)
        after = bisect.bisect_left(known, time_s, key=lambda attitude: attitude.time_s)
        around = known[max(0, after - 1) : after + 1]
        if len(around) == 2 and around[1].time_s - around[0].time_s <= _MOST_GAP_S:
            return _between(around[0], around[1], time_s)
        if after == len(known):
            return _after(known[-2:], time_s)
        nearest = min(around, key=lambda attitude: abs(attitude.time_s - time_s), default=None)
        return None if nearest is None or abs(nearest.time_s - time_s) > _SAME_S else nearest

    def turn_between(self, start_s: float, end_s: float) -> Motion | None:
        """The camera's rotation between two times of capture; None where attitudes are missing for 0.12 s."""
        with self._changed:
            return self._history.between(start_s, end_s)

    def send(self, message: Any) -> None:
        """Queue a message. All but texts and questions for parameters are dropped if the port holds them up."""
        with self._packing:
            data: bytes = message.pack(self._packer)
            self._packer.seq = (self._packer.seq + 1) % 256
            self._bytes.send(data, message.get_type() in _GOES_STALE)

    def read_parameters(self, names: tuple[str, ...], timeout_s: float) -> dict[str, float]:
        """Ask for parameters, as many times as the timeout allows; those that did not come are missing."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            missing = [name for name in names if name not in self.parameters]
            if not missing:
                break
            system = self.system or 0
            for name in missing:
                self.send(parameter_request(name, system))
            with self._changed:
                self._changed.wait_for(lambda: self._parameters.keys() >= set(names), min(_SECOND_S, left_s))
        known = self.parameters
        return {name: known[name] for name in names if name in known}

    def close(self) -> None:
        """Send what is queued, and close the port."""
        self._bytes.close()

    def _tick(self) -> None:
        now_s = time.monotonic()
        if now_s - self._beat_s >= _SECOND_S:
            self._beat_s = now_s
            self.send(heartbeat())
            if self._vehicle is not None:
                self._asked_ns = time.monotonic_ns()
                self.send(timesync(0, self._asked_ns))

    def _take_bytes(self, data: bytes) -> None:
        arrived_s = time.monotonic()
        try:
            messages = self._parser.parse_buffer(data) or []
        except (dialect().MAVError, ValueError):  # a frame with a right checksum that is no message
            self._parser = _parser()
            messages = []
            self.counts["damaged"] += 1
        for message in messages:
            if message.get_type() == "BAD_DATA":
                self.counts["damaged"] += 1
            elif message.get_srcComponent() != COMPONENT:
                self.counts["received"] += 1
                self._take(message, arrived_s)

    def _take(self, message: Any, arrived_s: float) -> None:
        """Act on a message of the vehicle."""
        kind = message.get_type()
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind == "HEARTBEAT" and message.autopilot != _INVALID_AUTOPILOT and sender[0] != 0:
            self._take_heartbeat(message, sender, arrived_s)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.send(timesync(time.monotonic_ns(), message.ts1))
        elif self._vehicle == sender:  # before a heartbeat, it could be any vehicle's
            self._take_of_autopilot(kind, message, arrived_s)

    def _take_heartbeat(self, message: Any, sender: tuple[int, int], arrived_s: float) -> None:
        """Act on the heartbeat of an autopilot."""
        if self._vehicle not in (None, sender):
            is_ours = sender[0] == self.system
            if not is_ours:  # also while ours is silent: the camera sits on one vehicle
                self._others.add(sender[0])
            if not is_ours or sender[1] != AUTOPILOT_COMPONENT:
                return
        if self._vehicle != sender:
            self._vehicle = sender
            self._packer.srcSystem = sender[0]  # a part of the same vehicle
            self._beat_s = float("-inf")  # it hears at once who is there
        self._heard_s, self._firmware = arrived_s, Firmware.of_heartbeat(message.autopilot)

    def _take_of_autopilot(self, kind: str, message: Any, arrived_s: float) -> None:
        """Act on a message of the autopilot itself."""
        if kind == "TIMESYNC" and message.ts1 == self._asked_ns:
            self.round_trip_s = (time.monotonic_ns() - self._asked_ns) / 1e9
        elif kind == "ATTITUDE" and all(map(math.isfinite, (message.roll, message.pitch, message.yaw))):
            time_s = self._clock.captured_s(message.time_boot_ms / 1e3, arrived_s)
            # A stamp that is not after the last one says nothing new.
            with self._changed, contextlib.suppress(ValueError):
                self._history.add(time_s, rotation_of(message.roll, message.pitch, message.yaw))
                self._attitudes.append(Attitude(time_s, message.roll, message.pitch, message.yaw))
        elif kind == "PARAM_VALUE":
            with self._changed:
                self._parameters[str(message.param_id)] = _value_of(message, self._firmware is Firmware.PX4)
                self._changed.notify_all()


def _between(before: Attitude, after: Attitude, time_s: float) -> Attitude:
    """The attitude at a time between or after two, which are less than half a turn apart."""
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    angles = [
        first + share * ((last - first + math.pi) % math.tau - math.pi)
        for first, last in (
            (before.roll_rad, after.roll_rad),
            (before.pitch_rad, after.pitch_rad),
            (before.yaw_rad, after.yaw_rad),
        )
    ]
    return Attitude(time_s, *angles)


def _after(last: list[Attitude], time_s: float) -> Attitude | None:
    """The attitude at a time not before the last of at most two; None where that is too long ago."""
    if not last or time_s - last[-1].time_s > _LAST_S:
        return None
    if len(last) < 2 or last[1].time_s - last[0].time_s > _MOST_GAP_S:
        return last[-1]
    return _between(last[0], last[1], min(time_s, last[1].time_s + _TURNS_ON_S))


def _value_of(parameter: Any, is_px4: bool) -> float:
    """The value of PARAM_VALUE, whose first field is a float or, of PX4's whole numbers, has their bytes."""
    whole_number = _BYTES_OF.get(parameter.param_type)
    if not is_px4 or whole_number is None:
        return float(parameter.param_value)
    frame = parameter.get_msgbuf()
    header_bytes = _HEADER_2_BYTES if frame[0] == _MAGIC_2 else _HEADER_1_BYTES
    (value,) = struct.unpack_from(whole_number, frame, header_bytes)
    return float(value)


def _parser() -> Any:
    parser = dialect().MAVLink(None)
    parser.robust_parsing = True  # damaged bytes are told, not raised
    return parser
