"""Events are used at a rate that holds on average."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray
from monoloc.rate_limiter import RateLimiter


def used_s(times_s: FloatArray, most_hz: float) -> list[float]:
    limiter, used = RateLimiter(most_hz), []
    for time_s in times_s.tolist():
        if limiter.is_due(time_s):
            limiter.use(time_s)
            used.append(time_s)
    return used


@pytest.mark.parametrize(
    ("camera_hz", "most_hz", "jitter_s"),
    [(30.0, 30.0, 0.002), (29.97, 30.0, 0.0005), (60.0, 50.0, 0.001), (30.0, 20.0, 0.002), (30.0, 50.0, 0.005)],
)
def test_the_rate_of_an_uneven_camera_is_kept(camera_hz: float, most_hz: float, jitter_s: float) -> None:
    times_s = np.arange(20.0 * camera_hz) / camera_hz
    times_s += np.random.default_rng(0).normal(0.0, jitter_s, len(times_s))
    assert len(used_s(times_s, most_hz)) / 20.0 == pytest.approx(min(camera_hz, most_hz), rel=0.01)


def test_events_that_meet_the_schedule_are_those_used() -> None:
    np.testing.assert_allclose(used_s(np.arange(41) / 20.0, 5.0), np.arange(11) / 5.0)


@pytest.mark.parametrize("gap_s", [100.0, -3600.0], ids=["gap", "clock set back"])
def test_no_burst_follows_a_gap_or_a_clock_that_was_set_back(gap_s: float) -> None:
    before_s = np.arange(100) / 30.0
    used = used_s(np.concatenate([before_s, before_s[-1] + gap_s + before_s]), 10.0)
    after = [time_s for time_s in used if abs(time_s - before_s[-1] - gap_s) < 5.0]
    assert len(after) == pytest.approx(100 / 3.0, abs=1.0)
    assert np.diff(after).min() > 0.06
