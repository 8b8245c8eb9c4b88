"""Opening of a live camera, or of a recording in its place, from what a user writes."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.live.camera_device import CameraDevice
from monoloc.live.frame_source import FrameSource
from monoloc.live.mjpeg_stream import MjpegStream
from monoloc.live.network_stream import NetworkStream
from monoloc.live.newest_frame import Grabber, NewestFrame
from monoloc.live.vendor_cameras import Oak, PiCamera, RealSense

_DEVICE = re.compile(r"camera:(\d+)")
_STREAM = re.compile(r"(rtsps?|https?|udp|tcp)://.+")
_VENDORS: dict[str, Callable[[Camera], Grabber]] = {"picamera": PiCamera, "realsense": RealSense, "oak": Oak}


def is_live(source: str) -> bool:
    """Whether SOURCE names a camera or a stream, rather than a recording."""
    return source == "-" or source in _VENDORS or bool(_DEVICE.fullmatch(source) or _STREAM.fullmatch(source))


def open_live(source: str, camera: Camera) -> FrameSource:
    """Open a camera or a stream: ``camera:0``, ``picamera``, ``realsense``, ``oak``, ``rtsp://...`` or ``-``.

    Args:
        source: see :func:`is_live`.
        camera: intrinsics of its images.

    Raises:
        DataError: it cannot be opened.
        SettingError: it is none of these, or its maker's library is not installed.
        MissingExtraError: a library for streams is not installed.
    """
    return NewestFrame(_grabber(source, camera))


def _grabber(source: str, camera: Camera) -> Grabber:
    if device := _DEVICE.fullmatch(source):
        return CameraDevice(int(device[1]), camera)
    if _STREAM.fullmatch(source):
        return NetworkStream(source)
    if source == "-":
        if sys.stdin is None:
            raise SettingError("SOURCE", "is -, but standard input is closed", "write motion JPEG to it")
        return MjpegStream(os.fdopen(sys.stdin.fileno(), "rb", buffering=0, closefd=False), camera)
    if source in _VENDORS:
        return _VENDORS[source](camera)
    raise SettingError(
        "SOURCE", f"{source!r} is no camera", f"write camera:0, rtsp://..., - or {', '.join(_VENDORS)}"
    )
