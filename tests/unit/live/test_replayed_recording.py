"""A recording in the place of a camera: at its own pace it drops what a slow reader misses, else it gives all."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.io.recording import Recording
from monoloc.live import replayed_recording
from monoloc.live.frame_source import EndOfStreamError, FrameSource
from monoloc.live.replayed_recording import PacedRecording, UnpacedRecording
from synthetic_room import SMALL_CAMERA


class Numbers:
    """A recording of uneven pace whose images are their numbers."""

    name, camera, poses, has_depth = "numbers", SMALL_CAMERA, None, False

    def __init__(self, *offsets_s: float) -> None:
        self.timestamps_s = 1.7e9 + np.array(offsets_s)
        self.frame_names = [str(index) for index in range(len(offsets_s))]

    def __len__(self) -> int:
        return len(self.timestamps_s)

    def color(self, index: int) -> NDArray[np.uint8]:
        return np.full((1, 1, 3), index, np.uint8)

    def depth(self, index: int) -> NDArray[np.float32]:
        raise AssertionError


class Clock:
    """In the place of ``time``: passes only where a replayed recording sleeps, and no thread of another test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 5000.0
        monkeypatch.setattr(replayed_recording, "time", self)

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        assert duration_s >= 0.0
        self.now_s += duration_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def given_by(source: FrameSource, clock: Clock, work_s: float, timeout_s: float = 1.0) -> list[tuple[int, float]]:
    """Number and time of capture of all frames that a reader is given who works so long on each."""
    given = []
    while True:
        try:
            frame = source.next(timeout_s)
        except EndOfStreamError:
            return given
        if frame is not None:
            assert frame.color[0, 0, 0] == frame.sequence
            assert source.now_s() >= frame.captured_s
            given.append((frame.sequence, frame.captured_s))
            clock.sleep(work_s)


def test_paced_frames_come_at_their_times_and_begin_with_the_first_call(clock: Clock) -> None:
    recording: Recording = Numbers(0.0, 0.125, 0.25, 1.0)
    source = PacedRecording(recording)
    clock.sleep(10.0)  # a bundle is read
    given = given_by(source, clock, 0.0)
    assert [sequence for sequence, _ in given] == [0, 1, 2, 3]
    assert [captured_s for _, captured_s in given] == pytest.approx([5010.0, 5010.125, 5010.25, 5011.0], abs=1e-6)
    assert clock.now_s == pytest.approx(5011.0, abs=1e-6)


def test_a_slow_reader_is_given_the_newest_frame_that_is_due_and_the_others_are_missing_numbers(clock: Clock) -> None:
    source = PacedRecording(Numbers(*np.arange(0.0, 1.0, 0.1)))
    given = given_by(source, clock, 0.25)
    assert [sequence for sequence, _ in given] == [0, 2, 5, 7, 9]
    assert np.diff([captured_s for _, captured_s in given]) == pytest.approx([0.2, 0.3, 0.2, 0.2], abs=1e-6)


def test_a_reader_that_waits_too_short_hears_that_there_is_none_yet(clock: Clock) -> None:
    source = PacedRecording(Numbers(0.0, 0.25))
    assert source.next(0.1) is not None
    assert source.next(0.1) is None and clock.now_s == pytest.approx(5000.1)
    assert source.next(0.1) is None
    frame = source.next(0.1)
    assert frame is not None and frame.captured_s == pytest.approx(5000.25, abs=1e-6)


def test_unpaced_every_frame_is_given_at_once_by_the_recordings_clock(clock: Clock) -> None:
    recording = Numbers(0.0, 0.125, 7.0)
    source = UnpacedRecording(recording)
    given = given_by(source, clock, 100.0)
    assert given == list(enumerate(recording.timestamps_s))
    assert source.now_s() == recording.timestamps_s[-1]  # as though nothing took time
