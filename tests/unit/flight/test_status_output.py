"""What a person reads during a flight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mavlink_helpers import result_at, step_at
from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightSummary
from monoloc.flight.in_place import InPlace
from monoloc.flight.status_output import StatusOutput
from monoloc.geometry import make_pose
from monoloc.step_budget import Level
from monoloc.supervision.state import Reason, State

POSE = make_pose(np.eye(3), [1.0, -2.0, 0.456])


class Flight:
    """An output, and what it printed."""

    def __init__(self, is_terminal: bool = False) -> None:
        self._lines: list[str] = []
        self.summary = FlightSummary()
        self.output = StatusOutput(self._lines.append, is_terminal, self.summary)

    def take(self, done_s: float, state: State = "tracking", *reasons: Reason) -> None:
        result = result_at(done_s - 0.04, step_at(POSE, state, frozenset(reasons)), age_s=0.04)
        self.summary.add(result)
        self.output.take(result)

    def printed(self) -> list[str]:
        lines = self._lines[:]
        self._lines.clear()
        return lines


def test_every_change_of_state_is_said_with_its_reasons_and_its_time() -> None:
    flight = Flight()
    flight.take(100.0, "lost", Reason.SEARCHING)
    flight.take(100.1, "lost", Reason.SEARCHING)
    flight.take(101.25, "lost", Reason.SEARCHING, Reason.IMAGE_EMPTY)
    flight.take(102.5)
    flight.take(104.0)
    assert flight.printed() == [
        "    0.00 s  lost: searching",
        "    1.25 s  lost: image empty, searching",
        "    2.50 s  tracking",
    ]


def test_what_is_left_out_to_keep_the_budget_is_said_as_it_changes() -> None:
    flight = Flight()
    for index, level in enumerate([Level.FULL, Level.FEWER_PARTICLES, Level.FEWER_PARTICLES, Level.FULL]):
        result = result_at(100.0 + index, replace(step_at(POSE), level=level), age_s=0.0)
        flight.output.take(result)
    assert flight.printed()[1:] == ["    1.00 s  budget: fewer particles", "    3.00 s  budget: full"]


def stands(share: float) -> NDArray[np.bool_]:
    return np.arange(1000).reshape(20, 50) < 1000 * share


def test_what_stands_still_in_the_image_is_said_once() -> None:
    flight = Flight()
    for index, share in enumerate([0.0, 0.172, 0.18, 0.0, 0.1]):
        flight.output.take(result_at(100.0 + index, replace(step_at(POSE), standing=stands(share)), age_s=0.0))
    assert flight.printed()[1:] == ["    1.00 s  17% of the image stands still: the drone's own, or dirt"]


def test_a_room_of_a_place_that_cannot_be_read_is_named_once() -> None:
    flight = Flight()
    for index, unreadable in enumerate(
        [{}, {"hall": "disk"}, {"hall": "disk", "study": "gone"}, {}, {"hall": "disk"}]
    ):
        in_place = InPlace("kitchen", None, step_at(POSE).estimate, False, unreadable)
        flight.output.take(replace(result_at(100.0 + index, step_at(POSE), age_s=0.0), in_place=in_place))
    assert flight.printed()[1:] == [
        "    1.00 s  room hall cannot be entered: disk",
        "    2.00 s  room study cannot be entered: gone",
        "    4.00 s  room hall cannot be entered: disk",
    ]


def test_on_a_terminal_it_says_once_a_second_how_it_goes() -> None:
    flight = Flight(is_terminal=True)
    flight.summary.dropped["old"] += 3
    for index in range(26):
        flight.take(100.0 + index * 0.1)
    first, *periods = flight.printed()
    assert first == "    0.00 s  tracking"
    line = "tracking, x 1.00 y -2.00 z 0.46 m, 10 Hz, 40 ms after capture, 3 frames dropped"
    assert periods == [f"    {s}.00 s  {line}" for s in (1, 2)]


@pytest.mark.parametrize(
    ("dropped", "line", "again"),
    [
        ("old", "images come too late: the network is slow, or their time stamps are wrong", True),
        ("future", "images are stamped ahead of the clock", True),
        ("without start", "waiting for a marker", False),
    ],
)
def test_images_that_are_not_taken_are_no_missing_camera(dropped: str, line: str, again: bool) -> None:
    flight = Flight()
    flight.take(100.0)
    for index in range(20):
        flight.summary.dropped[dropped] += index % 2  # between them, none comes for a tenth of a second
        flight.output.idle(100.1 + 0.1 * index)
    flight.take(102.5)
    first, *lines = flight.printed()
    assert first == "    0.00 s  tracking"
    assert lines == [f"    0.60 s  {line}", *(["    2.50 s  images again"] if again else [])]


def test_a_camera_that_is_unplugged_while_its_images_were_late_is_said() -> None:
    flight = Flight()
    flight.take(100.0)
    flight.summary.dropped["old"] += 1
    for index in range(40):
        flight.output.idle(100.1 + 0.1 * index)
    assert [line.split("s  ")[1] for line in flight.printed()[1:]] == [
        "images come too late: the network is slow, or their time stamps are wrong",
        "no image from the camera",
    ]


def test_a_camera_without_images_is_said_once_also_before_the_first_and_that_they_are_back() -> None:
    flight = Flight()
    for index in range(10):
        flight.output.idle(100.0 + 0.1 * index)
    assert flight.printed() == ["    0.60 s  no image from the camera"]
    flight.take(101.5)
    assert flight.printed() == ["    1.50 s  images again", "    1.50 s  tracking"]
    flight.output.idle(101.7)
    flight.take(101.9)
    assert flight.printed() == []
    flight.output.idle(102.5)
    assert flight.printed() == ["    2.50 s  no image from the camera"]


def test_an_output_that_failed_is_said_once() -> None:
    flight = Flight()
    flight.take(100.0)
    flight.summary.failures.append(DataError("poses.csv", "cannot be written", "make room"))
    flight.take(100.1)
    flight.take(100.2)
    assert flight.printed()[1:] == ["    0.10 s  no longer written: poses.csv: cannot be written; make room"]
