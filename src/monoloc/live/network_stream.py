"""Streams over a network, by PyAV: ``rtsp://``, ``http://`` and what else FFmpeg opens."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.extras import require_stream
from monoloc.live.capture_clock import CaptureClock
from monoloc.live.frame_source import CameraGoneError

_TIMEOUT_S = 5.0  # for opening, and for the next packet
# TCP loses no packets, and a decoder that does not wait for reordered frames shows each at once.
_OPTIONS = {"rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay"}


class NetworkStream:
    """A :class:`~monoloc.live.newest_frame.Grabber` of a URL, with times from the stream's own stamps.

    Raises:
        MissingExtraError: PyAV is not installed.
    """

    def __init__(self, url: str) -> None:
        require_stream()
        self.name = url
        self._container: Any = None
        self._frames: Any = None
        self._clock = CaptureClock()

    def open(self) -> None:
        import av

        try:
            self._container = av.open(self.name, options=_OPTIONS, timeout=_TIMEOUT_S)
            video = self._container.streams.video[0]
        except (av.FFmpegError, OSError, IndexError) as error:
            self.close()
            fix = "check the address, and that another player shows it"
            raise DataError(self.name, f"gives no video ({error})", fix) from error
        video.thread_type = "SLICE"  # threads by frame add a frame of delay each
        self._frames = self._container.decode(video)
        self._clock = CaptureClock()

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        import av

        try:
            frame = next(self._frames)
            arrived_s = time.monotonic()
        except (StopIteration, av.FFmpegError, OSError) as error:
            raise CameraGoneError from error
        color: NDArray[np.uint8] = frame.to_ndarray(format="rgb24")
        return color, arrived_s if frame.time is None else self._clock.captured_s(frame.time, arrived_s)

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = self._frames = None
