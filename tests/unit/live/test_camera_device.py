"""Cameras of the operating system, by a stand-in for OpenCV's: whose clock its stamps are by, and when it is gone."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.live.camera_device import CameraDevice
from monoloc.live.frame_source import CameraGoneError
from refusals import refuses_data

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
NOW_S = 5000.0


class Capture:
    """What ``cv2.VideoCapture`` returns; of each frame the stamp, and the image or None where it is damaged."""

    frames: list[tuple[float, NDArray[np.uint8] | None]]
    is_there = True

    def __init__(self, index: int) -> None:
        self.index = index
        self.settings: dict[int, float] = {}
        self.current: tuple[float, NDArray[np.uint8] | None] | None = None

    def isOpened(self) -> bool:
        return self.is_there

    def set(self, key: int, value: float) -> bool:
        self.settings[key] = value
        return False  # as from drivers that refuse

    def get(self, key: int) -> float:
        assert key == cv2.CAP_PROP_POS_MSEC and self.current is not None
        return self.current[0] * 1000.0

    def grab(self) -> bool:
        self.current = self.frames.pop(0) if self.frames else None
        return self.current is not None

    def retrieve(self) -> tuple[bool, NDArray[np.uint8] | None]:
        assert self.current is not None
        return self.current[1] is not None, self.current[1]

    def release(self) -> None:
        self.frames = []


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> Callable[..., CameraDevice]:
    """A device that gives these frames, at a standing clock."""
    monkeypatch.setattr(time, "monotonic", lambda: NOW_S)

    def plug(*stamps_s: float, images: list[NDArray[np.uint8] | None] | None = None) -> CameraDevice:
        image = np.zeros((48, 64, 3), np.uint8)
        shown = [image] * len(stamps_s) if images is None else images
        capture = type("Plugged", (Capture,), {"frames": list(zip(stamps_s, shown, strict=True))})
        monkeypatch.setattr(cv2, "VideoCapture", capture)
        device = CameraDevice(3, CAMERA)
        device.open()
        return device

    return plug


def test_stamps_of_the_monotonic_clock_are_the_times_of_capture(plugged: Callable[..., CameraDevice]) -> None:
    device = plugged(NOW_S - 0.04, NOW_S - 0.007)
    assert device.grab()[1] == pytest.approx(NOW_S - 0.04)
    assert device.grab()[1] == pytest.approx(NOW_S - 0.007)


@pytest.mark.parametrize("stamp_s", [0.0, 1.7e9, NOW_S + 0.5, NOW_S - 7.0, -1.0, float("nan")])
def test_stamps_of_another_clock_or_of_none_are_not(plugged: Callable[..., CameraDevice], stamp_s: float) -> None:
    assert plugged(stamp_s).grab()[1] == NOW_S


def test_a_frame_that_the_drivers_queue_held_back_is_as_old_as_its_stamp_says(
    plugged: Callable[..., CameraDevice],
) -> None:
    device = plugged(NOW_S - 0.04, NOW_S - 3.0)
    device.grab()
    assert device.grab()[1] == pytest.approx(NOW_S - 3.0)


@pytest.mark.parametrize("none_s", [0.0, -0.001, float("nan")])
def test_an_image_without_a_stamp_between_others_is_as_late_as_they_are(
    plugged: Callable[..., CameraDevice], none_s: float
) -> None:
    device = plugged(none_s, NOW_S - 0.05, NOW_S - 3.0, none_s, NOW_S - 0.04)
    captured_s = [device.grab()[1] for _ in range(5)]
    assert captured_s == pytest.approx([NOW_S, NOW_S - 0.05, NOW_S - 3.0, NOW_S - 0.05, NOW_S - 0.04])


def test_the_size_of_the_intrinsics_one_buffer_and_a_fixed_focus_are_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[Capture] = []
    monkeypatch.setattr(cv2, "VideoCapture", lambda index: made.append(Capture(index)) or made[-1])
    CameraDevice(3, CAMERA).open()
    wanted = {"FRAME_WIDTH": 64, "FRAME_HEIGHT": 48, "BUFFERSIZE": 1, "AUTOFOCUS": 0}
    assert made[0].index == 3
    assert made[0].settings == {getattr(cv2, f"CAP_PROP_{name}"): value for name, value in wanted.items()}


def test_images_are_rgb_and_a_damaged_one_is_left_out(plugged: Callable[..., CameraDevice]) -> None:
    blue_first = np.zeros((48, 64, 3), np.uint8)
    blue_first[..., 0] = 200
    device = plugged(NOW_S, NOW_S, images=[None, blue_first])
    color, _ = device.grab()
    assert (color == [0, 0, 200]).all()


def test_a_camera_that_gives_no_frame_or_only_damaged_ones_is_gone(plugged: Callable[..., CameraDevice]) -> None:
    with pytest.raises(CameraGoneError):
        plugged().grab()
    with pytest.raises(CameraGoneError):
        plugged(*[NOW_S] * 1000, images=[None] * 1000).grab()


def test_after_it_came_back_its_clock_is_found_again(
    plugged: Callable[..., CameraDevice], monkeypatch: pytest.MonkeyPatch
) -> None:
    device = plugged(NOW_S - 0.04)
    device.grab()
    device.close()
    with pytest.raises(CameraGoneError):
        device.grab()
    monkeypatch.setattr(Capture, "frames", [(12.0, np.zeros((48, 64, 3), np.uint8))], raising=False)
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    device.open()
    assert device.grab()[1] == NOW_S


@pytest.mark.parametrize("number", [987, 99_999_999_999])
def test_an_absent_camera_is_one_line_and_opencv_adds_none(capfd: pytest.CaptureFixture[str], number: int) -> None:
    device = CameraDevice(number, CAMERA)
    level = cv2.utils.logging.getLogLevel()
    refuses_data(device.open, Path(f"camera:{number}"), "cannot be opened", "plugged in")
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == level
    device.close()
