"""When a lost camera is searched for, and when a found one is believed; the search's answers are given."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import pytest

from monoloc.geometry import make_pose
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, uniform_scan
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization import state_machine
from monoloc.relocalization.state_machine import (
    TRANSITIONS,
    Event,
    Mode,
    Relocalization,
    RelocalizationStateMachine,
)
from particle_helpers import particles_at

THRESHOLDS = LikelihoodThresholds(low=1.0, lost=0.0)
FITS, DOUBTFUL, MISFIT = 2.0, 0.5, -1.0
SCAN = uniform_scan(np.ones((20, 3), dtype=np.float32))
HERE_M, ELSEWHERE_M = 0.0, 5.0  # places along x; the particles are here
PERIOD_S = 1.0  # between searches


def estimate_at(x_m: float, sd_m: float = 0.1) -> Estimate:
    return Estimate(make_pose(np.eye(3), np.array([x_m, 0.0, 0.0])), np.eye(6) * sd_m**2, 0.0)


def copies_of(place: Estimate, count: int = 10) -> Particles:
    return particles_at(np.repeat(place.pose[None], count, axis=0))


class _Relocalizer:
    """Gives one answer after another: a place along x and the scan's mean log-likelihood there."""

    def __init__(self, *answers: tuple[float, float]) -> None:
        self.remaining = list(answers)

    def relocalize(self, scan: Scan, current: Estimate, rng: np.random.Generator) -> tuple[Estimate, float]:
        x_m, value = self.remaining.pop(0)
        return estimate_at(x_m), value

    def sample_around(self, place: Estimate, count: int, rng: np.random.Generator) -> Particles:
        return copies_of(place, count)


class _Landmarks:
    """Gives one landmark pose whenever it is asked."""

    def __init__(self, x_m: float | None = None) -> None:
        self.x_m, self.calls = x_m, 0

    def __call__(self) -> LandmarkPose | None:
        self.calls += 1
        if self.x_m is None:
            return None
        return LandmarkPose(estimate_at(self.x_m).pose, 1e-6 * np.eye(6), np.zeros((80, 3)))


NO_LANDMARKS = _Landmarks()


def machine_with(*answers: tuple[float, float], mode: Mode = Mode.SEARCHING) -> RelocalizationStateMachine:
    return RelocalizationStateMachine(_Relocalizer(*answers), THRESHOLDS, mode)


def update(
    machine: RelocalizationStateMachine,
    x_m: float = HERE_M,
    scan: Scan = SCAN,
    elapsed_s: float = PERIOD_S,
    position_lost: bool = False,
    landmarks: _Landmarks = NO_LANDMARKS,
) -> tuple[Mode, Any, bool]:
    """The mode after a frame, where its particles, which were at ``x_m``, are then, and whether it relocalised."""
    rng = np.random.default_rng(0)
    result = machine.update(copies_of(estimate_at(x_m)), scan, elapsed_s, position_lost, landmarks, rng)
    assert isinstance(result, Relocalization) and len(result.particles) == 10 and result.mode is machine.mode
    return result.mode, pytest.approx(result.particles.poses[:, 0, 3].mean()), result.relocalized


# --- The table of transitions ---


@dataclass(frozen=True)
class Frame:
    """What a frame brings: the scan's place and fit by a search, landmarks, and how the frame before ended."""

    place_m: float = HERE_M
    value: float = FITS
    landmarks_m: float | None = None
    has_scan: bool = True
    position_lost: bool = False
    previous_value: float = FITS
    previous_sd_m: float = 0.1


class _RecordedTransitions(dict[tuple[Mode, Event], Mode]):
    """The table, which notes what is looked up."""

    def __init__(self) -> None:
        super().__init__(TRANSITIONS)
        self.looked_up: list[tuple[Mode, Event]] = []

    def __getitem__(self, key: tuple[Mode, Event]) -> Mode:
        self.looked_up.append(key)
        return super().__getitem__(key)


@pytest.fixture
def transitions(monkeypatch: pytest.MonkeyPatch) -> _RecordedTransitions:
    recorded = _RecordedTransitions()
    monkeypatch.setattr(state_machine, "TRANSITIONS", recorded)
    return recorded


def after_frame(mode: Mode, frame: Frame, transitions: _RecordedTransitions) -> Relocalization:
    """Of a machine that its own events brought to a mode; each frame takes a second. Only the last is recorded."""
    relocalizer = _Relocalizer((HERE_M, FITS))
    first = Mode.TRACKING if mode is Mode.TRACKING else Mode.SEARCHING
    machine = RelocalizationStateMachine(relocalizer, THRESHOLDS, first)
    if mode is Mode.VERIFYING:
        update(machine)
    assert machine.mode is mode
    transitions.looked_up.clear()
    machine.assess(frame.previous_value, estimate_at(HERE_M, frame.previous_sd_m), PERIOD_S)
    relocalizer.remaining = [(frame.place_m, frame.value)]
    result = machine.update(
        copies_of(estimate_at(HERE_M)),
        SCAN if frame.has_scan else EMPTY_SCAN,
        PERIOD_S,
        frame.position_lost,
        _Landmarks(frame.landmarks_m),
        np.random.default_rng(0),
    )
    assert result.mode is machine.mode
    return result


# In TRACKING, a search takes place only where the scans before did not fit.
SUSPECTED = {"previous_value": MISFIT}
PROVOCATIONS: dict[tuple[Mode, Event], list[Frame]] = {
    (Mode.TRACKING, Event.POSITION_LOST): [
        Frame(position_lost=True, has_scan=False),
        Frame(previous_sd_m=0.6, has_scan=False),
    ],
    (Mode.TRACKING, Event.NOT_FOUND): [Frame(value=MISFIT, **SUSPECTED)],
    (Mode.TRACKING, Event.FOUND): [
        Frame(place_m=ELSEWHERE_M, **SUSPECTED),
        Frame(place_m=HERE_M, **SUSPECTED),
        Frame(landmarks_m=ELSEWHERE_M, **SUSPECTED),
    ],
    (Mode.TRACKING, Event.CONFIRMED): [Frame(landmarks_m=HERE_M, value=MISFIT, **SUSPECTED)],
    (Mode.SEARCHING, Event.POSITION_LOST): [Frame(position_lost=True, has_scan=False)],
    (Mode.SEARCHING, Event.NOT_FOUND): [Frame(value=MISFIT)],
    (Mode.SEARCHING, Event.FOUND): [Frame(), Frame(value=DOUBTFUL), Frame(landmarks_m=HERE_M, value=MISFIT)],
    (Mode.VERIFYING, Event.POSITION_LOST): [Frame(position_lost=True, has_scan=False)],
    (Mode.VERIFYING, Event.NOT_FOUND): [Frame(value=MISFIT)],
    (Mode.VERIFYING, Event.FOUND): [Frame(place_m=ELSEWHERE_M), Frame(landmarks_m=ELSEWHERE_M)],
    (Mode.VERIFYING, Event.UNDECIDED): [Frame(value=DOUBTFUL)],
    (Mode.VERIFYING, Event.CONFIRMED): [Frame(), Frame(landmarks_m=HERE_M, value=MISFIT)],
}


@pytest.mark.parametrize(
    ("pair", "frame"), [(pair, frame) for pair in TRANSITIONS for frame in PROVOCATIONS.get(pair, [None])]
)
def test_every_transition_of_the_table_happens(
    transitions: _RecordedTransitions, pair: tuple[Mode, Event], frame: Frame
) -> None:
    result = after_frame(pair[0], frame, transitions)
    assert transitions.looked_up == [pair]
    assert result.mode is TRANSITIONS[pair]
    assert result.relocalized == (pair == (Mode.VERIFYING, Event.CONFIRMED))


def all_frames() -> Iterator[Frame]:
    return (
        Frame(*values)
        for values in product(
            (HERE_M, ELSEWHERE_M),
            (FITS, DOUBTFUL, MISFIT),
            (None, HERE_M, ELSEWHERE_M),
            (True, False),
            (False, True),
            (FITS, DOUBTFUL, MISFIT, np.nan),
            (0.1, 0.6),
        )
    )


def test_no_other_transition_can_be_provoked(transitions: _RecordedTransitions) -> None:
    """By any frame in any mode; one outside the table would raise a KeyError."""
    provoked: set[tuple[Mode, Event]] = set()
    for mode, frame in product(Mode, all_frames()):
        after_frame(mode, frame, transitions)
        provoked.update(transitions.looked_up)
    assert provoked == set(TRANSITIONS)
    impossible = set(product(Mode, Event)) - set(TRANSITIONS)
    assert impossible == {
        (Mode.TRACKING, Event.UNDECIDED),
        (Mode.SEARCHING, Event.UNDECIDED),
        (Mode.SEARCHING, Event.CONFIRMED),
    }


def test_room_that_cannot_be_searched_is_always_tracking(transitions: _RecordedTransitions) -> None:
    machine = RelocalizationStateMachine(None, THRESHOLDS, Mode.SEARCHING)
    machine.assess(MISFIT, estimate_at(HERE_M, sd_m=5.0), 10.0)
    landmarks = _Landmarks(ELSEWHERE_M)
    assert update(machine, position_lost=True, landmarks=landmarks) == (Mode.TRACKING, HERE_M, False)
    assert landmarks.calls == 0 and transitions.looked_up == []


# --- Over several frames ---


def test_place_found_twice_is_believed_after_a_second() -> None:
    machine = machine_with((3.0, FITS), (3.1, FITS))
    assert update(machine, 0.0) == (Mode.VERIFYING, 3.0, False)
    assert update(machine, 3.2, elapsed_s=0.5) == (Mode.VERIFYING, 3.2, False)  # no search is due
    assert update(machine, 3.2, elapsed_s=0.5) == (Mode.TRACKING, 3.2, True)


def test_place_found_elsewhere_is_verified_anew() -> None:
    machine = machine_with((3.0, FITS), (5.0, FITS), (5.0, FITS))
    assert update(machine, 0.0) == (Mode.VERIFYING, 3.0, False)
    assert update(machine, 3.0) == (Mode.VERIFYING, 5.0, False)
    assert update(machine, 5.0) == (Mode.TRACKING, 5.0, True)


def test_doubtful_place_is_followed_until_it_fits_or_does_not() -> None:
    machine = machine_with((3.0, MISFIT), (3.0, DOUBTFUL), (3.0, DOUBTFUL), (3.0, MISFIT), (3.0, DOUBTFUL))
    assert update(machine, 0.0) == (Mode.SEARCHING, 0.0, False)
    assert update(machine, 0.0) == (Mode.VERIFYING, 3.0, False)
    assert update(machine, 3.1) == (Mode.VERIFYING, 3.1, False)
    assert update(machine, 3.1) == (Mode.SEARCHING, 3.1, False)
    assert update(machine, 2.0) == (Mode.VERIFYING, 3.0, False)


def test_search_waits_for_a_scan_with_points() -> None:
    machine = machine_with((3.0, FITS))
    assert update(machine, 0.0, EMPTY_SCAN) == (Mode.SEARCHING, 0.0, False)
    assert update(machine, 0.0, elapsed_s=0.0) == (Mode.VERIFYING, 3.0, False)


def test_camera_is_suspected_after_scans_have_not_fitted_for_a_second() -> None:
    machine = machine_with((3.0, FITS), mode=Mode.TRACKING)
    for value in (MISFIT, np.nan, MISFIT, DOUBTFUL, MISFIT, MISFIT):  # over a second, but not without interruption
        machine.assess(value, estimate_at(0.0), 0.4)
        assert update(machine, 0.0) == (Mode.TRACKING, 0.0, False)
    machine.assess(MISFIT, estimate_at(0.0), 0.4)
    assert machine.mode is Mode.TRACKING  # the belief is followed until there is another
    assert update(machine, 0.0) == (Mode.VERIFYING, 3.0, False)


def test_camera_whose_position_is_lost_is_searched_for_at_once() -> None:
    machine = machine_with((3.0, FITS), mode=Mode.TRACKING)
    machine.assess(FITS, estimate_at(0.0, sd_m=0.49), 0.1)
    assert machine.mode is Mode.TRACKING
    machine.assess(FITS, estimate_at(0.0, sd_m=0.51), 0.1)
    assert machine.mode is Mode.SEARCHING
    assert update(machine, 0.0, elapsed_s=0.0) == (Mode.VERIFYING, 3.0, False)
    machine = machine_with((3.0, FITS), mode=Mode.TRACKING)
    assert update(machine, 0.0, elapsed_s=0.0, position_lost=True) == (Mode.VERIFYING, 3.0, False)


# --- Landmarks ---


def test_landmarks_are_asked_first_and_only_if_a_search_is_due() -> None:
    """The relocaliser by scans has no answer to give: it must not be asked."""
    machine, landmarks = machine_with(), _Landmarks(4.0)
    assert update(machine, 0.0, landmarks=landmarks) == (Mode.VERIFYING, 4.0, False)
    assert update(machine, 4.2, elapsed_s=0.5, landmarks=landmarks) == (Mode.VERIFYING, 4.2, False)
    assert landmarks.calls == 1
    assert update(machine, 4.2, elapsed_s=0.5, landmarks=landmarks) == (Mode.TRACKING, 4.0, True)


def test_scan_is_searched_where_landmarks_find_nothing() -> None:
    machine = machine_with((3.0, FITS))
    assert update(machine, 0.0, landmarks=_Landmarks(None)) == (Mode.VERIFYING, 3.0, False)


@pytest.mark.parametrize(("x_m", "mode"), [(0.9, Mode.TRACKING), (1.1, Mode.VERIFYING)])
def test_landmarks_confirm_a_suspected_camera_within_a_metre(x_m: float, mode: Mode) -> None:
    """Where depth is biased, no scan fits; particles go on from the landmark pose."""
    machine = machine_with(mode=Mode.TRACKING)
    machine.assess(MISFIT, estimate_at(0.0), 1.0)
    assert update(machine, 0.0, landmarks=_Landmarks(x_m)) == (mode, x_m, False)


def test_confirmation_by_landmarks_ends_the_suspicion() -> None:
    machine = machine_with(mode=Mode.TRACKING)
    machine.assess(MISFIT, estimate_at(0.0), 1.0)
    update(machine, 0.0, landmarks=_Landmarks(0.0))
    landmarks = _Landmarks(0.0)
    machine.assess(MISFIT, estimate_at(0.0), 0.5)
    update(machine, 0.0, landmarks=landmarks)
    assert landmarks.calls == 0
