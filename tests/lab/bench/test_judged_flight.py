"""What counts as found, far or silent, and arithmetic of times, with a localizer whose answers are given."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from monoloc.geometry import FloatArray, se3_exp
from monoloc_lab.bench.judged_flight import (
    REFUSED,
    FlightFrame,
    JudgedFlight,
    fly,
    longest_run_s,
    pooled,
    seconds_until,
    share,
)

IMAGE = np.zeros((2, 2, 3), dtype=np.uint8)
SD_M, SD_RAD = 0.1, 0.05


class Stub:
    """Gives the identity as every pose, with given states; refuses times that run backwards."""

    def __init__(self, states: list[str], sd_m: float = SD_M) -> None:
        self._states = iter(states)
        self._covariance = np.diag([sd_m**2] * 3 + [SD_RAD**2] * 3)
        self.elapsed_s: list[float] = []

    def step(self, color: np.ndarray, elapsed_s: float) -> SimpleNamespace:
        if elapsed_s < 0.0:
            raise ValueError("time runs backwards")
        self.elapsed_s.append(elapsed_s)
        estimate = SimpleNamespace(pose=np.eye(4), covariance=self._covariance)
        return SimpleNamespace(estimate=estimate, state=next(self._states))


def frames_off(offsets_m: list[float | None], turned_deg: float = 0.0) -> list[FlightFrame]:
    """Frames a tenth of a second apart, whose true position is so far off; None is in another room."""

    def truth(offset_m: float) -> FloatArray:
        return se3_exp([offset_m, 0.0, 0.0, 0.0, 0.0, 0.0]) @ se3_exp([0, 0, 0, np.deg2rad(turned_deg), 0, 0])

    return [
        FlightFrame(lambda: IMAGE, 0.1 * index, None if offset is None else truth(offset))
        for index, offset in enumerate(offsets_m)
    ]


def flown(offsets_m: list[float | None], states: str, sd_m: float = SD_M, turned_deg: float = 0.0) -> JudgedFlight:
    """A flight with states by their first letters."""
    names = {"t": "tracking", "u": "uncertain", "l": "lost"}
    return fly(Stub([names[letter] for letter in states], sd_m), frames_off(offsets_m, turned_deg))


def test_silent_frames_are_tracking_and_far_off_or_outside_their_covariance() -> None:
    wide = flown([0.0, 0.29, 0.31, 0.31, 0.31], "tttul")
    np.testing.assert_array_equal(wide.is_far, [False, False, True, False, False])
    np.testing.assert_array_equal(wide.is_silent, wide.is_far)
    narrow = flown([0.0, 0.04, 0.045, 0.045], "tttu", sd_m=0.01)  # chi-squared 16 and 20.25, limit 17.9
    np.testing.assert_array_equal(narrow.is_far, [False] * 4)
    np.testing.assert_array_equal(narrow.is_silent, [False, False, True, False])


def test_every_tracking_frame_of_another_room_is_silent_and_none_is_found() -> None:
    flight = flown([None, None, None, 0.0], "tult")
    np.testing.assert_array_equal(flight.is_silent, [True, False, False, False])
    np.testing.assert_array_equal(flight.is_near, [False, False, False, True])
    assert len(flight.not_lost.pose_nees) == 1


def test_found_frames_are_tracking_and_within_both_bounds() -> None:
    np.testing.assert_array_equal(flown([0.0, 0.19, 0.21, 0.0], "tttu").is_found, [True, True, False, False])
    assert flown([0.0], "t", turned_deg=9.0).is_found.all()
    assert not flown([0.0], "t", turned_deg=11.0).is_found.any()


def test_errors_of_lost_frames_do_not_count_as_covered_or_not() -> None:
    flight = flown([0.0, 5.0, 0.1], "tlu")
    assert flight.not_lost.coverage_95 == 1.0
    np.testing.assert_allclose(flight.not_lost.pose_nees, [0.0, 1.0], atol=1e-9)


def test_refused_frames_are_known_as_such_and_time_goes_on_from_the_last_one_taken_in() -> None:
    stub, frames = Stub(["tracking", "lost"]), frames_off([0.0, 0.0, 0.0])
    frames[1] = FlightFrame(frames[1].image, 0.1, frames[1].truth, stated_elapsed_s=-0.1)
    flight = fly(stub, frames)
    assert flight.states.tolist() == ["tracking", REFUSED, "lost"]
    np.testing.assert_allclose(stub.elapsed_s, [0.0, 0.2])
    assert np.isnan(flight.errors.position_m[1]) and not flight.is_silent[1]
    assert len(flight.not_lost.pose_nees) == 1


def test_times_count_from_the_first_frame_of_a_part() -> None:
    after = flown([0.0, 0.0, 1.0, 1.0, 0.0], "tttlt").part(slice(2, None))
    assert seconds_until(after, ~after.is_tracking) == pytest.approx(0.1)
    assert seconds_until(after, after.is_found) == pytest.approx(0.2)
    assert seconds_until(after, after.states == "uncertain") is None


def test_longest_run_is_measured_from_its_first_to_its_last_frame() -> None:
    flight = flown([0.0] * 9, "tttttttut")
    assert longest_run_s(flight, np.array([1, 1, 0, 1, 1, 1, 0, 1, 1], dtype=np.bool_)) == pytest.approx(0.2)
    assert longest_run_s(flight, np.ones(9, dtype=np.bool_)) == pytest.approx(0.8)
    assert longest_run_s(flight, np.zeros(9, dtype=np.bool_)) == 0.0


def test_pooled_flights_keep_all_frames() -> None:
    together = pooled([flown([0.0, 1.0], "tt"), flown([None], "l")])
    assert len(together) == 3
    np.testing.assert_array_equal(together.is_silent, [False, True, False])
    assert share(together.is_silent) == pytest.approx(1 / 3)
    assert share(together.is_silent[:0]) is None
