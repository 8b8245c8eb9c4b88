"""Cameras with a library of their own, by stand-ins that replay frames.

The stand-ins have the calls, arguments, results and exceptions of picamera2 0.3.38, pyrealsense2 2.59.1 and depthai
3.12.0, and nothing else, so that a call that these lack fails here.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.live.frame_source import CameraGoneError
from monoloc.live.newest_frame import Grabber
from monoloc.live.opening import open_live
from monoloc.live.vendor_cameras import Oak, PiCamera, RealSense
from refusals import refuses_data, refuses_setting
from synthetic_recordings import make_color

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
NOW_S = 5000.0


@dataclass
class Plugged:
    """What is plugged in.

    Attributes:
        frames: time of capture by the monotonic clock, and image, RGB.
        clock_zero_s: time by the monotonic clock when the camera's own clock was 0.
        is_there: whether a camera can be opened.
        starts: whether it then starts.
        closes: whether it can be closed; libraries raise where the cable is out.
        opened: cameras that were not closed again.
        lens_position: of the factory's calibration; 0 or None for none.
        focus: what was asked of the lens before the camera started.
    """

    frames: list[tuple[float, NDArray[np.uint8]]] = field(default_factory=list)
    clock_zero_s: float = 0.0
    is_there: bool = True
    starts: bool = True
    closes: bool = True
    opened: int = 0
    lens_position: int | None = 130
    focus: list[tuple[str, object]] = field(default_factory=list)

    def start(self) -> None:
        if not self.starts:
            raise RuntimeError("failed to set power state")

    def close(self) -> None:
        self.opened -= 1
        if not self.closes:
            raise RuntimeError("the device is no longer connected")


class Device:
    """What all stand-ins share."""

    plugged: Plugged


# --- picamera2 ---


class Request:
    def __init__(self, stamp_s: float, color: NDArray[np.uint8]) -> None:
        self.stamp_s, self.color, self.is_released = stamp_s, color, False

    def make_array(self, name: str) -> NDArray[np.uint8]:
        assert name == "main" and not self.is_released
        return self.color.copy()

    def get_metadata(self) -> dict[str, Any]:
        return {"SensorTimestamp": round(self.stamp_s * 1e9), "ExposureTime": 5000}

    def release(self) -> None:
        self.is_released = True


class Picamera2(Device):
    def __init__(self, camera_num: int = 0) -> None:
        if not self.plugged.is_there:
            raise RuntimeError("No camera number 0 found")
        self.plugged.opened += 1
        self.requests: list[Request] = []

    def create_video_configuration(self, main: dict[str, Any]) -> dict[str, Any]:
        assert main == {"size": (64, 48), "format": "BGR888"}  # in memory: red, green, blue
        return {"main": main}

    def configure(self, camera_config: dict[str, Any]) -> None:
        assert set(camera_config) == {"main"}

    def start(self) -> None:
        self.plugged.start()

    def capture_request(self, wait: float | None = None) -> Request:
        assert wait is not None, "it would wait for ever"
        assert all(request.is_released for request in self.requests), "the camera runs out of buffers"
        if not self.plugged.frames:
            raise TimeoutError
        self.requests.append(Request(*self.plugged.frames.pop(0)))
        return self.requests[-1]

    def close(self) -> None:
        self.plugged.close()


# --- pyrealsense2 ---


class Config:
    def enable_stream(self, stream: str, width: int, height: int, form: str, framerate: int) -> None:
        self.stream = (stream, width, height, form, framerate)


class Frame:
    def __init__(self, stamp_ms: float, color: NDArray[np.uint8]) -> None:
        self.stamp_ms, self.color = stamp_ms, color

    def get_color_frame(self) -> Frame:  # of a set of frames
        return self

    def get_data(self) -> NDArray[np.uint8]:
        return self.color

    def get_timestamp(self) -> float:
        return self.stamp_ms


class RealSensePipeline(Device):
    frame: Frame | None = None

    def start(self, config: Config) -> None:
        assert config.stream == ("color", 64, 48, "rgb8", 30)
        if not self.plugged.is_there:
            raise RuntimeError("No device connected")
        self.plugged.start()
        self.plugged.opened += 1

    def wait_for_frames(self, timeout_ms: int = 5000) -> Frame:
        assert type(timeout_ms) is int
        if self.frame is not None:
            self.frame.color[:] = 0  # the library uses a buffer again
        if not self.plugged.frames:
            raise RuntimeError(f"Frame didn't arrive within {timeout_ms}")
        captured_s, color = self.plugged.frames.pop(0)
        self.frame = Frame((captured_s - self.plugged.clock_zero_s) * 1000.0, color.copy())
        return self.frame

    def stop(self) -> None:
        self.plugged.close()


# --- depthai ---


class MessageQueue(Device):
    class QueueException(Exception):
        """As in the library, no RuntimeError."""

    def get(self, timeout: timedelta) -> object:
        if not self.plugged.is_there:
            raise self.QueueException("MessageQueue was closed")
        if not self.plugged.frames:
            return None
        captured_s, color = self.plugged.frames.pop(0)
        stamp = timedelta(seconds=captured_s)
        return SimpleNamespace(getCvFrame=lambda: color[..., ::-1].copy(), getTimestamp=lambda: stamp)


class Output:
    def createOutputQueue(self, maxSize: int = 16, blocking: bool = False) -> MessageQueue:
        assert (maxSize, blocking) == (1, False)
        return MessageQueue()


class Control(Device):
    """As in the library, it moves the lens at the start of the pipeline, unless autofocus stays on."""

    def setManualFocus(self, lensPosition: int) -> None:
        assert type(lensPosition) is int and 0 < lensPosition <= 255
        self.plugged.focus.append(("manual", lensPosition))

    def setAutoFocusMode(self, mode: str) -> None:
        self.plugged.focus.append(("mode", mode))


class CameraNode:
    initialControl = Control()

    def build(self) -> CameraNode:
        return self

    def getBoardSocket(self) -> str:
        return "CAM_A"

    def requestOutput(self, size: tuple[int, int]) -> Output:
        assert size == (64, 48)
        return Output()


class OakPipeline(Device):
    def __init__(self) -> None:
        if not self.plugged.is_there:
            raise RuntimeError("No available devices")
        self.plugged.opened += 1

    def create(self, node: type[CameraNode]) -> CameraNode:
        return node()

    def getDefaultDevice(self) -> SimpleNamespace:
        def position_of(socket: str) -> int:
            if self.plugged.lens_position is None:
                raise RuntimeError(f"There is no Camera data available corresponding to {socket}")
            return self.plugged.lens_position

        return SimpleNamespace(readCalibration=lambda: SimpleNamespace(getLensPosition=position_of))

    def start(self) -> None:
        self.plugged.start()

    def stop(self) -> None:
        self.plugged.close()


LIBRARIES: dict[str, dict[str, object]] = {
    "picamera2": {"Picamera2": Picamera2},
    "pyrealsense2": {
        "pipeline": RealSensePipeline,
        "config": Config,
        "stream": SimpleNamespace(color="color"),
        "format": SimpleNamespace(rgb8="rgb8"),
    },
    "depthai": {
        "Pipeline": OakPipeline,
        "MessageQueue": MessageQueue,
        "node": SimpleNamespace(Camera=CameraNode),
        "CameraControl": SimpleNamespace(AutoFocusMode=SimpleNamespace(OFF="off")),
    },
}
KINDS: dict[str, Callable[[Camera], Grabber]] = {"picamera": PiCamera, "realsense": RealSense, "oak": Oak}


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> Plugged:
    """Any of the cameras, at a standing clock."""
    for name, content in LIBRARIES.items():
        library = ModuleType(name)
        vars(library).update(content)
        monkeypatch.setitem(sys.modules, name, library)
    monkeypatch.setattr(time, "monotonic", lambda: NOW_S)
    state = Plugged()
    monkeypatch.setattr(Device, "plugged", state, raising=False)
    return state


@pytest.fixture(params=KINDS)
def camera(request: pytest.FixtureRequest, plugged: Plugged) -> Grabber:
    return KINDS[request.param](CAMERA)


def test_images_are_rgb_and_outlive_the_next_one(camera: Grabber, plugged: Plugged) -> None:
    colors = [make_color(64, 48, number) for number in range(3)]
    plugged.frames = [(NOW_S, color) for color in colors]
    camera.open()
    images = [camera.grab()[0] for _ in colors]
    for image, color in zip(images, colors, strict=True):
        assert image.dtype == np.uint8 and image.flags.c_contiguous
        np.testing.assert_array_equal(image, color)
    camera.close()
    assert plugged.opened == 0


@pytest.mark.parametrize("kind", ["picamera", "oak"])
def test_stamps_of_the_monotonic_clock_are_the_times_of_capture(kind: str, plugged: Plugged) -> None:
    plugged.frames = [(NOW_S - age_s, make_color(64, 48)) for age_s in (0.08, 0.04, 0.03)]
    camera = KINDS[kind](CAMERA)
    camera.open()
    assert [NOW_S - camera.grab()[1] for _ in range(3)] == pytest.approx([0.08, 0.04, 0.03], abs=1e-6)


@pytest.mark.parametrize("clock_zero_s", [NOW_S - 1.7e9, NOW_S - 12.0])
def test_a_realsenses_own_clock_tells_the_intervals(plugged: Plugged, clock_zero_s: float) -> None:
    """The system's, or the camera's own: the frame with the least delay counts as captured when it came."""
    plugged.clock_zero_s = clock_zero_s
    plugged.frames = [(NOW_S - age_s, make_color(64, 48)) for age_s in (0.03, 0.08, 0.05)]
    camera = RealSense(CAMERA)
    camera.open()
    assert [NOW_S - camera.grab()[1] for _ in range(3)] == pytest.approx([0.0, 0.05, 0.02], abs=1e-5)


def test_a_camera_that_gives_no_more_frames_is_gone_and_comes_back(camera: Grabber, plugged: Plugged) -> None:
    """The cable is out: the library raises when it is asked for a frame, and when it is to be closed."""
    plugged.frames = [(NOW_S, make_color(64, 48))]
    camera.open()
    camera.grab()
    with pytest.raises(CameraGoneError):  # none in time
        camera.grab()
    plugged.is_there = plugged.closes = False
    with pytest.raises(CameraGoneError):
        camera.grab()
    camera.close()
    refuses_data(camera.open, Path(camera.name), "cannot be opened .No ", "check")
    plugged.is_there = plugged.closes = True
    plugged.frames = [(NOW_S, make_color(64, 48))]
    camera.open()
    assert camera.grab()[1] == NOW_S
    camera.close()
    camera.close()
    assert plugged.opened == 0


def test_a_camera_that_does_not_start_is_closed_again(camera: Grabber, plugged: Plugged) -> None:
    plugged.starts = False
    refuses_data(camera.open, Path(camera.name), "cannot be opened .failed to set power state.", "check")
    assert plugged.opened == 0


@pytest.mark.parametrize(
    ("position", "focus"), [(130, ("manual", 130)), (0, ("mode", "off")), (None, ("mode", "off"))]
)
def test_the_lens_of_an_oak_does_not_move(plugged: Plugged, position: int | None, focus: tuple[str, object]) -> None:
    """It is kept where the factory calibrated it, also after the camera came back."""
    plugged.lens_position = position
    camera = Oak(CAMERA)
    for _ in range(2):
        camera.open()
        camera.close()
    assert plugged.focus == [focus, focus]


@pytest.mark.parametrize(
    ("source", "library", "fix"),
    [
        ("picamera", "picamera2", "apt install python3-picamera2"),
        ("realsense", "pyrealsense2", "pip install pyrealsense2"),
        ("oak", "depthai", "pip install depthai"),
    ],
)
def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch, source: str, library: str, fix: str) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    refuses_setting(lambda: open_live(source, CAMERA), "SOURCE", f"{source} needs {library}", fix)
