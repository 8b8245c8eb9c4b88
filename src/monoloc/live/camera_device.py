"""Cameras of the operating system, by OpenCV: ``camera:0``."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.live.frame_source import CameraGoneError

_MOST_LATENCY_S = 1.0  # of a first image; a driver's stamp that is older is by another clock
_MOST_DAMAGED = 30  # images in a row that cannot be decoded, with which a camera is as good as gone


class CameraDevice:
    """A :class:`~monoloc.live.newest_frame.Grabber` of a V4L2 device or another camera that OpenCV opens by number.

    The camera is asked for the size of the intrinsics, for a queue of one frame, and for a fixed focus, since focus
    changes the focal length. Drivers refuse what they do not know.

    Args:
        index: number of the device.
        camera: intrinsics, whose size is asked for.
    """

    def __init__(self, index: int, camera: Camera) -> None:
        self.name = f"camera:{index}"
        self._index, self._camera = index, camera
        self._capture: cv2.VideoCapture | None = None
        self._stamps_are_ours: bool | None = None  # None before the first stamp
        self._delay_s = 0.0  # the shortest from a stamp to the arrival

    def open(self) -> None:
        capture = None
        with _without_warnings(), contextlib.suppress(cv2.error):  # of a number that no device has
            capture = cv2.VideoCapture(self._index)
        if capture is None or not capture.isOpened():
            fix = "check that it is plugged in and that nothing else uses it"
            raise DataError(self.name, "cannot be opened", fix, page="how-to/fly")
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, self._camera.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, self._camera.height),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
            (cv2.CAP_PROP_AUTOFOCUS, 0),
        ):
            capture.set(key, value)
        self._capture, self._stamps_are_ours = capture, None

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        for _ in range(_MOST_DAMAGED):
            if self._capture is None or not self._capture.grab():
                break
            arrived_s = time.monotonic()
            stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            has_image, bgr = self._capture.retrieve()
            if has_image:  # one that is damaged on its way is left out
                captured_s = self._captured_s(stamp_s, arrived_s)
                return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8), captured_s
        raise CameraGoneError

    def _captured_s(self, stamp_s: float, arrived_s: float) -> float:
        """V4L2 stamps by the monotonic clock, with an image's first or last byte; other drivers by none or their own.

        The first stamp tells. A later one that is old was held back in the driver's queue, and must count as old.
        Zero is no stamp: some drivers give it for single images, which are timed by their arrival and the delay of
        others.
        """
        is_stamped, delay_s = stamp_s > 0.0, arrived_s - stamp_s
        if self._stamps_are_ours is None and is_stamped:
            self._stamps_are_ours, self._delay_s = 0.0 <= delay_s <= _MOST_LATENCY_S, delay_s
        if not self._stamps_are_ours:
            return arrived_s
        if not is_stamped:
            return arrived_s - self._delay_s
        self._delay_s = min(self._delay_s, max(0.0, delay_s))
        return stamp_s

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None


@contextmanager
def _without_warnings() -> Iterator[None]:
    """OpenCV's warnings off: of a camera that is absent the error says all, and it is looked for again and again."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)
