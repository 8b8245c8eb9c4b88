"""Frames that did not build a bundle, in windows that are continuous in time."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc.geometry import pose_distance_m
from monoloc.io.recording import Selection
from monoloc.progress import NoProgress
from monoloc_lab.bench.recovery import AFTER_S, APART_M, BEFORE_FRAMES, draw_kidnaps, draw_starts
from monoloc_lab.bench.unseen_frames import UnseenFrames
from refusals import refuses
from synthetic_room import CAMERA, FRAME_RATE_HZ, Room, RoomRecording, make_bundle, make_path, room_mixture

GAP = range(120, 160)  # frames that are missing, 2.7 s


@pytest.fixture(scope="module")
def room() -> RoomRecording:
    return RoomRecording(Room(), make_path(400), CAMERA.resized(80, 64))


@pytest.fixture(scope="module")
def frames(room: RoomRecording) -> UnseenFrames:
    """Every third frame of the first 120 built the bundle; frames are missing after them."""
    bundle = make_bundle(room_mixture(Room(), 20), room, range(0, 120, 3))
    positions = [index for index in range(len(room)) if index not in GAP]
    return UnseenFrames(bundle, Selection(room, positions), NoProgress())


def test_segments_skip_build_frames_and_end_at_gaps(frames: UnseenFrames) -> None:
    first, second = frames.segments
    assert first.tolist() == [index for index in range(120) if index % 3]
    assert second.tolist() == list(range(120, 360))
    assert frames.interval_s == pytest.approx(1.0 / FRAME_RATE_HZ)


def test_windows_lie_in_one_segment_and_last_as_long_as_asked(frames: UnseenFrames) -> None:
    windows = frames.windows_lasting(5.0)
    assert len(windows) == len([f for f in range(120) if f % 3 and f + 75 <= 119]) + 240 - 75
    for window in windows:
        flight = frames.flight(window, 3.0)
        times_s = np.array([frame.time_s for frame in flight])
        assert times_s[0] == 3.0 and 7.9 < times_s[-1] <= 8.0 + 1e-6
        assert np.diff(times_s).max() < 0.14
        np.testing.assert_array_equal(flight[-1].truth, frames.poses[window[-1]])
    assert all(len(window) == 50 for window in frames.windows_of(50))
    assert len(frames.windows_of(50)) == (80 - 49) + (240 - 49)


def test_kidnaps_and_starts_are_continuous_far_apart_and_repeat(frames: UnseenFrames) -> None:
    kidnaps = draw_kidnaps(frames, 20, np.random.default_rng(3))
    assert len(kidnaps) == 20
    starts = draw_starts(frames, 5, np.random.default_rng(3))
    unseen = set(np.concatenate(frames.segments).tolist())
    for kidnap in kidnaps:
        assert len(kidnap.before) == BEFORE_FRAMES
        destination = frames.poses[kidnap.after[:1]]
        assert pose_distance_m(frames.poses[kidnap.before[-1]], destination)[0] >= APART_M
    for window in [*(k.before for k in kidnaps), *(k.after for k in kidnaps), *starts]:
        assert set(window.tolist()) <= unseen
        assert np.diff(window).max() <= 2 and not (window[0] < 120 <= window[-1])
    for window in [*(k.after for k in kidnaps), *starts]:
        assert AFTER_S - 0.1 < frames.flight(window)[-1].time_s <= AFTER_S + 1e-6
    again = draw_kidnaps(frames, 20, np.random.default_rng(3))
    assert all(np.array_equal(a.after, b.after) for a, b in zip(kidnaps, again, strict=True))


def test_too_few_unseen_frames_are_refused(room: RoomRecording) -> None:
    bundle = make_bundle(room_mixture(Room(), 20), room, range(0, 100))

    def unseen(frames: range) -> UnseenFrames:
        return UnseenFrames(bundle, Selection(room, frames), NoProgress())

    rng = np.random.default_rng(0)
    refuses(lambda: unseen(range(100)), DataError, "has no consecutive frames that were not used in the build")
    refuses(lambda: draw_starts(unseen(range(130)), 1, rng), DataError, "has no 5 s of unseen frames in a row")
    refuses(lambda: draw_kidnaps(unseen(range(100, 310, 8)), 1, rng), DataError, "has no 30 unseen frames in a row")


def test_no_flights_are_drawn_from_too_few_frames(room: RoomRecording) -> None:
    """Who asks for starts alone needs no frames for kidnaps."""
    bundle = make_bundle(room_mixture(Room(), 20), room, range(0, 100))
    few, rng = UnseenFrames(bundle, Selection(room, range(130)), NoProgress()), np.random.default_rng(0)
    assert draw_kidnaps(few, 0, rng) == [] and draw_starts(few, 0, rng) == []
