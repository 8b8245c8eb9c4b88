"""Streams over a network, by PyAV: ``rtsp://``, ``http://`` and what else FFmpeg opens."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.extras import require_extra
from monoloc.live.capture_clock import CaptureClock
from monoloc.live.frame_source import CameraGoneError, EndOfStreamError

_TIMEOUT_S = 5.0  # for opening, and for the next packet
_OPTIONS = {"rtsp_transport": "tcp"}  # TCP loses no packets
_AT_ONCE_S = 0.02  # in which a packet comes that was there already
_JITTER_S = 0.003  # by which an image may come sooner after the one before than it was captured
_CAMERA_ONLY = "mpjpeg"  # images that replace one another; nobody stores them so
# Containers of bare images hold no times: FFmpeg counts their frames, at 25 a second whatever the camera's rate.
_WITHOUT_STAMPS = {_CAMERA_ONLY, "mjpeg", "h264", "hevc"}
_CREDENTIALS = re.compile(r"(?<=//)[^/]*@")  # of a URL: they belong in no message


class NetworkStream:
    """A :class:`~monoloc.live.newest_frame.Grabber` of a URL, with times from the stream's own stamps, or of arrival
    where it has none.

    A file on a server, whose size or duration is known, is played at its own pace, and ends; a camera that ends is
    gone and may come back.

    To find out what a stream is, FFmpeg reads its first second or two. These images are decoded, since those after
    them may build on the only key frame for a long time, but not given: they are old.

    Raises:
        MissingExtraError: PyAV is not installed.
    """

    def __init__(self, url: str) -> None:
        require_extra("stream")
        self.name = _CREDENTIALS.sub("", url)
        self._url = url
        self._container: Any = None
        self._frames: Any = None
        self._is_file = self._has_stamps = False
        self._clock = CaptureClock()
        self._played_s, self._began_s = math.nan, 0.0  # previous stamp of a file, and when its stamp was zero
        self._opened_s = self._opening_s = self._waited_s = 0.0
        self._first_stamp_s: float | None = None
        self._delay_s = math.inf  # of the previous image, from its stamp to its arrival

    def open(self) -> None:
        import av

        began_s = time.monotonic()
        try:
            self._container = av.open(self._url, options=_OPTIONS, timeout=_TIMEOUT_S)
            video = self._container.streams.video[0]
        except (av.FFmpegError, OSError, IndexError) as error:
            self.close()
            fix = "check the address, and that another player shows it"
            raise DataError(self.name, f"gives no video ({_reason(error, 'it has none')})", fix) from error
        video.thread_type = "SLICE"  # threads by frame add a frame of delay each
        self._frames = self._decoded(video)
        self._has_stamps = self._container.format.name not in _WITHOUT_STAMPS
        self._is_file = self._states_an_end()
        self._clock, self._played_s = CaptureClock(), math.nan
        self._opened_s, self._first_stamp_s, self._delay_s = time.monotonic(), None, math.inf
        self._opening_s = 0.0 if self._is_file else self._opened_s - began_s

    def _states_an_end(self) -> bool:
        """Whether what is open is a file, by its duration or size.

        Some cameras state a duration over RTSP that means nothing, or a size over HTTP that they never reach.
        """
        is_camera = self._url.startswith("rtsp") or self._container.format.name == _CAMERA_ONLY
        return not is_camera and (self._container.duration is not None or self._container.size > 0)

    def _decoded(self, video: Any) -> Iterator[Any]:
        """The images, each after :attr:`_waited_s` tells how long its packet took to come."""
        import av

        asked_s = time.monotonic()
        for packet in self._container.demux(video):
            self._waited_s = time.monotonic() - asked_s
            frames = ()
            with suppress(av.error.InvalidDataError):  # damaged, or before the first whole image
                frames = packet.decode()
            yield from frames
            asked_s = time.monotonic()

    def _is_old(self, frame: Any, arrived_s: float) -> bool:
        """Whether an image came while the stream was opened.

        None is, from the first packet on that had to be waited for, and once as much time has passed as the opening
        took: a computer that is slower than its stream catches up by leaving out images. Where other threads are
        busy, any packet is waited for; then images are old while their delay falls.
        """
        has_stamp, fell_s = self._has_stamps and frame.time is not None, 0.0
        if has_stamp:
            fell_s, self._delay_s = self._delay_s - (arrived_s - frame.time), arrived_s - frame.time
        came_anew = self._waited_s > _AT_ONCE_S and fell_s < _JITTER_S
        if came_anew or arrived_s - self._opened_s >= self._opening_s:
            self._opening_s = 0.0
            return False
        if not has_stamp:
            return True
        self._first_stamp_s = frame.time if self._first_stamp_s is None else self._first_stamp_s
        passed_s = arrived_s - self._opened_s + self._opening_s
        return bool(frame.time - self._first_stamp_s < passed_s)

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        """See :meth:`monoloc.live.newest_frame.Grabber.grab`.

        Raises:
            DataError: a file breaks off.
        """
        import av

        try:
            frame = next(self._frames)
            while self._is_old(frame, arrived_s := time.monotonic()):
                frame = next(self._frames)
        except StopIteration as error:
            raise (EndOfStreamError if self._is_file else CameraGoneError) from error
        except (av.FFmpegError, OSError) as error:
            if self._is_file:  # opened again, it would play from its start
                problem = f"breaks off ({_reason(error, type(error).__name__)})"
                raise DataError(self.name, problem, "copy it here, and name the file") from error
            raise CameraGoneError from error
        color: NDArray[np.uint8] = frame.to_ndarray(format="rgb24")
        if not self._has_stamps or frame.time is None:
            return color, arrived_s
        if self._is_file:
            arrived_s = self._awaited_s(frame.time, arrived_s)
        return color, self._clock.captured_s(frame.time, arrived_s)

    def _awaited_s(self, stamp_s: float, arrived_s: float) -> float:
        """Wait until a frame of a file is due: it comes as fast as it is read, and a camera's would not."""
        if not 0.0 <= stamp_s - self._played_s <= _TIMEOUT_S:  # the first, or a jump, as where videos were joined
            self._began_s = arrived_s - stamp_s
        self._played_s = stamp_s
        time.sleep(max(0.0, self._began_s + stamp_s - arrived_s))
        return time.monotonic()

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = self._frames = None


def _reason(error: Exception, otherwise: str) -> str:
    """Why a stream cannot be read; the error's whole text repeats the URL."""
    import av

    if isinstance(error, av.error.ExitError):  # how a wait ends; FFmpeg says "Immediate exit requested"
        return f"no answer in {_TIMEOUT_S:g} s"
    return getattr(error, "strerror", None) or otherwise
