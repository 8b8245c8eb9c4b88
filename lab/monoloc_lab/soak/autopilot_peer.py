"""An autopilot's side of a link over UDP: it listens, asks for the time, and hands every datagram on to MAVSDK."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from monoloc.extras import require_extra
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import dialect
from monoloc_lab.soak import ardupilot_decoder, px4_decoder

_PERIOD_S = 0.1  # between questions for the time; PX4 asks ten times a second
_HEARTBEAT_S = 1.0
_QUADROTOR, _PX4, _ARDUPILOT, _ACTIVE = 2, 12, 3, 4  # of HEARTBEAT: type, autopilot, system_status


@dataclass
class Heard:
    """What came.

    Attributes:
        poses: time of arrival, time of capture by its stamp (both seconds), and reset counter of each pose that the
            firmware's decoder takes.
        counts: messages by kind, and ``refused`` poses.
        texts: time of arrival and text of each STATUSTEXT.
        answered_s: round trip of each TIMESYNC.
    """

    poses: list[tuple[float, float, int]] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    texts: list[tuple[float, str]] = field(default_factory=list)
    answered_s: list[float] = field(default_factory=list)


class AutopilotPeer:
    """Listens on a port from :meth:`open` to :meth:`close`, and may be opened again.

    Args:
        port: UDP, on this machine.
        firmware: whose rules decide which poses are taken.
        mavsdk_port: UDP port of this machine, to which every datagram is passed on; None passes none.
    """

    def __init__(self, port: int, firmware: Firmware, mavsdk_port: int | None) -> None:
        require_extra("mavlink")
        self.heard = Heard()
        self._port, self._firmware, self._mavsdk_port = port, firmware, mavsdk_port
        self._closing = threading.Event()
        self._thread: threading.Thread | None = None
        decoder: Any = px4_decoder.Px4() if firmware is Firmware.PX4 else ardupilot_decoder.ArduPilot(1)
        self._decode = decoder.odometry

    def open(self) -> None:
        self._closing.clear()
        self._thread = threading.Thread(target=self._run, name="peer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        common = dialect()
        sender, parser = common.MAVLink(None, srcSystem=1, srcComponent=1), common.MAVLink(None)
        parser.robust_parsing = True
        autopilot = _PX4 if self._firmware is Firmware.PX4 else _ARDUPILOT
        client: Any = None
        asked_s = beat_s = float("-inf")
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as onward,
        ):
            own.bind(("127.0.0.1", self._port))
            own.settimeout(0.02)
            while not self._closing.is_set():
                with contextlib.suppress(TimeoutError, ConnectionError):
                    data, client = own.recvfrom(1 << 16)
                    arrived_s = time.monotonic()
                    if self._mavsdk_port is not None:
                        onward.sendto(data, ("127.0.0.1", self._mavsdk_port))
                    for message in parser.parse_buffer(data) or []:
                        self._take(message, arrived_s)
                now_s = time.monotonic()
                if client is not None and now_s - beat_s >= _HEARTBEAT_S:
                    beat_s = now_s
                    beat = common.MAVLink_heartbeat_message(_QUADROTOR, autopilot, 0, 0, _ACTIVE, 3)
                    own.sendto(beat.pack(sender), client)
                if client is not None and now_s - asked_s >= _PERIOD_S:
                    asked_s = now_s
                    question = common.MAVLink_timesync_message(0, time.monotonic_ns())
                    own.sendto(question.pack(sender), client)

    def _take(self, message: Any, arrived_s: float) -> None:
        kind = message.get_type()
        self.heard.counts[kind] += 1
        if kind == "ODOMETRY":
            try:
                sample = self._decode(message)
            except (px4_decoder.Refused, ardupilot_decoder.Refused):
                self.heard.counts["refused"] += 1
            else:
                self.heard.poses.append((arrived_s, message.time_usec / 1e6, sample.reset_counter))
        elif kind == "STATUSTEXT":
            self.heard.texts.append((arrived_s, message.text))
        elif kind == "TIMESYNC" and message.tc1:
            self.heard.answered_s.append(arrived_s - message.ts1 / 1e9)


class MavsdkPeer:
    """MAVSDK, a library of others, in the place of the autopilot: it counts the messages that it reads, by kind.

    Args:
        port: UDP, on this machine.
    """

    def __init__(self, port: int) -> None:
        mavsdk: Any = import_module("mavsdk")
        mavsdk.log_subscribe(lambda *_: True)  # its log is not ours
        kind = mavsdk.ComponentType.AUTOPILOT
        self.counts: Counter[str] = Counter()
        self._mavsdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        self._mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        self._direct: Any = None

    def listen(self, timeout_s: float, has_ended: Callable[[], bool]) -> None:
        """Once the other side has been heard; raises TimeoutError if it is not in time, or has ended."""
        end_s = time.monotonic() + timeout_s
        while not self._mavsdk.get_systems():
            if time.monotonic() > end_s or has_ended():
                raise TimeoutError("MAVSDK heard nobody")
            time.sleep(0.02)
        direct: Any = import_module("mavsdk.plugins.mavlink_direct")
        self._direct = direct.MavlinkDirect(self._mavsdk.get_systems()[0])
        self._direct.subscribe_message("", self._take)

    def _take(self, message: Any, _: Any) -> None:
        is_whole = message.message_name != "ODOMETRY" or "pose_covariance" in json.loads(message.fields_json)
        self.counts[message.message_name if is_whole else "damaged"] += 1

    def close(self) -> None:
        self._mavsdk.destroy()
