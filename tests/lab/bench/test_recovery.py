"""Figures of kidnaps and unknown starts whose outcome is known."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.evaluation.consistency import Consistency
from monoloc_lab.bench.judged_flight import JudgedFlight
from monoloc_lab.bench.recovery import BEFORE_FRAMES, recovery_figures

AFTER = 50  # frames, a tenth of a second each


def flight(states: str, errors_m: list[float]) -> JudgedFlight:
    """A flight with states by their first letters; 10 cm off is one standard deviation."""
    names = {"t": "tracking", "u": "uncertain", "l": "lost"}
    position_m = np.array(errors_m)
    nees = (position_m / 0.1) ** 2
    return JudgedFlight(
        times_s=0.1 * np.arange(len(states)),
        states=np.array([names[letter] for letter in states]),
        errors=Consistency(position_m, nees, nees),
        rotation_deg=np.zeros(len(states)),
        in_room=np.ones(len(states), dtype=np.bool_),
    )


def kidnap(states: str, errors_m: list[float], before: str = "t" * BEFORE_FRAMES) -> JudgedFlight:
    return flight(before + states, [0.0] * BEFORE_FRAMES + errors_m)


# Lost at once, found after 2 s.
RECOVERED = kidnap("l" * 20 + "t" * 30, [1.0] * 20 + [0.0] * 30)
# Goes on for 2 s as if nothing had happened, and is found after 4 s.
UNNOTICED = kidnap("t" * 21 + "l" * 19 + "t" * 10, [1.0] * 40 + [0.0] * 10)
# Right from the first frame on.
RIGHT_AT_ONCE = kidnap("t" * AFTER, [0.0] * AFTER)


def test_kidnaps_count_as_recovered_and_noticed_within_their_times() -> None:
    figures = recovery_figures([RECOVERED, UNNOTICED, RIGHT_AT_ONCE], [])
    assert (figures.kidnaps, figures.starts) == (3, 0) and figures.global_start_rate is None
    assert figures.kidnap_recovery_rate == pytest.approx(2 / 3)
    assert figures.lost_reported_rate == pytest.approx(2 / 3)
    assert figures.wrong_place_rate == pytest.approx(1 / 3)
    assert figures.false_tracking_rate == pytest.approx(21 / (30 + 31 + 50))
    assert figures.recovery_s_median == pytest.approx(2.0)
    assert figures.false_alarm_rate == 0.0


def test_a_second_of_wrong_tracking_is_not_yet_a_wrong_place() -> None:
    short = kidnap("t" * 11 + "l" * 39, [1.0] * AFTER)
    assert recovery_figures([short], []).wrong_place_rate == 0.0


def test_false_alarms_are_counted_once_the_start_is_settled() -> None:
    before = "u" * 11 + "t" * 14 + "u" * 5
    figures = recovery_figures([kidnap("t" * AFTER, [0.0] * AFTER, before)], [])
    assert figures.false_alarm_rate == pytest.approx(5 / 19)


def test_consistency_is_of_frames_after_the_kidnap_that_are_not_lost() -> None:
    figures = recovery_figures([kidnap("l" * 10 + "u" * 40, [9.0] * 10 + [0.1] * 30 + [0.4] * 10)], [])
    assert figures.coverage_95 == pytest.approx(0.75)
    assert figures.coverage_99 == 1.0
    assert figures.nees == pytest.approx((30 * 1.0 + 10 * 16.0) / 40 / 6.0)
    assert figures.recovery_s_median is None and figures.false_tracking_rate is None


def test_starts_that_are_not_supported_count_as_not_found() -> None:
    found = flight("l" * 10 + "t" * 40, [1.0] * 10 + [0.1] * 40)
    assert recovery_figures([], [found, found]).supports_starts
    figures = recovery_figures([], [found, None])
    assert figures.global_start_rate == 0.5 and not figures.supports_starts
    nothing = recovery_figures([], [None])
    assert nothing.global_start_rate == 0.0 and nothing.coverage_95 is None and nothing.false_alarm_rate is None
