"""What a person hears of the autopilot during a flight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.link_watch import LinkWatch
from monoloc.flight.mount_check import MountErrors
from monoloc.mavlink.firmware import Firmware


class Link:
    """An autopilot as the watch sees it."""

    def __init__(self) -> None:
        self.is_alive, self.system = False, 1
        self.firmware: Firmware | None = None
        self.others: frozenset[int] = frozenset()
        self.hears_noise = False
        self.sent: list[Any] = []

    def send(self, message: Any) -> None:
        self.sent.append(message)


class Mount:
    """A comparison that is done."""

    is_done = True

    def __init__(self, tilt_deg: float, yaw_deg: float) -> None:
        self.errors = MountErrors(tilt_deg, tilt_deg, 0.0, yaw_deg)

    def take(self, result: FlightStep) -> None:
        pass


class Watched:
    def __init__(self, tilt_deg: float = 0.0, yaw_deg: float = 0.0) -> None:
        self.link, self.lines = Link(), list[str]()
        made: Any = (self.link, Firmware.PX4, Mount(tilt_deg, yaw_deg))
        self.watch = LinkWatch(*made, lambda now_s, text: self.lines.append(text))

    def until(self, now_s: float) -> list[str]:
        """Lines since the last call."""
        self.watch.idle(now_s)
        said, self.lines[:] = list(self.lines), []
        return said


@pytest.fixture
def watched() -> Watched:
    return Watched()


def test_silence_is_said_after_three_seconds_and_the_return_at_once(watched: Watched) -> None:
    assert watched.until(10.0) == watched.until(12.9) == []
    assert watched.until(13.1) == ["autopilot: no heartbeat"]
    assert watched.until(20.0) == []
    watched.link.is_alive, watched.link.firmware = True, Firmware.PX4
    assert watched.until(20.1) == ["autopilot: heard, system 1"]
    watched.link.is_alive = False
    assert watched.until(60.0) == ["autopilot: no heartbeat"]
    assert watched.link.sent == []


def test_pilot_hears_that_the_flight_has_ended(watched: Watched) -> None:
    watched.watch.close()
    (message,) = watched.link.sent
    assert (message.text, message.severity) == ("monoloc: ended", 4)


def test_noise_in_place_of_an_autopilot_is_said_to_be_the_baud_rates(watched: Watched) -> None:
    watched.link.hears_noise = True
    watched.until(10.0)
    assert watched.until(13.1) == ["autopilot: no heartbeat, but bytes that are no MAVLink: check the baud rate"]


def test_other_firmware_is_said_once_to_the_person_and_to_the_pilot(watched: Watched) -> None:
    watched.link.is_alive, watched.link.firmware = True, Firmware.ARDUPILOT
    lines = watched.until(1.0)
    assert lines[1] == (
        "warning: the autopilot is ArduPilot, which expects poses in another frame than PX4; "
        "set firmware to ardupilot"
    )
    assert watched.until(2.0) == []
    (text,) = watched.link.sent
    assert text.text == "monoloc: set for PX4, not ArduPilot" and text.severity == 4


def test_wrong_mount_and_north_are_said_once() -> None:
    watched = Watched(28.4, -124.0)
    for index in range(3):
        watched.watch.take(result_at(0.1 * index, step_at(np.eye(4))))
    assert watched.lines == [
        "warning: tilt is 28 deg off the autopilot's; correct [mount]",
        "warning: heading is -124 deg off the autopilot's; measure north_deg by --align",
    ]
    assert [text.text for text in watched.link.sent] == [
        "monoloc: tilt is 28 deg off the autopilot's",
        "monoloc: heading is -124 deg off the autopilot's",
    ]


def test_other_autopilots_are_said_once(watched: Watched) -> None:
    watched.link.is_alive = True
    watched.until(1.0)
    watched.link.others = frozenset({7})
    assert watched.until(1.1) == ["another autopilot is heard, system 7: it is ignored"]
    watched.link.others = frozenset({7, 9})
    assert watched.until(1.2) == ["another autopilot is heard, system 9: it is ignored"]
