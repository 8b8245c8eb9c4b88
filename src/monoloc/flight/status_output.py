"""What a person reads during a flight: every change of state, and once a second how it goes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from monoloc.flight.flight_loop import FlightStep, FlightSummary
from monoloc.step_budget import Level
from monoloc.supervision.state import in_words

_PERIOD_S = 1.0
_NO_IMAGE_S = 0.5  # without a frame, after which it is said
_NO_IMAGE = "no image from the camera"
# Why images that come are not localised, by the reason that the summary counts them under.
_WHY = {
    "without start": "waiting for a marker",
    "old": "images come too late: the network is slow, or their time stamps are wrong",
    "future": "images are stamped ahead of the clock",
    "unordered": "images come out of order",
}
_WHY_S = 2.0  # for which such an image explains that none is localised


class StatusOutput:
    """A :class:`~monoloc.flight.flight_loop.FlightOutput` that says lines.

    Args:
        say: takes a line, and does not wait; :meth:`monoloc.flight.line_writer.LineWriter.write` is one.
        says_each_second: whether to say once a second how it goes, beside what changes.
        summary: of the flight, for the counts of dropped frames.
    """

    def __init__(self, say: Callable[[str], None], says_each_second: bool, summary: FlightSummary) -> None:
        self._say, self._says_each_second, self._summary = say, says_each_second, summary
        self._began_s: float | None = None
        self._said: tuple[str, frozenset[object], str | None] = ("", frozenset(), None)
        self._level, self._has_said_standing = Level.FULL, False
        self._problems: list[str] = []  # of rooms of a place, that were said
        self._frame_s = self._printed_s = float("-inf")
        self._frames = self._failures = 0
        self._dropped = Counter[str]()  # as the summary counted at the last look
        self._dropped_s: dict[str, float] = {}  # when each number grew last
        self._missing = ""

    def take(self, result: FlightStep) -> None:
        now_s, step = result.done_s, result.step
        self._begin(now_s)
        self._frame_s = now_s
        if self._missing not in ("", _WHY["without start"]):
            self.say(now_s, "images again")
        self._missing = ""
        if self._said != (step.state, step.reasons, result.room):
            self._said = (step.state, step.reasons, result.room)
            why = in_words(step.reasons)
            self.say(now_s, _state_of(result) + (f": {why}" if why else ""))
        self._say_problems(now_s, [] if result.in_place is None else result.in_place.problems)
        if self._level is not step.level:
            self._level = step.level
            self.say(now_s, f"budget: {step.level.words}")
        if step.standing_share and not self._has_said_standing:
            self._has_said_standing = True
            self.say(now_s, f"{step.standing_share:.0%} of the image stands still: the drone's own, or dirt")
        for failure in self._summary.failures[self._failures :]:
            self._failures += 1
            self.say(now_s, f"no longer written: {failure}")
        self._say_how_it_goes(result)

    def idle(self, now_s: float) -> None:
        self._begin(now_s)
        dropped = self._summary.dropped
        self._dropped_s |= {reason: now_s for reason in _WHY if dropped[reason] > self._dropped[reason]}
        self._dropped = Counter(dropped)
        if now_s - self._frame_s <= _NO_IMAGE_S:
            return
        known = (_WHY[reason] for reason in _WHY if now_s - self._dropped_s.get(reason, -np.inf) < _WHY_S)
        missing = next(known, _NO_IMAGE)
        if missing != self._missing:
            self._missing = missing
            self.say(now_s, missing)

    def say(self, now_s: float, text: str) -> None:
        """Say a line with the time since the flight began."""
        self._begin(now_s)
        assert self._began_s is not None
        self._say(f"{now_s - self._began_s:8.2f} s  {text}")

    def close(self) -> None:
        """Nothing is held."""

    def _begin(self, now_s: float) -> None:
        if self._began_s is None:
            self._began_s = self._frame_s = self._printed_s = now_s
            self._frames = self._summary.frames

    def _say_problems(self, now_s: float, problems: list[str]) -> None:
        for problem in problems:
            if problem not in self._problems:
                self.say(now_s, problem)
        self._problems = problems

    def _say_how_it_goes(self, result: FlightStep) -> None:
        now_s = result.done_s
        if not self._says_each_second or now_s - self._printed_s < _PERIOD_S:
            return
        rate_hz = (self._summary.frames - self._frames) / (now_s - self._printed_s)
        self._printed_s, self._frames = now_s, self._summary.frames
        x, y, z = result.step.estimate.pose[:3, 3]
        old = self._summary.poses["old"]
        self.say(
            now_s,
            f"{_state_of(result)}, x {x:.2f} y {y:.2f} z {z:.2f} m, {rate_hz:.0f} Hz, "
            f"{1e3 * (now_s - result.frame.captured_s):.0f} ms after capture, "
            f"{self._summary.dropped.total()} frames dropped" + (f", {old} poses too old to send" if old else ""),
        )


def _state_of(result: FlightStep) -> str:
    """The state, and in a place the room in whose world the pose is."""
    return result.step.state if result.room is None else f"{result.step.state} in {result.room}"
