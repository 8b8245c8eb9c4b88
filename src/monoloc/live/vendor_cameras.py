"""Cameras that have a library of their own: Raspberry Pi, RealSense, OAK. The libraries come from their makers."""

from __future__ import annotations

import contextlib
import importlib
import time
from datetime import timedelta
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.live.capture_clock import CaptureClock
from monoloc.live.frame_source import CameraGoneError

_TIMEOUT_S = 5.0  # for the next frame; some cameras need two seconds to give the first one
_RATE_HZ = 30


def _library(module: str, source: str, package: str) -> ModuleType:
    """The maker's library.

    Raises:
        SettingError: it cannot be imported.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:  # which also says what the library itself lacks
        raise SettingError("SOURCE", f"{source} needs {module} ({error})", f"install {package}") from error


class PiCamera:
    """A :class:`~monoloc.live.newest_frame.Grabber` of a Raspberry Pi's camera, by libcamera: ``picamera``."""

    def __init__(self, camera: Camera) -> None:
        self.name = "picamera"
        self._library = _library("picamera2", self.name, "it by apt install python3-picamera2")
        self._camera = camera
        self._device: Any = None

    def open(self) -> None:
        size = (self._camera.width, self._camera.height)
        try:
            self._device = self._library.Picamera2()
            # The library names the order of bytes in a word, so this is RGB.
            main = {"size": size, "format": "BGR888"}
            self._device.configure(self._device.create_video_configuration(main=main))
            self._device.start()
        except (RuntimeError, IndexError) as error:
            self.close()
            raise DataError(self.name, f"cannot be opened ({error})", "check it with rpicam-hello") from error

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            request = self._device.capture_request(wait=_TIMEOUT_S)
            try:
                color = np.asarray(request.make_array("main"), np.uint8)  # a copy of the camera's buffer
                # Pipeline handlers for the Pi pass on V4L2's stamp, which is by the monotonic clock.
                return color, request.get_metadata()["SensorTimestamp"] / 1e9
            finally:
                request.release()
        except (RuntimeError, TimeoutError) as error:
            raise CameraGoneError from error

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            with contextlib.suppress(RuntimeError):
                device.close()


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
        try:
            pipeline, config = rs.pipeline(), rs.config()
            config.enable_stream(rs.stream.color, self._camera.width, self._camera.height, rs.format.rgb8, _RATE_HZ)
            pipeline.start(config)
        except RuntimeError as error:
            fix = f"check with rs-enumerate-devices that it gives {self._camera.width}x{self._camera.height}"
            raise DataError(self.name, f"cannot be opened ({error})", fix) from error
        self._pipeline, self._clock = pipeline, CaptureClock()

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            frame = self._pipeline.wait_for_frames(round(_TIMEOUT_S * 1000.0)).get_color_frame()
            arrived_s = time.monotonic()
            color = np.array(frame.get_data(), dtype=np.uint8)  # a copy: the library takes the buffer back
            return color, self._clock.captured_s(frame.get_timestamp() / 1000.0, arrived_s)
        except RuntimeError as error:
            raise CameraGoneError from error

    def close(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            with contextlib.suppress(RuntimeError):
                pipeline.stop()


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
        size = (self._camera.width, self._camera.height)
        try:
            self._pipeline = dai.Pipeline()
            node = self._pipeline.create(dai.node.Camera).build()
            self._fix_focus(node)
            self._queue = node.requestOutput(size).createOutputQueue(maxSize=1, blocking=False)
            self._pipeline.start()
        except RuntimeError as error:
            self.close()
            raise DataError(self.name, f"cannot be opened ({error})", "check the cable and its power") from error

    def _fix_focus(self, node: Any) -> None:
        """Keep a lens that moves where the factory calibrated it, since focus changes the focal length.

        Of a camera that was never calibrated, whose position is 0 or none, the lens stays where it is.
        """
        position = 0
        with contextlib.suppress(RuntimeError):
            calibration = self._pipeline.getDefaultDevice().readCalibration()
            position = calibration.getLensPosition(node.getBoardSocket())
        if position:
            node.initialControl.setManualFocus(position)
        else:
            node.initialControl.setAutoFocusMode(self._library.CameraControl.AutoFocusMode.OFF)

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        try:
            frame = self._queue.get(timedelta(seconds=_TIMEOUT_S))
        except (RuntimeError, self._library.MessageQueue.QueueException) as error:
            raise CameraGoneError from error
        if frame is None:
            raise CameraGoneError
        # The library brings its stamps to the monotonic clock of this machine.
        return np.ascontiguousarray(frame.getCvFrame()[..., ::-1]), frame.getTimestamp().total_seconds()

    def close(self) -> None:
        pipeline, self._pipeline, self._queue = self._pipeline, None, None
        if pipeline is not None:
            with contextlib.suppress(RuntimeError):
                pipeline.stop()
