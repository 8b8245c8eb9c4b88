"""Cameras that have a library of their own: Raspberry Pi, RealSense, OAK. The libraries come from their makers."""

from __future__ import annotations

import importlib
import time
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.live.capture_clock import CaptureClock
from monoloc.live.frame_source import CameraGoneError

_TIMEOUT_S = 1.0  # for the next frame
_RATE_HZ = 30


def _library(module: str, source: str, package: str) -> ModuleType:
    """The maker's library.

    Raises:
        SettingError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise SettingError("SOURCE", f"{source} needs {module}", f"install {package}") from error


class PiCamera:
    """A :class:`~monoloc.live.newest_frame.Grabber` of a Raspberry Pi's camera, by libcamera: ``picamera``."""

    def __init__(self, camera: Camera) -> None:
        self.name = "picamera"
        self._library = _library("picamera2", self.name, "it by apt install python3-picamera2")
        self._camera = camera
        self._device: Any = None

    def open(self) -> None:
        try:
            device = self._library.Picamera2()
            size = (self._camera.width, self._camera.height)
            # The library names the order of bytes in a word, so this is RGB.
            device.configure(device.create_video_configuration(main={"size": size, "format": "BGR888"}))
            device.start()
        except (RuntimeError, IndexError) as error:
            raise DataError(self.name, f"cannot be opened ({error})", "check it with rpicam-hello") from error
        self._device = device

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            request = self._device.capture_request()
        except (RuntimeError, AttributeError) as error:
            raise CameraGoneError from error
        try:
            color = np.array(request.make_array("main"), dtype=np.uint8)
            stamp_s = request.get_metadata()["SensorTimestamp"] / 1e9
        finally:
            request.release()
        # The stamp counts time asleep, the monotonic clock does not.
        asleep_s = time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
        return color, stamp_s - asleep_s

    def close(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None


class RealSense:
    """A :class:`~monoloc.live.newest_frame.Grabber` of the colour camera of a RealSense: ``realsense``."""

    def __init__(self, camera: Camera) -> None:
        self.name = "realsense"
        self._library = _library("pyrealsense2", self.name, "it by pip install pyrealsense2")
        self._camera = camera
        self._pipeline: Any = None
        self._clock = CaptureClock()

    def open(self) -> None:
        rs = self._library
        pipeline, config = rs.pipeline(), rs.config()
        config.enable_stream(rs.stream.color, self._camera.width, self._camera.height, rs.format.rgb8, _RATE_HZ)
        try:
            pipeline.start(config)
        except RuntimeError as error:
            fix = f"check with rs-enumerate-devices that it gives {self._camera.width}x{self._camera.height}"
            raise DataError(self.name, f"cannot be opened ({error})", fix) from error
        self._pipeline, self._clock = pipeline, CaptureClock()

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            frame = self._pipeline.wait_for_frames(round(_TIMEOUT_S * 1000.0)).get_color_frame()
            arrived_s = time.monotonic()
        except (RuntimeError, AttributeError) as error:
            raise CameraGoneError from error
        color = np.array(frame.get_data(), dtype=np.uint8)  # a copy: the library takes the buffer back
        return color, self._clock.captured_s(frame.get_timestamp() / 1000.0, arrived_s)

    def close(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None


class Oak:
    """A :class:`~monoloc.live.newest_frame.Grabber` of the colour camera of an OAK, by DepthAI 3: ``oak``."""

    def __init__(self, camera: Camera) -> None:
        self.name = "oak"
        self._library = _library("depthai", self.name, "it by pip install depthai")
        self._camera = camera
        self._pipeline: Any = None
        self._queue: Any = None

    def open(self) -> None:
        dai = self._library
        try:
            pipeline = dai.Pipeline()
            output = pipeline.create(dai.node.Camera).build().requestOutput((self._camera.width, self._camera.height))
            self._queue = output.createOutputQueue(maxSize=1, blocking=False)
            pipeline.start()
        except RuntimeError as error:
            raise DataError(self.name, f"cannot be opened ({error})", "check the cable and its power") from error
        self._pipeline = pipeline

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            frame = self._queue.get()
        except (RuntimeError, AttributeError) as error:
            raise CameraGoneError from error
        # The library brings its stamps to the monotonic clock of this machine.
        return np.ascontiguousarray(frame.getCvFrame()[..., ::-1]), frame.getTimestamp().total_seconds()

    def close(self) -> None:
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = self._queue = None
