"""Cameras of the operating system, by OpenCV: ``camera:0``."""

from __future__ import annotations

import time

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.live.frame_source import CameraGoneError

_MOST_LATENCY_S = 1.0  # a driver's stamp that is older is by another clock


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

    def open(self) -> None:
        capture = cv2.VideoCapture(self._index)
        if not capture.isOpened():
            capture.release()
            raise DataError(
                self.name, "cannot be opened", "check that it is plugged in and that nothing else uses it"
            )
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, self._camera.width),
            (cv2.CAP_PROP_FRAME_HEIGHT, self._camera.height),
            (cv2.CAP_PROP_BUFFERSIZE, 1),
            (cv2.CAP_PROP_AUTOFOCUS, 0),
        ):
            capture.set(key, value)
        self._capture = capture

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        if self._capture is None or not self._capture.grab():
            raise CameraGoneError
        arrived_s = time.monotonic()
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        has_image, bgr = self._capture.retrieve()
        if not has_image:
            raise CameraGoneError
        # V4L2 stamps by the monotonic clock when the exposure ends; other drivers by none or by their own.
        is_ours = 0.0 <= arrived_s - stamp_s <= _MOST_LATENCY_S
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8), stamp_s if is_ours else arrived_s

    def close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None
