"""What a person hears of the autopilot during a flight."""

from __future__ import annotations

from typing import Any

import pytest

from monoloc.flight.link_watch import LinkWatch
from monoloc.mavlink.firmware import Firmware


class Link:
    """An autopilot as the watch sees it."""

    def __init__(self) -> None:
        self.is_alive, self.system = False, 1
        self.firmware: Firmware | None = None
        self.others: frozenset[int] = frozenset()
        self.sent: list[Any] = []

    def send(self, message: Any) -> None:
        self.sent.append(message)


class Watched:
    def __init__(self) -> None:
        self.link, self.lines = Link(), []
        self.watch = LinkWatch(self.link, Firmware.PX4, lambda now_s, text: self.lines.append(text))  # type: ignore[arg-type]

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


def test_other_firmware_is_said_once_to_the_person_and_to_the_pilot(watched: Watched) -> None:
    watched.link.is_alive, watched.link.firmware = True, Firmware.ARDUPILOT
    lines = watched.until(1.0)
    assert lines[1] == (
        "warning: the autopilot is ArduPilot, which takes poses in another frame than PX4; set firmware to ardupilot"
    )
    assert watched.until(2.0) == []
    (text,) = watched.link.sent
    assert text.text == "monoloc: set for PX4, not ArduPilot" and text.severity == 4


def test_other_autopilots_are_said_once(watched: Watched) -> None:
    watched.link.is_alive = True
    watched.until(1.0)
    watched.link.others = frozenset({7})
    assert watched.until(1.1) == ["another autopilot is heard, system 7: nothing is taken from it"]
    watched.link.others = frozenset({7, 9})
    assert watched.until(1.2) == ["another autopilot is heard, system 9: nothing is taken from it"]
