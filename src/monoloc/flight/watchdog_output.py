"""Tells systemd that the flight goes on, by its notification socket (sd_notify(3))."""

from __future__ import annotations

import os
import socket

from monoloc.flight.flight_loop import FlightStep, FlightSummary

_PERIOD_S = 0.5


class WatchdogOutput:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that says READY at the first image, and then WATCHDOG.

    A camera that gives no frames does not stop it, since the loop itself goes on and waits for the camera. Nor does
    it end a flight that waits for a marker. Without systemd, where NOTIFY_SOCKET is not set, it does nothing.

    Args:
        summary: of the flight, for the images that were not localised for want of a start.
    """

    def __init__(self, summary: FlightSummary) -> None:
        self._summary = summary
        address = os.environ.get("NOTIFY_SOCKET")
        self._socket = None if not address else socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        if self._socket is not None:
            self._socket.setblocking(False)  # a flight waits for no one
        # A leading @ stands for a NUL: an address without a file.
        self._address = "" if not address else address.replace("@", "\0", 1) if address[0] == "@" else address
        self._said_s = float("-inf")
        self._is_ready = False

    def take(self, result: FlightStep) -> None:
        self._go_on(result.done_s, has_image=True)

    def idle(self, now_s: float) -> None:
        self._go_on(now_s, has_image=self._summary.dropped["without start"] > 0)

    def _go_on(self, now_s: float, has_image: bool) -> None:
        if has_image and not self._is_ready:
            self._is_ready = self._send("READY=1")
        if now_s - self._said_s >= _PERIOD_S:
            self._said_s = now_s
            self._send("WATCHDOG=1")

    def close(self) -> None:
        self._send("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> bool:
        """Whether systemd will hear it: its socket may be full for a while, as when the computer starts."""
        if self._socket is None:
            return False
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:  # without systemd the flight goes on
            return False
        return True
