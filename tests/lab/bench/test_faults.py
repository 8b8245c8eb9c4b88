"""What faults do to frames, and the figures of flights whose outcome is known."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from monoloc.evaluation.consistency import Consistency
from monoloc_lab.bench.fault_flights import (
    AFTER_S,
    BEFORE_S,
    FaultFigures,
    FaultFlight,
    fault_figures,
    totals,
    with_fault,
)
from monoloc_lab.bench.faults import FAULT_S, FAULTS
from monoloc_lab.bench.judged_flight import FlightFrame, JudgedFlight

SIZE = (8, 10)
RATE_HZ = 10


def color(index: int) -> np.ndarray:
    return np.random.default_rng(index).integers(40, 200, (*SIZE, 3), dtype=np.uint8)


ELSEWHERE = np.full((*SIZE, 3), 7, dtype=np.uint8)


def flight_with(name: str) -> tuple[list[FlightFrame], list[FlightFrame], slice]:
    """Frames before a fault is put in, with it, and which are in it."""
    fault = FAULTS[name]
    count = round((BEFORE_S + fault.seconds + AFTER_S) * RATE_HZ) + 1
    clean = [FlightFrame(partial(color, index), index / RATE_HZ, np.eye(4)) for index in range(count)]
    frames, in_fault = with_fault(fault, clean, lambda index: ELSEWHERE + np.uint8(index), np.random.default_rng(0))
    return clean, frames, in_fault


@pytest.mark.parametrize("name", [name for name, f in FAULTS.items() if not f.is_of_whole_flight])
def test_faults_leave_the_frames_before_and_after_them(name: str) -> None:
    clean, frames, in_fault = flight_with(name)
    first, faulty = round(BEFORE_S * RATE_HZ), round(FAULTS[name].seconds * RATE_HZ)
    assert frames[:first] == clean[:first]
    assert frames[in_fault.stop :] == clean[first + faulty :]
    assert in_fault.start == first
    for before, after in zip(clean[first:], frames[in_fault], strict=False):
        assert after.image().shape == (*SIZE, 3) and after.image().dtype == np.uint8
        assert after.time_s == before.time_s


def test_control_changes_nothing() -> None:
    clean, frames, _ = flight_with("none")
    assert frames == clean


def test_images_are_what_the_names_say() -> None:
    changed = {}
    for name in FAULTS:
        _, frames, in_fault = flight_with(name)
        if in_fault.stop > in_fault.start:
            changed[name] = frames[in_fault][1].image()
    at = round(BEFORE_S * RATE_HZ)
    image = color(at + 1)
    assert changed["black"].max() == 0 and changed["saturated"].min() == 255
    assert 0 < changed["covered"].max() < 20 and changed["noise"].std() > 50
    np.testing.assert_array_equal(changed["frozen"], color(at - 1))
    np.testing.assert_array_equal(changed["mirrored"], image[:, ::-1])
    np.testing.assert_array_equal(changed["turned-180"], image[::-1, ::-1])
    np.testing.assert_array_equal(changed["other-room"], ELSEWHERE + 1)
    np.testing.assert_array_equal(changed["half-covered-left"][:, 5:], image[:, 5:])
    np.testing.assert_array_equal(changed["half-covered-right"][:, :5], image[:, :5])
    np.testing.assert_array_equal(changed["half-covered-lower"][:4], image[:4])
    np.testing.assert_array_equal(changed["propeller-guards"][[0, 0, -1, -1], [0, -1, 0, -1]], ELSEWHERE[:4, 0])
    np.testing.assert_array_equal(changed["propeller-guards"][3:5, 4:6], color(1)[3:5, 4:6])
    for side, part in (("left", np.s_[:, :5]), ("right", np.s_[:, 5:]), ("lower", np.s_[4:])):
        assert np.ptp(changed[f"half-covered-{side}"][part]) == 0
    assert np.abs(np.diff(changed["blurred"].astype(float), axis=1)).max() < 40
    assert changed["flickering"].mean() < 0.4 * image.mean()
    assert 5.0 < np.abs(changed["jpeg-quality-10"].astype(float) - image).mean() < 60.0


def test_dropped_frames_are_absent_and_times_run_backwards() -> None:
    clean, frames, in_fault = flight_with("dropped-2s")
    assert in_fault.start == in_fault.stop and len(frames) == len(clean) - 2 * RATE_HZ
    _, frames, in_fault = flight_with("time-backwards")
    np.testing.assert_allclose([frame.stated_elapsed_s for frame in frames[in_fault]], -1.0 / RATE_HZ)
    assert all(frame.truth is None for frame in flight_with("other-room")[1][slice(40, 40 + int(FAULT_S * RATE_HZ))])


def test_wrong_intrinsics_last_all_of_the_flight() -> None:
    clean, frames, in_fault = flight_with("intrinsics-minus-30")
    assert frames == clean and in_fault == slice(0, len(clean))


def part(states: str, errors_m: list[float]) -> JudgedFlight:
    """Frames with states by their first letters, inside their covariances."""
    names = {"t": "tracking", "u": "uncertain", "l": "lost"}
    count = len(states)
    return JudgedFlight(
        times_s=4.0 + np.arange(count) / RATE_HZ,
        states=np.array([names[letter] for letter in states], dtype=np.str_),
        errors=Consistency(np.array(errors_m), np.zeros(count), np.zeros(count)),
        rotation_deg=np.zeros(count),
        in_room=np.ones(count, dtype=np.bool_),
        distance_m=np.zeros(count),
    )


SAID = FaultFlight(part("tt" + "u" * 18, [0.4] * 20), part("ul" + "t" * 8, [0.4, 0.4, 0.4] + [0.1] * 7))
UNSAID = FaultFlight(part("t" * 20, [0.0] * 5 + [1.0] * 15), part("t" * 10, [1.0] * 10))


def test_figures_of_one_flight() -> None:
    figures = fault_figures(FAULTS["black"], [SAID])
    assert figures.during.states == {"tracking": 2, "uncertain": 18}
    assert figures.during.silent_frames == 2 and figures.during.silent_share == 0.1
    assert figures.reported_s == pytest.approx(0.2)
    assert figures.recovery_s == pytest.approx(0.3)  # tracking, but far off, does not count
    assert figures.after.silent_frames == 1
    assert figures.silent_frames_blind == 0
    assert figures.during.coverage_95 == 1.0


def test_what_one_flight_never_says_is_none_over_all() -> None:
    figures = fault_figures(FAULTS["frozen"], [SAID, UNSAID])
    assert figures.reported_s is None and figures.recovery_s is None
    assert figures.during.frames == 40 and figures.during.silent_frames == 17
    assert figures.silent_frames_blind == 9  # later than a second into the fault
    assert fault_figures(FAULTS["noise"], [SAID, UNSAID]).silent_frames_blind == 0


def test_fault_without_frames_has_figures_after_it() -> None:
    empty = SAID.during.part(slice(0, 0))
    figures = fault_figures(FAULTS["dropped-2s"], [FaultFlight(empty, SAID.after)])
    assert figures.during.frames == 0 and figures.during.silent_share is None and figures.during.states == {}
    assert figures.during.coverage_95 is None and figures.reported_s is None


def test_totals_leave_out_the_control() -> None:
    one: FaultFigures = fault_figures(FAULTS["frozen"], [UNSAID])
    total = totals({"none": one, "frozen": one})
    assert total.frames == 30 and total.silent_frames == 25 and total.silent_frames_blind == 9
    assert total.silent_share == pytest.approx(25 / 30)
    assert totals({"none": one}).silent_share is None
