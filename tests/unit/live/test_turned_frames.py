"""Images of a camera that is mounted upside down are turned; the rest of its source is as it was."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.live.frame_source import EndOfStreamError
from monoloc.live.replayed_recording import PacedRecording, UnpacedRecording
from monoloc.live.turned_frames import TurnedFrames
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


def test_images_are_turned() -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    source, plain = TurnedFrames(UnpacedRecording(recording), 1), UnpacedRecording(recording)
    for index in range(2):
        frame, expected = source.next(1.0), plain.next(1.0)
        assert frame is not None and expected is not None
        np.testing.assert_array_equal(frame.color, np.rot90(recording.color(index)))
        assert (frame.captured_s, frame.sequence) == (expected.captured_s, expected.sequence)
    with pytest.raises(EndOfStreamError):
        source.next(1.0)


def test_nothing_in_time_is_nothing() -> None:
    recording = RoomRecording(Room(), make_path(2), SMALL_CAMERA)
    source = TurnedFrames(PacedRecording(recording), 2)
    assert source.next(0.0) is not None and source.next(0.0) is None
    assert source.name == recording.name and source.reconnections == 0
    source.close()
