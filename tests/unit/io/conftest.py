"""What captures are written from."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from capture_writers import Capture, capture_of
from monoloc.camera import Camera
from synthetic_room import Room, RoomRecording, make_path


@pytest.fixture(scope="session")
def capture() -> Capture:
    """Twelve frames of the synthetic room, whose camera is off-centre; smooth, as video codes detail away."""
    camera = Camera(160, 128, 136.0, 138.0, 75.5, 66.0)
    capture = capture_of(RoomRecording(Room(), make_path(12, rate_hz=5.0), camera), range(12))
    return replace(capture, colors=[np.asarray(cv2.GaussianBlur(each, (0, 0), 2.0)) for each in capture.colors])
