"""Figures of kidnaps, unknown starts and edited maps whose outcome is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.evaluation.consistency import Consistency
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.progress import NoProgress
from monoloc.supervision.map_change import ChangedRegion
from monoloc_lab.bench.judged_flight import JudgedFlight
from monoloc_lab.bench.map_edits import EditedFlight, MapEdit
from monoloc_lab.bench.recovery import BEFORE_FRAMES, bench_recovery, recovery_figures
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture

AFTER = 50  # frames, a tenth of a second each


def flight(states: str, errors_m: list[float]) -> JudgedFlight:
    """A flight with states by their first letters; 10 cm off is one standard deviation."""
    names = {"t": "tracking", "u": "uncertain", "l": "lost", "m": "map-changed"}
    position_m = np.array(errors_m)
    nees = (position_m / 0.1) ** 2
    return JudgedFlight(
        times_s=0.1 * np.arange(len(states)),
        states=np.array([names[letter] for letter in states]),
        errors=Consistency(position_m, nees, nees),
        rotation_deg=np.zeros(len(states)),
        in_room=np.ones(len(states), dtype=np.bool_),
        distance_m=np.zeros(len(states)),
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
    figures = recovery_figures([RECOVERED, UNNOTICED, RIGHT_AT_ONCE], [], [])
    assert (figures.kidnaps, figures.starts) == (3, 0) and figures.global_start_rate is None
    assert figures.kidnap_recovery_rate == pytest.approx(2 / 3)
    assert figures.lost_reported_rate == pytest.approx(2 / 3)
    assert figures.wrong_place_rate == pytest.approx(1 / 3)
    assert figures.false_tracking_rate == pytest.approx(21 / (30 + 31 + 50))
    assert figures.recovery_s_median == pytest.approx(2.0)
    assert figures.false_alarm_rate == 0.0


def test_changed_map_counts_as_vouched_for() -> None:
    """Its pose is used, so an error of it is silent; it reports no kidnap."""
    silent = kidnap("m" * AFTER, [1.0] * AFTER)
    figures = recovery_figures([silent], [], [])
    assert figures.false_tracking_rate == figures.wrong_place_rate == 1.0 and figures.lost_reported_rate == 0.0
    assert recovery_figures([kidnap("m" * AFTER, [0.1] * AFTER)], [], []).kidnap_recovery_rate == 1.0


def test_edited_maps_are_counted_by_flights() -> None:
    edited = [EditedFlight(True, False), EditedFlight(True, True), EditedFlight(False, False)]
    figures = recovery_figures([], [], edited)
    assert (figures.map_edits, figures.map_changed_rate) == (3, pytest.approx(2 / 3))
    assert figures.map_changed_false_rate == pytest.approx(1 / 3)
    assert recovery_figures([], [], []).map_changed_rate is None


def test_map_edit_moves_what_is_in_its_box_and_nothing_else() -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    bundle = make_bundle(room_mixture(Room(), 100), recording)
    points = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 2.6]], dtype=np.float32)
    bundle = replace(bundle, landmarks=Landmarks(points, np.zeros((2, 32), np.uint8)))
    edit = MapEdit(np.array([-0.5, -0.5, 1.5]), np.array([0.5, 0.5, 2.5]), np.array([0.5, 0.0, 0.0]))
    edited = edit.of(bundle)
    np.testing.assert_allclose(edited.landmarks.points, [[0.5, 0.0, 2.0], [0.0, 0.0, 2.6]])
    for before, after in ((bundle.original, edited.original), (bundle.adapted, edited.adapted)):
        moved_m = after.means - before.means
        np.testing.assert_allclose(moved_m, edit.holds(before.means)[:, None] * edit.shift_m, atol=1e-12)
    at_new_place = ChangedRegion(np.array([0.8, 0.0, 2.0]), np.array([1.2, 0.3, 2.3]))
    elsewhere = ChangedRegion(np.array([1.1, 0.0, 2.0]), np.array([1.2, 0.3, 2.3]))
    assert edit.overlaps(at_new_place) and not edit.overlaps(elsewhere)


def test_a_second_of_wrong_tracking_is_not_yet_a_wrong_place() -> None:
    short = kidnap("t" * 11 + "l" * 39, [1.0] * AFTER)
    assert recovery_figures([short], [], []).wrong_place_rate == 0.0


def test_false_alarms_are_counted_once_the_start_is_settled() -> None:
    before = "u" * 11 + "t" * 14 + "u" * 5
    figures = recovery_figures([kidnap("t" * AFTER, [0.0] * AFTER, before)], [], [])
    assert figures.false_alarm_rate == pytest.approx(5 / 19)


def test_consistency_is_of_frames_after_the_kidnap_that_are_not_lost() -> None:
    figures = recovery_figures([kidnap("l" * 10 + "u" * 40, [9.0] * 10 + [0.1] * 30 + [0.4] * 10)], [], [])
    assert figures.coverage_95 == pytest.approx(0.75)
    assert figures.coverage_99 == 1.0
    assert figures.nees == pytest.approx((30 * 1.0 + 10 * 16.0) / 40 / 6.0)
    assert figures.recovery_s_median is None and figures.false_tracking_rate is None


def test_starts_that_are_not_supported_count_as_not_found() -> None:
    found = flight("l" * 10 + "t" * 40, [1.0] * 10 + [0.1] * 40)
    assert recovery_figures([], [found, found], []).supports_starts
    figures = recovery_figures([], [found, None], [])
    assert figures.global_start_rate == 0.5 and not figures.supports_starts
    nothing = recovery_figures([], [None], [])
    assert nothing.global_start_rate == 0.0 and nothing.coverage_95 is None and nothing.false_alarm_rate is None


def test_figures_are_given_for_near_and_away_too() -> None:
    """A flight belongs where it begins, a frame where it is."""
    before = "t" * (BEFORE_FRAMES - 5) + "u" * 5
    flown = kidnap("u" * 10 + "t" * 40, [1.0] * 10 + [0.0] * 40, before)
    distance_m = np.array([0.1] * (BEFORE_FRAMES - 5) + [0.4] * 25 + [0.1] * 30)
    figures = recovery_figures([replace(flown, distance_m=distance_m)], [], [])
    near, away = figures.near, figures.away
    assert (near.kidnaps, near.kidnap_recovery_rate) == (0, None)
    assert (away.kidnaps, away.kidnap_recovery_rate) == (1, 1.0)
    assert (near.false_alarm_rate, away.false_alarm_rate) == (0.0, 1.0)
    assert near.coverage_95 == 1.0 and away.coverage_95 == 0.5


def test_edits_that_cannot_be_drawn_are_refused_before_the_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kidnaps and starts take minutes."""
    room = Room()
    recording = RoomRecording(room, make_path(80), SMALL_CAMERA)
    recording.timestamps_s *= 4.0
    bundle = make_bundle(room_mixture(room, 20), RoomRecording(room, make_path(3), SMALL_CAMERA))
    for name in ("LEAST_SHARE", "MOST_SHARE"):
        monkeypatch.setattr(f"monoloc_lab.bench.map_edits.{name}", 0.999)
    monkeypatch.setattr("monoloc_lab.bench.recovery._fly_kidnap", lambda *_: pytest.fail("flown"))
    with pytest.raises(DataError, match=r"sees no part of the map .*; give other frames, or --map-edits 0"):
        bench_recovery(bundle, recording, 1, 1, 1, 0, NoProgress())
