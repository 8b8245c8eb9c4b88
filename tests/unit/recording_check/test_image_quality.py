"""Blur and exposure are measured, whatever the images show."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from altered_recordings import Altered
from monoloc.recording_check.image_quality import BLURRED, blur_of, measure_images
from synthetic_room import CAMERA, Room, RoomRecording, make_path


@pytest.fixture(scope="module")
def sharp() -> RoomRecording:
    return RoomRecording(Room(), make_path(3, rate_hz=1.0), CAMERA)


def test_blur_grows_with_the_length_of_the_motion_in_every_direction(sharp: RoomRecording) -> None:
    gray = sharp.color(0)[..., 0]
    for turn in (gray, gray.T):
        blurs = [blur_of(np.asarray(cv2.blur(turn, (length, 1)), np.uint8)) for length in (1, 5, 9, 15)]
        assert blurs == sorted(blurs) and blurs[0] < BLURRED < blurs[-1]
    assert blur_of(np.full((40, 50), 7, np.uint8)) == 1.0


def test_exposure_and_blurred_share(sharp: RoomRecording) -> None:
    images = measure_images(sharp)
    assert images.blurred_share == 0.0 and images.frames.tolist() == [0, 1, 2]
    dark = measure_images(Altered(sharp, color=lambda image: image // 16))
    assert (dark.brightness < 16).all() and (dark.dark > 0.95).all() and (dark.saturated == 0.0).all()
    blurred = measure_images(Altered(sharp, color=lambda image: cv2.blur(image, (21, 21))))
    assert blurred.blurred_share == 1.0
