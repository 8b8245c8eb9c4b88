"""Says what becomes of the autopilot: whether it is heard, and whether its firmware is the stated one.

It also tells the pilot of the flight's end. Its messages are in no recording: a flight that was killed has no end.
"""

from __future__ import annotations

from collections.abc import Callable

from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.mount_check import MOST_TILT_DEG, MOST_YAW_DEG, MountCheck
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import status_text

_SILENT_S = 3.0  # without a heartbeat since the flight began, after which it is said


class LinkWatch:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that says every change of the link once.

    Args:
        link: to the autopilot.
        firmware: that the flight is set up for.
        mount: compares attitudes.
        say: takes the time and a line; :meth:`monoloc.flight.status_output.StatusOutput.say` is one.
    """

    def __init__(
        self, link: AutopilotLink, firmware: Firmware, mount: MountCheck, say: Callable[[float, str], None]
    ) -> None:
        self._link, self._firmware, self._mount, self._say = link, firmware, mount, say
        self._has_compared = False
        self._began_s: float | None = None
        self._was_alive: bool | None = None
        self._warned: Firmware | None = None
        self._others: frozenset[int] = frozenset()

    def take(self, result: FlightStep) -> None:
        self._mount.take(result)
        self._look_at_mount(result.done_s)
        self.idle(result.done_s)

    def idle(self, now_s: float) -> None:
        self._began_s = now_s if self._began_s is None else self._began_s
        self._look_at_heartbeat(now_s)
        self._look_at_firmware(now_s)
        for system in sorted(self._link.others - self._others):
            self._say(now_s, f"another autopilot is heard, system {system}: it is ignored")
        self._others = self._link.others

    def close(self) -> None:
        """Tell the pilot that no more poses come, whatever ended the flight."""
        self._link.send(status_text("monoloc: ended", True))

    def _look_at_heartbeat(self, now_s: float) -> None:
        assert self._began_s is not None
        is_alive = self._link.is_alive
        if is_alive == self._was_alive or not (is_alive or now_s - self._began_s >= _SILENT_S):
            return
        if is_alive:
            self._say(now_s, f"autopilot: heard, system {self._link.system}")
        else:
            why = ", but bytes that are no MAVLink: check the baud rate" if self._link.hears_noise else ""
            self._say(now_s, f"autopilot: no heartbeat{why}")
        self._was_alive = is_alive

    def _look_at_mount(self, now_s: float) -> None:
        errors = self._mount.errors if self._mount.is_done and not self._has_compared else None
        if errors is None:
            return
        self._has_compared = True
        if errors.tilt_deg > MOST_TILT_DEG:
            self._warn(now_s, f"tilt is {errors.tilt_deg:.0f} deg off the autopilot's", "correct [mount]")
        if abs(errors.yaw_deg) > MOST_YAW_DEG:
            self._warn(
                now_s, f"heading is {errors.yaw_deg:+.0f} deg off the autopilot's", "measure north_deg by --align"
            )

    def _warn(self, now_s: float, problem: str, fix: str) -> None:
        self._say(now_s, f"warning: {problem}; {fix}")
        self._link.send(status_text(f"monoloc: {problem}", True))

    def _look_at_firmware(self, now_s: float) -> None:
        heard = self._link.firmware
        problem = self._firmware.contradiction(heard)
        if heard is None or problem is None or heard is self._warned:
            return
        self._warned = heard
        self._say(now_s, f"warning: the autopilot {problem}; set firmware to {heard.value}")
        self._link.send(status_text(f"monoloc: set for {self._firmware.title}, not {heard.title}", True))
