"""Where the map has changed, from which landmarks are found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, se3_exp
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.supervision.integrity import IntegrityModel
from monoloc.supervision.map_change import ChangedRegion, MapChangeMonitor, merged

MODEL = IntegrityModel(familiar_found=0.7, strange_found=0.05)
PLACES = np.array([[-1.5, 0.0, 2.0], [0.0, 0.0, 2.0], [1.5, 0.0, 2.0]])
EACH = 20  # landmarks at a place
RIGHT = np.arange(2 * EACH, 3 * EACH)  # those at the place to the right


def room(found_by_views: float = 1.0) -> Landmarks:
    """Landmarks around three places, all of which three views at the origin found, or a share of them."""
    rng = np.random.default_rng(0)
    points = np.repeat(PLACES, EACH, axis=0) + rng.uniform(-0.15, 0.15, (3 * EACH, 3))
    descriptors = np.zeros((len(points), 32), np.uint8)
    poses = se3_exp(0.01 * np.eye(6)[:3])
    views = LandmarkViews(poses, np.tile(rng.uniform(size=len(points)) < found_by_views, (3, 1)))
    return Landmarks(points.astype(np.float32), descriptors, views)


class Flight:
    """Frames at one pose, in which landmarks are found with a probability, and some are missing."""

    def __init__(self, landmarks: Landmarks, model: IntegrityModel = MODEL) -> None:
        self.monitor = MapChangeMonitor(landmarks, model)
        self._views = landmarks.views
        self._count = len(landmarks)
        self._rng = np.random.default_rng(1)

    def __call__(
        self,
        seconds: float,
        missing: NDArray[np.int64] | None = None,
        rate_hz: float = 15.0,
        share: float = 0.7,
        probability_far: float = 0.0,
        pose: FloatArray = np.eye(4),
        visible: NDArray[np.int64] | None = None,
    ) -> list[ChangedRegion | None]:
        regions = []
        visible = np.arange(self._count) if visible is None else visible
        for _ in range(round(seconds * rate_hz)):
            is_found = self._rng.uniform(size=len(visible)) < share
            if missing is not None:
                is_found &= ~np.isin(visible, missing)
            is_shown = np.ones(len(visible), np.bool_)
            familiar = None if self._views is None else self._views.familiar(pose, visible, is_found, is_shown)
            regions.append(self.monitor.update(familiar, probability_far, pose, 1.0 / rate_hz))
        return regions


def test_region_whose_landmarks_are_missing_is_named() -> None:
    region = Flight(room())(2.0, RIGHT)[-1]
    assert region is not None
    assert np.all(region.lower <= PLACES[2] - 0.1) and np.all(region.upper >= PLACES[2] + 0.1)
    assert np.all(region.size < 0.8) and np.all(np.abs(region.centre - PLACES[2]) < 0.2)


@pytest.mark.parametrize("rate_hz", [5.0, 15.0, 30.0, 120.0])
def test_it_takes_half_a_second_whatever_the_frame_rate(rate_hz: float) -> None:
    """Something that passes by is no change."""
    regions = Flight(room())(2.0, RIGHT, rate_hz)
    first_s = next(index for index, region in enumerate(regions) if region is not None) / rate_hz
    assert 0.35 < first_s < 1.1


def test_a_change_stays_named_in_frames_whose_landmarks_are_left_out() -> None:
    """Under a budget, every second frame has none."""
    flight = Flight(room())
    region = flight(2.0, RIGHT)[-1]
    assert region is not None
    assert flight.monitor.update(None, 0.0, np.eye(4), 0.1, is_left_out=True) is region
    assert flight.monitor.update(None, 0.5, np.eye(4), 0.1, is_left_out=True) is None  # the pose is in doubt
    assert flight.monitor.update(None, 0.0, np.eye(4), 0.1, is_left_out=True) is None
    assert flight(1.0, RIGHT)[-1] is not None
    flight.monitor.forget()
    assert flight.monitor.update(None, 0.0, np.eye(4), 0.1, is_left_out=True) is None


def test_one_frame_after_a_gap_is_no_change() -> None:
    assert Flight(room())(5.0, RIGHT, rate_hz=0.2) == [None]


@pytest.mark.parametrize("share", [0.2, 0.4, 0.7, 0.9])
def test_landmarks_that_are_missing_everywhere_are_no_change(share: float) -> None:
    assert set(Flight(room())(20.0, share=share)) == {None}


def test_unmeasured_rates_views_or_frames_say_nothing() -> None:
    landmarks = room()
    without_views = Landmarks(landmarks.points, landmarks.descriptors)
    silent: list[tuple[Flight, dict[str, Any]]] = [
        (Flight(landmarks, IntegrityModel()), {}),
        (Flight(without_views), {}),
        (Flight(room(found_by_views=0.0)), {}),
        (Flight(landmarks), {"pose": se3_exp([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])}),
        (Flight(landmarks), {"probability_far": 0.05}),
        (Flight(landmarks), {"visible": RIGHT}),  # without any landmark beside them
        (Flight(Landmarks.none()), {}),
    ]
    for flight, given in silent:
        assert set(flight(3.0, RIGHT, **given)) == {None}
        assert flight.monitor.update(None, 0.0, np.eye(4), 0.1) is None


def test_few_missing_landmarks_are_no_change() -> None:
    """However long: what hides one of them hides it for long."""
    visible = np.arange(2 * EACH + 4)  # the place to the right shows four
    assert set(Flight(room())(60.0, RIGHT[:4], visible=visible)) == {None}
    assert Flight(room())(60.0, RIGHT[:8], visible=np.arange(2 * EACH + 8))[-1] is not None


def test_hovering_makes_no_change_of_landmarks_that_are_seldom_found_from_one_view() -> None:
    """Each image finds a fifth of them. From many views it is a change, from one it is one observation."""

    def named(step_m: float) -> bool:
        landmarks, rng, found = room(), np.random.default_rng(2), []
        monitor = MapChangeMonitor(landmarks, MODEL)
        assert landmarks.views is not None
        visible = np.arange(2 * EACH + 8)  # the place to the right shows eight
        for index in range(150):
            is_found = rng.uniform(size=len(visible)) < np.where(np.isin(visible, RIGHT), 0.2, 0.7)
            familiar = landmarks.views.familiar(np.eye(4), visible, is_found, np.ones(len(visible), np.bool_))
            moved = se3_exp([step_m * index, 0.0, 0.0, 0.0, 0.0, 0.0])
            found.append(monitor.update(familiar, 0.0, moved, 1.0 / 15.0))
        return any(region is not None for region in found)

    assert named(0.03) and not named(0.0)


def test_change_while_hovering_is_named_in_seconds() -> None:
    """Landmarks that were found from other views and from this one, and then vanish."""
    flight = Flight(room())
    for x_m in (0.15, 0.3):
        flight(2.0, pose=se3_exp([x_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert set(flight(10.0)) == {None}
    regions = flight(5.0, RIGHT, rate_hz=20.0)
    assert regions[:10] == [None] * 10 and regions[-1] is not None
    assert flight(5.0)[-1] is None, "found again"


def test_change_holds_until_its_landmarks_are_found_again() -> None:
    flight = Flight(room())
    assert flight(2.0, RIGHT)[-1] is not None
    others = np.arange(2 * EACH)
    assert set(flight(5.0, visible=others)) == {None}, "out of view"
    assert flight(0.1, RIGHT)[0] is not None, "in view again"
    assert flight(2.0)[-1] is None


def test_evidence_can_be_dropped() -> None:
    """As of landmarks that a part of the drone hid all along."""
    flight = Flight(room())
    assert flight(2.0, RIGHT)[-1] is not None
    flight.monitor.forget()
    assert set(flight(0.3, RIGHT)) == {None}
    assert flight(2.0, RIGHT)[-1] is not None


def test_evidence_is_forgotten_slowly() -> None:
    flight = Flight(room())
    flight(2.0, RIGHT)
    flight(30.0, visible=np.arange(2 * EACH))
    assert flight(0.1, RIGHT)[0] is not None
    flight(600.0, visible=np.arange(2 * EACH), rate_hz=2.0)
    assert flight(0.1)[0] is None


@pytest.mark.parametrize("elsewhere", [{"pose": se3_exp([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])}, {"probability_far": 0.9}])
def test_evidence_is_forgotten_where_nothing_can_be_seen_of_it(elsewhere: dict[str, Any]) -> None:
    """Far from the build's views, and while the camera is lost."""
    flight = Flight(room())
    assert flight(2.0, RIGHT)[-1] is not None
    flight(600.0, rate_hz=2.0, **elsewhere)
    assert flight(0.1)[0] is None


def test_regions_that_overlap_are_merged_and_the_one_of_most_frames_is_first() -> None:
    def region(lower: float, upper: float) -> ChangedRegion:
        return ChangedRegion(np.full(3, lower), np.full(3, upper))

    found = merged([region(0.0, 1.0), region(5.0, 6.0), region(5.5, 7.0), region(6.5, 8.0), region(1.0, 2.0)])
    assert [(each.lower[0], each.upper[0], frames) for each, frames in found] == [
        (5.0, 8.0, 3),
        (0.0, 1.0, 1),
        (1.0, 2.0, 1),
    ]
    assert merged([]) == []
