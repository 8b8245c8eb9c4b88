"""Which frames are localised, with which elapsed time, and who hears of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from mavlink_helpers import step_at
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.flight.flight_inputs import OtherSensors, Starting
from monoloc.flight.flight_loop import Flight, FlightOutput, FlightStep, FlightSummary
from monoloc.geometry import FloatArray
from monoloc.live.frame_source import EndOfStreamError, LiveFrame
from monoloc.localizer import Localizer
from monoloc.odometry.motion import Motion
from monoloc.start import Start
from monoloc.supervision.state import State
from refusals import refuses_data

CAMERA = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
IMAGE = np.zeros((3, 4, 3), np.uint8)
STEP_S = 0.03  # that the localizer takes


@dataclass
class Source:
    """Gives frames: time of capture, time of arrival, number; None is a time without any."""

    frames: list[tuple[float, float, int] | None]
    name: str = "a camera"
    reconnections: int = 0
    clock_s: float = 100.0
    is_frozen: bool = False

    def now_s(self) -> float:
        return self.clock_s

    def next(self, timeout_s: float) -> LiveFrame | None:
        if not self.frames:
            raise EndOfStreamError
        frame = self.frames.pop(0)
        if frame is None:
            self.clock_s += timeout_s
            return None
        captured_s, self.clock_s, sequence = frame
        return LiveFrame(IMAGE if self.is_frozen else IMAGE + np.uint8(sequence), captured_s, sequence)

    def close(self) -> None:
        raise AssertionError("the caller closes it")


@dataclass
class Calls:
    """A localizer that notes what it is given."""

    source: Source
    elapsed_s: list[float] = field(default_factory=list)
    down: list[FloatArray | None] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    motions: list[Motion | None] = field(default_factory=list)
    resets: list[tuple[int, Start | None]] = field(default_factory=list)

    def reset(self, start: Start | None) -> None:
        self.resets.append((len(self.elapsed_s), start))

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        down: FloatArray | None,
        measured_motion: Motion | None,
    ) -> Any:
        self.elapsed_s.append(elapsed_s)
        self.down.append(down)
        self.motions.append(measured_motion)
        self.source.clock_s += STEP_S
        return step_at(np.eye(4), self.states.pop(0) if self.states else "tracking")


@dataclass
class Heard:
    """An output that notes what it hears, and may fail at a frame."""

    fails_at: int | None = None
    error: Exception = field(default_factory=lambda: DataError("disk", "is full", "make room"))
    results: list[FlightStep] = field(default_factory=list)
    idle_s: list[float] = field(default_factory=list)

    def take(self, result: FlightStep) -> None:
        self.results.append(result)
        if len(self.results) - 1 == self.fails_at:
            raise self.error

    def idle(self, now_s: float) -> None:
        self.idle_s.append(now_s)

    def close(self) -> None:
        raise AssertionError("the caller closes it")


def fly(
    frames: list[tuple[float, float, int] | None],
    *outputs: Heard,
    sensors: OtherSensors = OtherSensors(),
    stop: Callable[[], bool] = lambda: False,
    camera: Camera = CAMERA,
) -> tuple[FlightSummary, Calls]:
    source = Source(frames)
    localizer, summary = Calls(source), FlightSummary()
    given: list[FlightOutput] = list(outputs)
    known = Starting(Start(np.eye(4)))
    Flight(cast(Localizer, localizer), camera, source, given, 0.2, known, sensors, summary).run(stop)
    return summary, localizer


@pytest.mark.parametrize("begins", ["known", "searching", "waiting"])
def test_a_start_is_looked_for_while_lost_and_at_the_beginning_where_none_is_known(
    begins: Literal["known", "searching", "waiting"],
) -> None:
    """The marker is seen from the third frame on; before, a flight that waits for it localises nothing."""
    source, heard, summary = (
        Source([(100.0 + i / 10, 100.05 + i / 10, i) for i in range(6)]),
        Heard(),
        FlightSummary(),
    )
    lost: list[State] = ["lost", "lost", "tracking", "tracking", "lost", "tracking"]
    localizer = Calls(source, states=lost if begins != "waiting" else lost[2:])
    start, looked = Start(np.eye(4), 0.1, 0.1), 0

    def find(color: NDArray[np.uint8]) -> Start | None:
        nonlocal looked
        looked += 1
        return start if source.clock_s > 100.2 else None

    starting = Starting(start if begins == "known" else None, find, begins)
    flight = (cast(Localizer, localizer), CAMERA, source, [heard], 0.2, starting, OtherSensors(), summary)
    Flight(*flight).run(lambda: False)
    before = 0 if begins == "waiting" else 2
    assert looked == (3 if begins == "known" else 4)  # not at the first frame, where it knows; never while it tracks
    assert localizer.resets == [(before, start), (before + 3, start)]
    assert [result.start for result in heard.results] == [None] * before + [start, None, None, start]
    assert summary.dropped["without start"] == len(heard.idle_s) == (2 if begins == "waiting" else 0)


def test_an_image_that_repeats_is_not_asked_for_a_start() -> None:
    """A marker in a frozen image would begin the flight anew, time and again, where the camera was before."""
    source = Source([(100.0 + i / 10, 100.05 + i / 10, i) for i in range(5)], is_frozen=True)
    localizer, start = Calls(source, states=["lost"] * 5), Start(np.eye(4))
    starting = Starting(None, lambda color: start, "searching")
    flight = (cast(Localizer, localizer), CAMERA, source, [], 0.2, starting, OtherSensors(), FlightSummary())
    Flight(*flight).run(lambda: False)
    assert localizer.resets == [(0, start)] and len(localizer.elapsed_s) == 5


def test_elapsed_time_is_between_times_of_capture_also_across_frames_that_were_not_localised() -> None:
    """One is skipped, one too old, one out of order: the time since the last that was localised goes on."""
    heard = Heard()
    skipped = [(100.0, 100.01, 0), (100.1, 100.15, 1), (100.3, 100.35, 3)]
    dropped = [(100.4, 100.7, 4), (100.25, 100.3, 5)]
    summary, localizer = fly([*skipped, *dropped, (100.75, 100.8, 6)], heard)
    assert localizer.elapsed_s == pytest.approx([0.0, 0.1, 0.2, 0.45])
    assert [result.elapsed_s for result in heard.results] == localizer.elapsed_s
    assert summary.frames == 4 and summary.states == {"tracking": 4}
    assert summary.dropped == {"skipped": 1, "old": 1, "unordered": 1}


def test_images_that_came_while_the_room_was_being_read_are_no_skipped_ones() -> None:
    """They do not say that the computer is slow."""
    assert fly([(100.0, 100.01, 40), (100.1, 100.15, 42)])[0].dropped == {"early": 40, "skipped": 1}


def test_a_result_is_known_when_the_step_is_done_and_its_latency_counts_from_the_capture() -> None:
    heard = Heard()
    summary, _ = fly([(100.0, 100.05, 0), (100.1, 100.19, 1)], heard)
    assert [result.done_s for result in heard.results] == pytest.approx([100.05 + STEP_S, 100.19 + STEP_S])
    assert summary.latencies_s == pytest.approx([0.08, 0.12])
    figures = summary.figures()
    assert figures["rate_hz"] == pytest.approx(10.0) and figures["latency_s_median"] == pytest.approx(0.1)


def test_a_frame_from_the_future_is_dropped_and_the_right_ones_after_it_are_not_out_of_order() -> None:
    """A clock that is wrong for one frame; a few milliseconds ahead are the error of a clock that is right."""
    summary, localizer = fly([(100.0, 100.01, 0), (900.0, 100.1, 1), (100.205, 100.2, 2)])
    assert summary.dropped == {"skipped": 0, "future": 1}
    assert localizer.elapsed_s == pytest.approx([0.0, 0.205])


def test_a_stamp_that_comes_twice_is_out_of_order() -> None:
    summary, localizer = fly([(100.0, 100.0, 0), (100.0, 100.01, 1)])
    assert summary.dropped["unordered"] == 1 and len(localizer.elapsed_s) == 1


def test_outputs_hear_that_no_frame_came_and_that_those_which_came_were_dropped() -> None:
    """Else a watchdog would end a flight whose camera is only slow, and nobody would say why there is no pose."""
    heard = Heard()
    fly([None, (100.1, 100.2, 0), None, (100.0, 100.4, 1), (100.1, 100.5, 2)], heard)
    assert heard.idle_s == pytest.approx([100.1, 100.2 + STEP_S + 0.1, 100.4, 100.5])


def test_gravity_is_asked_for_at_the_time_of_capture() -> None:
    asked: list[float] = []

    def down_at(captured_s: float) -> FloatArray | None:
        asked.append(captured_s)
        return None if captured_s < 100.05 else np.array([0.0, 1.0, captured_s])

    heard = Heard()
    _, localizer = fly([(100.0, 100.05, 0), (100.1, 100.15, 1)], heard, sensors=OtherSensors(down_at))
    assert asked == [100.0, 100.1] and localizer.down[0] is None
    np.testing.assert_array_equal(localizer.down[1], [0.0, 1.0, 100.1])
    assert [result.down_camera for result in heard.results] == localizer.down


def test_motion_is_asked_for_between_the_frames_that_were_localised() -> None:
    """The second frame is too old: the motion since the first one counts."""
    asked, heard = [], Heard()

    def motion_between(start_s: float, end_s: float) -> Motion:
        asked.append((start_s, end_s))
        return Motion.rotation(np.eye(3), end_s - start_s)

    frames = [(100.0, 100.05, 0), (100.1, 100.35, 1), (100.3, 100.4, 2)]
    _, localizer = fly(frames, heard, sensors=OtherSensors(motion_between=motion_between))
    assert asked == [(100.0, 100.3)] and localizer.motions[0] is None and localizer.motions[1] is not None
    assert [result.measured_motion for result in heard.results] == localizer.motions


def test_an_image_of_another_size_is_refused_before_it_is_localised() -> None:
    other = Camera(5, 3, 5.0, 5.0, 1.5, 1.0)
    problem = "gives images of 4x3, but the camera is 5x3"
    refuses_data(lambda: fly([(100.0, 100.0, 0)], camera=other), Path("a camera"), problem, "intrinsics")


def test_it_stops_between_frames() -> None:
    heard = Heard()
    summary, _ = fly([(100.0 + i, 100.0 + i, i) for i in range(5)], heard, stop=lambda: len(heard.results) == 2)
    assert summary.frames == 2


def test_an_output_that_fails_is_left_out_and_the_others_go_on() -> None:
    broken, whole = Heard(fails_at=1), Heard()
    summary, _ = fly([(100.0, 100.0, 0), (100.1, 100.1, 1), None, (100.3, 100.3, 2)], broken, whole)
    assert len(broken.results) == 2 and broken.idle_s == []
    assert len(whole.results) == 3 and len(whole.idle_s) == 1
    assert summary.failures == [broken.error]


def test_a_bug_in_an_output_ends_the_flight() -> None:
    with pytest.raises(ZeroDivisionError):
        fly([(100.0, 100.0, 0)], Heard(fails_at=0, error=ZeroDivisionError()))


def test_summary_of_a_long_flight_keeps_the_last_figures_only() -> None:
    summary = FlightSummary()
    for index in range(10_050):
        frame = LiveFrame(IMAGE, float(index), index)
        summary.add(FlightStep(frame, 1.0, None, step_at(np.eye(4)), index + (0.5 if index < 50 else 0.1)))
    assert len(summary.latencies_s) == len(summary.intervals_s) == 10_000
    assert max(summary.latencies_s) == pytest.approx(0.1)
    assert FlightSummary().figures()["rate_hz"] is None
