"""Right recordings of the synthetic room, which tests alter."""

from __future__ import annotations

import pytest

from altered_recordings import turning_path
from monoloc.io.recording import Recording
from monoloc.recording_check.correspondences import Matches, match_corners
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


@pytest.fixture(scope="module")
def room() -> tuple[Recording, Matches]:
    """A recording whose camera turns, and its corners."""
    recording = RoomRecording(Room(), turning_path(60), SMALL_CAMERA)
    return recording, match_corners(recording)


@pytest.fixture(scope="module")
def right() -> RoomRecording:
    """A walk with few frames a second."""
    return RoomRecording(Room(), make_path(24, rate_hz=3.0), SMALL_CAMERA)
