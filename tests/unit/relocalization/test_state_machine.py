"""When a lost camera is searched for, and when a found one is believed; the search's answers are given."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import pytest

from monoloc.geometry import make_pose, transform
from monoloc.landmarks.influential_corners import sd_without_influential_corners
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, uniform_scan
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization import state_machine
from monoloc.relocalization.state_machine import (
    SUSPECTED,
    TRANSITIONS,
    Doubt,
    Event,
    Mode,
    Relocalization,
    RelocalizationStateMachine,
)
from particle_helpers import particles_at

THRESHOLDS = LikelihoodThresholds(low=1.0, lost=0.0)
FITS, DOUBTFUL, MISFIT = 2.0, 0.5, -1.0
SCAN = uniform_scan(np.ones((20, 3), dtype=np.float32))
HERE_M, ELSEWHERE_M = 0.0, 5.0  # places along x; belief and particles are here
PERIOD_S = 1.0  # between searches by scans
KNOWN_SD_M, UNKNOWN_SD_M = 0.1, 0.6  # of the belief's position
BELIEVED, WRONG = 0.1, 0.9  # probabilities of a wrong belief
CORNERS = np.random.default_rng(0).uniform((-1.0, -1.0, 1.0), (1.0, 1.0, 3.0), (30, 3))  # in the camera's frame


def estimate_at(x_m: float, sd_m: float = KNOWN_SD_M) -> Estimate:
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
    """Gives one landmark pose, so certain without its most influential corners, whenever it is asked."""

    def __init__(self, x_m: float | None = None, sd_m: float = 0.02) -> None:
        self.x_m, self.sd_m, self.calls = x_m, sd_m, 0

    def __call__(self) -> LandmarkPose | None:
        self.calls += 1
        if self.x_m is None:
            return None
        pose = estimate_at(self.x_m).pose
        place = LandmarkPose(pose, 1e-6 * np.eye(6), transform(pose, CORNERS))
        wider = (self.sd_m / sd_without_influential_corners(place)) ** 2
        return replace(place, covariance=wider * place.covariance)


def machine_with(
    *answers: tuple[float, float],
    mode: Mode = Mode.SEARCHING,
    searches_by_scan: bool = True,
    searches_by_landmarks: bool = True,
) -> RelocalizationStateMachine:
    relocalizer = _Relocalizer(*answers)
    return RelocalizationStateMachine(relocalizer, searches_by_scan, searches_by_landmarks, THRESHOLDS, mode)


class After(NamedTuple):
    """What a frame left: the mode, the particles' mean place, by what the belief begins anew or what it awaits."""

    mode: Mode
    x_m: Any
    by_landmarks: bool = False
    confirmed: bool = False
    awaits_landmarks: bool = False


def update(
    machine: RelocalizationStateMachine,
    x_m: float = HERE_M,
    scan: Scan = SCAN,
    elapsed_s: float = PERIOD_S,
    probability_wrong: float = BELIEVED,
    sd_m: float = KNOWN_SD_M,
    landmarks: _Landmarks | None = None,
    doubt: Doubt = "none",
) -> After:
    """After a frame whose particles and belief were at ``x_m``; its image says nothing, so that scans search."""
    rng = np.random.default_rng(0)
    particles, belief = copies_of(estimate_at(x_m)), estimate_at(x_m, sd_m)
    result = machine.update(particles, belief, scan, elapsed_s, probability_wrong, doubt, landmarks, rng)
    assert isinstance(result, Relocalization) and len(result.particles) == 10 and result.mode is machine.mode
    by_landmarks = result.landmark_pose is not None
    assert not by_landmarks or result.landmark_pose.pose[0, 3] == landmarks.x_m
    x_m = pytest.approx(result.particles.poses[:, 0, 3].mean())
    return After(result.mode, x_m, by_landmarks, result.confirmed, result.awaits_landmarks)


# --- The table of transitions ---


@dataclass(frozen=True)
class Frame:
    """What a frame brings: the place and fit of a search by its scan, landmarks (None: the image says nothing), and
    what is known of the belief.
    """

    place_m: float = HERE_M
    value: float = FITS
    landmarks_m: float | None = None
    has_scan: bool = True
    sd_m: float = KNOWN_SD_M
    probability_wrong: float = BELIEVED


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


def after_frame(mode: Mode, frame: Frame, transitions: _RecordedTransitions) -> After:
    """Of a machine that its own events brought to a mode; each frame takes a second. Only the last is recorded."""
    relocalizer = _Relocalizer((HERE_M, FITS))
    first = Mode.TRACKING if mode is Mode.TRACKING else Mode.SEARCHING
    machine = RelocalizationStateMachine(relocalizer, True, True, THRESHOLDS, first)
    if mode is Mode.VERIFYING:
        update(machine)
    assert machine.mode is mode
    transitions.looked_up.clear()
    relocalizer.remaining = [(frame.place_m, frame.value)]
    return update(
        machine,
        scan=SCAN if frame.has_scan else EMPTY_SCAN,
        probability_wrong=frame.probability_wrong,
        sd_m=frame.sd_m,
        landmarks=None if frame.landmarks_m is None else _Landmarks(frame.landmarks_m),
    )


# In TRACKING, a search takes place only where the belief is probably wrong.
DOUBTED = {"probability_wrong": SUSPECTED}
BLIND_AND_UNKNOWN = Frame(sd_m=UNKNOWN_SD_M, has_scan=False)
PROVOCATIONS: dict[tuple[Mode, Event], list[Frame]] = {
    (Mode.TRACKING, Event.POSITION_LOST): [BLIND_AND_UNKNOWN],
    (Mode.TRACKING, Event.LANDMARKS_FOUND): [Frame(landmarks_m=ELSEWHERE_M, **DOUBTED)],
    (Mode.TRACKING, Event.NOT_FOUND): [Frame(value=MISFIT, **DOUBTED)],
    (Mode.TRACKING, Event.FOUND): [
        Frame(place_m=ELSEWHERE_M, **DOUBTED),
        Frame(place_m=HERE_M, **DOUBTED),
        Frame(place_m=HERE_M, value=DOUBTFUL, **DOUBTED),
    ],
    (Mode.SEARCHING, Event.POSITION_LOST): [BLIND_AND_UNKNOWN],
    (Mode.SEARCHING, Event.LANDMARKS_FOUND): [Frame(landmarks_m=HERE_M), Frame(landmarks_m=ELSEWHERE_M)],
    (Mode.SEARCHING, Event.NOT_FOUND): [Frame(value=MISFIT)],
    (Mode.SEARCHING, Event.FOUND): [Frame(), Frame(value=DOUBTFUL)],
    (Mode.VERIFYING, Event.POSITION_LOST): [BLIND_AND_UNKNOWN],
    (Mode.VERIFYING, Event.LANDMARKS_FOUND): [Frame(landmarks_m=HERE_M), Frame(landmarks_m=ELSEWHERE_M)],
    (Mode.VERIFYING, Event.NOT_FOUND): [Frame(value=MISFIT)],
    (Mode.VERIFYING, Event.FOUND): [Frame(place_m=ELSEWHERE_M)],
    (Mode.VERIFYING, Event.UNDECIDED): [Frame(value=DOUBTFUL)],
    (Mode.VERIFYING, Event.CONFIRMED): [Frame()],
}


@pytest.mark.parametrize(
    ("pair", "frame"), [(pair, frame) for pair in TRANSITIONS for frame in PROVOCATIONS.get(pair, [None])]
)
def test_every_transition_of_the_table_happens(
    transitions: _RecordedTransitions, pair: tuple[Mode, Event], frame: Frame
) -> None:
    after = after_frame(pair[0], frame, transitions)
    assert transitions.looked_up == [pair]
    assert after.mode is TRANSITIONS[pair]
    assert after.by_landmarks == (pair[1] is Event.LANDMARKS_FOUND)
    assert after.confirmed == (pair[1] is Event.CONFIRMED)


def all_frames() -> Iterator[Frame]:
    return (
        Frame(*values)
        for values in product(
            (HERE_M, ELSEWHERE_M),
            (FITS, DOUBTFUL, MISFIT),
            (None, HERE_M, ELSEWHERE_M),
            (True, False),
            (KNOWN_SD_M, UNKNOWN_SD_M),
            (BELIEVED, WRONG),
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
        (Mode.TRACKING, Event.CONFIRMED),
        (Mode.SEARCHING, Event.UNDECIDED),
        (Mode.SEARCHING, Event.CONFIRMED),
    }


# --- Over several frames ---


def test_place_found_twice_is_believed_after_a_second() -> None:
    machine = machine_with((3.0, FITS), (3.1, FITS))
    assert update(machine, 0.0) == After(Mode.VERIFYING, 3.0)
    assert update(machine, 3.2, elapsed_s=0.5) == After(Mode.VERIFYING, 3.2)  # no search is due
    assert update(machine, 3.2, elapsed_s=0.5) == After(Mode.TRACKING, 3.2, confirmed=True)


def test_place_found_elsewhere_is_verified_anew() -> None:
    machine = machine_with((3.0, FITS), (5.0, FITS), (5.0, FITS))
    assert update(machine, 0.0) == After(Mode.VERIFYING, 3.0)
    assert update(machine, 3.0) == After(Mode.VERIFYING, 5.0)
    assert update(machine, 5.0) == After(Mode.TRACKING, 5.0, confirmed=True)


def test_doubtful_place_is_followed_until_it_fits_or_does_not() -> None:
    machine = machine_with((3.0, MISFIT), (3.0, DOUBTFUL), (3.0, DOUBTFUL), (3.0, MISFIT), (3.0, DOUBTFUL))
    assert update(machine, 0.0) == After(Mode.SEARCHING, 0.0)
    assert update(machine, 0.0) == After(Mode.VERIFYING, 3.0)
    assert update(machine, 3.1) == After(Mode.VERIFYING, 3.1)
    assert update(machine, 3.1) == After(Mode.SEARCHING, 3.1)
    assert update(machine, 2.0) == After(Mode.VERIFYING, 3.0)


def test_search_waits_for_a_scan_with_points() -> None:
    machine = machine_with((3.0, FITS))
    assert update(machine, 0.0, EMPTY_SCAN) == After(Mode.SEARCHING, 0.0)
    assert update(machine, 0.0, elapsed_s=0.0) == After(Mode.VERIFYING, 3.0)


def test_room_that_nothing_searches_keeps_its_belief() -> None:
    """No search could end the search; scans may bring the belief back."""
    machine = machine_with(mode=Mode.TRACKING, searches_by_scan=False, searches_by_landmarks=False)
    assert update(machine, 1.0, sd_m=UNKNOWN_SD_M, probability_wrong=WRONG) == After(Mode.TRACKING, 1.0)


def test_belief_that_is_probably_wrong_is_followed_until_there_is_another() -> None:
    """The relocaliser has no second answer to give: it must not be asked before the belief is suspected."""
    machine = machine_with((3.0, MISFIT), (3.0, FITS), mode=Mode.TRACKING)
    assert update(machine, 0.0, probability_wrong=SUSPECTED - 0.01) == After(Mode.TRACKING, 0.0)
    assert update(machine, 0.0, elapsed_s=0.0, probability_wrong=SUSPECTED) == After(Mode.TRACKING, 0.0)
    assert update(machine, 0.0, elapsed_s=0.9, probability_wrong=SUSPECTED) == After(Mode.TRACKING, 0.0)
    assert update(machine, 0.0, elapsed_s=0.1, probability_wrong=SUSPECTED) == After(Mode.VERIFYING, 3.0)


def test_camera_whose_position_is_lost_is_searched_for_at_once() -> None:
    machine = machine_with((3.0, FITS), mode=Mode.TRACKING)
    assert update(machine, 0.0, elapsed_s=0.0, sd_m=0.49) == After(Mode.TRACKING, 0.0)
    assert update(machine, 0.0, elapsed_s=0.0, sd_m=0.51) == After(Mode.VERIFYING, 3.0)


# --- Landmarks ---


@pytest.mark.parametrize("searches_by_scan", [True, False])
@pytest.mark.parametrize(
    ("mode", "given"),
    [
        (Mode.SEARCHING, {}),
        (Mode.TRACKING, {"probability_wrong": WRONG}),
        (Mode.TRACKING, {"sd_m": UNKNOWN_SD_M}),
    ],
)
def test_landmarks_elsewhere_are_believed_at_once(
    mode: Mode, given: dict[str, float], searches_by_scan: bool
) -> None:
    """The relocaliser by scans has no answer to give: it must not be asked."""
    machine = machine_with(mode=mode, searches_by_scan=searches_by_scan)
    landmarks = _Landmarks(4.0)
    assert update(machine, 0.0, landmarks=landmarks, **given) == After(Mode.TRACKING, 4.0, by_landmarks=True)
    assert landmarks.calls == 1


def test_landmarks_near_a_suspected_belief_are_believed_where_it_would_not_be_measured() -> None:
    """A belief that is surer than it is right is measured only within its covariance, where nothing is found."""
    for sd_m, after in (
        (0.02, After(Mode.TRACKING, 0.28, by_landmarks=True)),
        (0.1, After(Mode.TRACKING, 0.0, awaits_landmarks=True)),
    ):
        machine = machine_with(mode=Mode.TRACKING)
        assert update(machine, 0.0, landmarks=_Landmarks(0.28), probability_wrong=WRONG, sd_m=sd_m) == after


def test_landmarks_find_a_camera_without_depth_but_not_in_an_image_that_says_nothing() -> None:
    machine = machine_with()
    assert update(machine, 0.0, EMPTY_SCAN, landmarks=None) == After(Mode.SEARCHING, 0.0)
    found = After(Mode.TRACKING, 3.0, by_landmarks=True)
    assert update(machine, 0.0, EMPTY_SCAN, landmarks=_Landmarks(3.0)) == found


def test_landmarks_end_a_verification() -> None:
    machine = machine_with((3.0, FITS))
    assert update(machine, 0.0) == After(Mode.VERIFYING, 3.0)
    landmarks = _Landmarks(3.1)
    assert update(machine, 3.0, elapsed_s=0.2, landmarks=landmarks) == After(Mode.TRACKING, 3.1, by_landmarks=True)


def test_landmarks_are_asked_five_times_a_second_and_only_if_a_search_is_due() -> None:
    landmarks, machine = _Landmarks(None), machine_with(mode=Mode.SEARCHING, searches_by_scan=False)
    for _ in range(20):
        update(machine, elapsed_s=0.1, landmarks=landmarks)
    assert landmarks.calls in (10, 11)
    landmarks, machine = _Landmarks(ELSEWHERE_M), machine_with(mode=Mode.TRACKING)
    assert update(machine, landmarks=landmarks) == After(Mode.TRACKING, HERE_M)
    assert landmarks.calls == 0


@pytest.mark.parametrize("mode", [Mode.SEARCHING, Mode.TRACKING])
def test_scan_is_not_searched_where_landmarks_could_be_seen(mode: Mode) -> None:
    """The relocaliser has no answer to give: it must not be asked."""
    machine = machine_with(mode=mode)
    after = update(machine, 0.0, landmarks=_Landmarks(None), probability_wrong=WRONG)
    assert after == After(mode, 0.0, awaits_landmarks=True)


def test_scan_is_searched_in_a_room_without_landmarks_and_in_an_image_that_says_nothing() -> None:
    without = machine_with((3.0, FITS), searches_by_landmarks=False)
    assert update(without, 0.0, landmarks=_Landmarks(None)) == After(Mode.VERIFYING, 3.0)
    assert update(machine_with((3.0, FITS)), 0.0, landmarks=None) == After(Mode.VERIFYING, 3.0)


def test_only_landmarks_search_a_room_whose_places_scans_cannot_tell_apart() -> None:
    machine = machine_with(searches_by_scan=False)
    assert update(machine, 0.0, landmarks=_Landmarks(None)) == After(Mode.SEARCHING, 0.0, awaits_landmarks=True)
    assert update(machine, 0.0, landmarks=_Landmarks(3.0)) == After(Mode.TRACKING, 3.0, by_landmarks=True)


@pytest.mark.parametrize(("x_m", "begins_anew"), [(0.29, False), (0.31, True)])
def test_suspected_belief_goes_on_where_landmarks_find_the_camera_there(x_m: float, begins_anew: bool) -> None:
    """Nor is a scan searched, which could say otherwise."""
    machine = machine_with(mode=Mode.TRACKING)
    after = update(machine, 0.0, probability_wrong=WRONG, landmarks=_Landmarks(x_m))
    expected_m = x_m if begins_anew else 0.0
    assert after == After(Mode.TRACKING, expected_m, by_landmarks=begins_anew, awaits_landmarks=not begins_anew)


@pytest.mark.parametrize(("doubt", "awaits"), [("none", False), ("uncertain", False), ("lost", True)])
def test_lost_camera_awaits_landmarks_however_probable_its_belief(doubt: Doubt, awaits: bool) -> None:
    """A wide belief is lost, though nothing speaks against it."""
    machine = machine_with(mode=Mode.TRACKING)
    after = update(machine, 0.0, landmarks=_Landmarks(None), doubt=doubt)
    assert after == After(Mode.TRACKING, 0.0, awaits_landmarks=awaits)
    for says_nothing in (machine, machine_with(mode=Mode.TRACKING, searches_by_landmarks=False)):
        assert not update(says_nothing, 0.0, landmarks=None, doubt=doubt).awaits_landmarks


# --- A place that rests on a few corners ---


@pytest.mark.parametrize("mode", [Mode.SEARCHING, Mode.TRACKING])
@pytest.mark.parametrize(("sd_m", "searches"), [(0.099, 1), (0.101, 2), (0.299, 2), (0.301, None)])
def test_place_that_rests_on_a_few_corners_must_be_found_twice(mode: Mode, sd_m: float, searches: int | None) -> None:
    """The camera moves on by 0.5 m from search to search, as the belief does. On too few corners, none is enough."""
    machine = machine_with(mode=mode)
    found = [
        update(machine, x_m, landmarks=_Landmarks(4.0 + x_m, sd_m), probability_wrong=WRONG).by_landmarks
        for x_m in (0.0, 0.5)
    ]
    assert found == [searches == 1, searches is not None]
    assert (machine.mode is Mode.TRACKING) == (searches is not None or mode is Mode.TRACKING)


def test_few_corners_that_find_another_place_each_time_leave_the_camera_lost() -> None:
    machine = machine_with(mode=Mode.SEARCHING)
    for x_m in (4.0, 6.0, 4.0, 2.0):
        assert not update(machine, 0.0, landmarks=_Landmarks(x_m, sd_m=0.2)).by_landmarks
    assert machine.mode is Mode.SEARCHING


# --- A belief that is uncertain, but not yet suspected ---


def test_uncertain_belief_is_left_for_a_place_that_two_searches_in_turn_find() -> None:
    """The camera moves on by 0.5 m between them, as the belief does."""
    machine = machine_with(mode=Mode.TRACKING)
    assert update(machine, 0.0, landmarks=_Landmarks(4.0), doubt="uncertain") == After(Mode.TRACKING, 0.0)
    found = update(machine, 0.5, landmarks=_Landmarks(4.5), doubt="uncertain")
    assert found == After(Mode.TRACKING, 4.5, by_landmarks=True)


@pytest.mark.parametrize(
    "between",
    [
        {"landmarks": _Landmarks(7.0), "doubt": "uncertain"},
        {"landmarks": _Landmarks(0.0), "doubt": "uncertain"},
        {"landmarks": _Landmarks(None), "doubt": "uncertain"},
        {"doubt": "none"},
    ],
)
def test_uncertain_belief_stays_where_a_search_between_did_not_find_the_place(between: dict[str, Any]) -> None:
    machine, stays = machine_with(mode=Mode.TRACKING), After(Mode.TRACKING, 0.0)
    assert update(machine, 0.0, landmarks=_Landmarks(4.0), doubt="uncertain") == stays
    assert update(machine, 0.0, **between) == stays
    assert update(machine, 0.0, landmarks=_Landmarks(4.0), doubt="uncertain") == stays


def test_uncertain_belief_is_searched_for_by_landmarks_alone_five_times_a_second() -> None:
    """The relocaliser by scans has no answer to give: it must not be asked."""
    landmarks, machine = _Landmarks(None), machine_with(mode=Mode.TRACKING)
    for _ in range(20):
        assert update(machine, elapsed_s=0.1, landmarks=landmarks, doubt="uncertain") == After(Mode.TRACKING, HERE_M)
    assert landmarks.calls in (10, 11)


def test_suspected_belief_is_left_for_a_place_that_one_search_finds() -> None:
    machine = machine_with(mode=Mode.TRACKING)
    found = update(machine, 0.0, landmarks=_Landmarks(4.0), doubt="uncertain", probability_wrong=SUSPECTED)
    assert found == After(Mode.TRACKING, 4.0, by_landmarks=True)


@pytest.mark.parametrize(
    ("doubt", "probability_wrong", "landmarks", "is_searched"),
    [
        ("none", BELIEVED, _Landmarks(None), False),
        ("uncertain", BELIEVED, _Landmarks(None), True),
        ("uncertain", BELIEVED, None, False),
        ("none", WRONG, _Landmarks(4.0), True),
        ("none", WRONG, None, True),  # by the scan
    ],
)
def test_frame_says_whether_the_room_was_searched(
    doubt: Doubt, probability_wrong: float, landmarks: _Landmarks | None, is_searched: bool
) -> None:
    machine, rng = machine_with((3.0, FITS), mode=Mode.TRACKING), np.random.default_rng(0)
    particles, belief = copies_of(estimate_at(0.0)), estimate_at(0.0)
    result = machine.update(particles, belief, SCAN, PERIOD_S, probability_wrong, doubt, landmarks, rng)
    assert result.is_searched == is_searched
