"""Times of capture from stamps: never in the future, spaced as the stamps are, and old where a stall made them so."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.live.capture_clock import CaptureClock

FRAME_S = 1.0 / 30.0
SECONDS = st.floats(0.0, 5.0)


@given(
    zero_s=st.floats(-1e9, 1e9),
    frames=st.lists(st.tuples(st.floats(-5.0, 5.0), SECONDS), min_size=1, max_size=50),
)
def test_never_after_its_arrival_whatever_the_stamps(zero_s: float, frames: list[tuple[float, float]]) -> None:
    clock, stamp_s, arrived_s = CaptureClock(), zero_s, 1000.0
    for stamp_gap_s, arrival_gap_s in frames:
        stamp_s, arrived_s = stamp_s + stamp_gap_s, arrived_s + arrival_gap_s
        assert clock.captured_s(stamp_s, arrived_s) <= arrived_s


@given(zero_s=st.floats(-1e6, 1e6), jitters_s=st.lists(st.floats(0.0, 0.4), min_size=1, max_size=60))
def test_with_a_constant_latency_and_jitter_the_intervals_are_those_of_the_stamps(
    zero_s: float, jitters_s: list[float]
) -> None:
    clock = CaptureClock()
    stamps_s = zero_s + FRAME_S * np.arange(len(jitters_s) + 1)
    arrivals_s = 50.0 + FRAME_S * np.arange(len(stamps_s)) + 0.1 + np.array([0.0, *jitters_s])
    captured_s = [
        clock.captured_s(stamp, arrived)
        for stamp, arrived in zip(stamps_s, np.maximum.accumulate(arrivals_s), strict=True)
    ]
    assert np.diff(captured_s) == pytest.approx(np.diff(stamps_s), abs=1e-6)
    assert captured_s[0] == pytest.approx(arrivals_s[0], abs=1e-6)


def test_frames_that_a_stall_of_the_network_held_back_are_as_old_as_they_are() -> None:
    """Three seconds of nothing, then all of it at once: each frame keeps its time, the last one is fresh."""
    clock = CaptureClock()
    for index in range(30):
        clock.captured_s(index * FRAME_S, 100.0 + index * FRAME_S)
    ages_s = [103.0 + FRAME_S * 30 - clock.captured_s(i * FRAME_S, 103.0 + FRAME_S * 30) for i in range(30, 121)]
    assert ages_s[0] == pytest.approx(3.0, abs=1e-9) and ages_s[-1] == pytest.approx(0.0, abs=1e-9)
    assert -np.diff(ages_s) == pytest.approx(FRAME_S)


@pytest.mark.parametrize("restart_s", [0.0, -1e6, 17.0])
def test_a_stream_that_begins_anew_is_believed_at_once(restart_s: float) -> None:
    clock = CaptureClock()
    for index in range(600):
        clock.captured_s(30.0 + index * FRAME_S, 100.0 + index * FRAME_S)
    for index in range(10):
        arrived_s = 125.0 + index * FRAME_S
        assert clock.captured_s(restart_s + index * FRAME_S, arrived_s) == pytest.approx(arrived_s, abs=1e-6)


def test_a_clock_that_jumps_ahead_is_believed_at_once_and_a_frame_out_of_order_changes_nothing() -> None:
    clock = CaptureClock()
    assert clock.captured_s(10.0, 100.0) == 100.0
    assert clock.captured_s(3610.0, 100.5) == 100.5
    assert clock.captured_s(3610.1, 100.7) == pytest.approx(100.6)
    assert clock.captured_s(3610.05, 100.71) == pytest.approx(100.55)


@pytest.mark.parametrize("drift", [1e-4, -1e-4])
def test_a_clock_that_drifts_is_followed_within_two_milliseconds(drift: float) -> None:
    """A hundred millionths, as cheap quartz drifts, over ten minutes, with frames that come up to 30 ms late."""
    clock, rng = CaptureClock(), np.random.default_rng(0)
    captures_s = FRAME_S * np.arange(18_000)
    errors_s = []
    for true_s in captures_s:
        captured_s = clock.captured_s(true_s * (1.0 + drift) + 5.0, true_s + rng.uniform(0.0, 0.03))
        errors_s.append(captured_s - true_s)
    assert np.abs(errors_s[300:]).max() < 0.0025
