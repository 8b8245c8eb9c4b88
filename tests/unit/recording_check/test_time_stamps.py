"""Times that are not seconds are said to be what they look like."""

from __future__ import annotations

import re

import numpy as np
import pytest

from monoloc.io.recording import Selection, narrowed
from monoloc.recording_check.time_stamps import check_times
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def timed(times_s: np.ndarray) -> RoomRecording:
    recording = RoomRecording(Room(), make_path(len(times_s)), SMALL_CAMERA.resized(32, 26))
    recording.timestamps_s = times_s
    return recording


def test_seconds_are_not_doubted() -> None:
    check = check_times(timed(1700000000.0 + np.arange(20) / 15.0))
    assert check.problem is None and check.rate_hz == pytest.approx(15.0) and check.gaps_s == []


def test_the_rate_is_that_of_the_chosen_frames() -> None:
    every_third = narrowed(timed(np.arange(21) / 15.0), np.arange(0, 21, 3))
    assert check_times(every_third).rate_hz == pytest.approx(5.0)
    one = check_times(narrowed(timed(np.arange(21) / 15.0), np.array([3])))
    assert (one.rate_hz, one.rate_words) == (None, "one frame")


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e3, r"67 s apart: they look like milliseconds; divide them by 1000$"),
        (1e9, r"e\+07 s apart: they look like nanoseconds; divide them by 1000000000$"),
        (1e-3, r"15000 frames a second: they are not seconds; write the times in seconds$"),
    ],
)
def test_other_units_are_certain(factor: float, words: str) -> None:
    check = check_times(timed(factor * np.arange(20) / 15.0))
    said = f"{check.problem}; {check.remedy}"
    assert check.is_certain and re.search(words, said), said


def test_frame_numbers_are_not_certain() -> None:
    check = check_times(timed(np.arange(20.0)))
    assert check.problem == "time stamps are whole numbers, one frame a second: they look like frame numbers"
    assert check.remedy.startswith("divide") and not check.is_certain


def test_selected_frames_one_second_apart_are_no_frame_numbers() -> None:
    assert check_times(Selection(timed(np.arange(60) / 15.0), range(0, 60, 15))).problem is None


def test_rate_of_uneven_frames_is_said_with_its_mean() -> None:
    """A phone's video in dim light: every third interval is double."""
    uneven = check_times(timed(np.cumsum(np.tile([1.0, 1.0, 2.0], 10)) / 15.0))
    assert uneven.gaps_s == [] and uneven.rate_words == "15 Hz, 11.2 on average"
    assert check_times(timed(np.arange(20) / 15.0)).rate_words == "15 Hz"
    assert check_times(timed(np.zeros(1))).rate_words == "one frame"


def test_gaps_are_counted() -> None:
    times = np.arange(20) / 15.0
    times[12:] += 2.0
    check = check_times(timed(times))
    assert check.gaps_s == [pytest.approx(2.0 + 1.0 / 15.0)]


def test_one_frame_has_no_rate() -> None:
    assert check_times(timed(np.zeros(1))).rate_hz is None
