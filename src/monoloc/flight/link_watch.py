"""Says what becomes of the autopilot: whether it is heard, and whether its firmware is the stated one."""

from __future__ import annotations

from collections.abc import Callable

from monoloc.flight.flight_loop import FlightStep
from monoloc.mavlink.autopilot_link import AutopilotLink
from monoloc.mavlink.firmware import Firmware
from monoloc.mavlink.messages import status_text

_SILENT_S = 3.0  # without a heartbeat since the flight began, after which it is said


class LinkWatch:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that says every change of the link once.

    Args:
        link: to the autopilot.
        firmware: that the flight is set up for.
        say: takes the time and a line; :meth:`monoloc.flight.status_output.StatusOutput.say` is one.
    """

    def __init__(self, link: AutopilotLink, firmware: Firmware, say: Callable[[float, str], None]) -> None:
        self._link, self._firmware, self._say = link, firmware, say
        self._began_s: float | None = None
        self._was_alive: bool | None = None
        self._warned: Firmware | None = None
        self._others: frozenset[int] = frozenset()

    def take(self, result: FlightStep) -> None:
        self.idle(result.done_s)

    def idle(self, now_s: float) -> None:
        self._began_s = now_s if self._began_s is None else self._began_s
        self._look_at_heartbeat(now_s)
        self._look_at_firmware(now_s)
        for system in sorted(self._link.others - self._others):
            self._say(now_s, f"another autopilot is heard, system {system}: nothing is taken from it")
        self._others = self._link.others

    def close(self) -> None:
        """Nothing is held."""

    def _look_at_heartbeat(self, now_s: float) -> None:
        assert self._began_s is not None
        is_alive = self._link.is_alive
        if is_alive == self._was_alive or not (is_alive or now_s - self._began_s >= _SILENT_S):
            return
        if is_alive:
            self._say(now_s, f"autopilot: heard, system {self._link.system}")
        else:
            self._say(now_s, "autopilot: no heartbeat")
        self._was_alive = is_alive

    def _look_at_firmware(self, now_s: float) -> None:
        heard = self._link.firmware
        if heard in (None, self._firmware, self._warned):
            return
        assert heard is not None
        self._warned = heard
        told = f"the autopilot is {heard.title}, which takes poses in another frame than {self._firmware.title}"
        self._say(now_s, f"warning: {told}; set firmware to {heard.value}")
        self._link.send(status_text(f"monoloc: set for {self._firmware.title}, not {heard.title}", True))
