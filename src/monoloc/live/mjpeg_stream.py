"""Motion JPEG on standard input: ``-``. Such a stream is JPEG files one after the other, as many tools write them."""

from __future__ import annotations

import re
import select
import time
from io import RawIOBase

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.live.frame_source import EndOfStreamError

_BEGIN = b"\xff\xd8\xff"
_SOI, _EOI = 0xD8, 0xD9  # markers of an image's begin and end
_FILL = 0xFF  # may be repeated before a marker (ITU-T T.81, B.1.1.2)
_SCAN = 0xDA  # marker of the segment that the compressed pixels follow
_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of the segment that states the image's size
# What ends compressed pixels: in them, a zero follows 0xFF, or the number of a restart (ITU-T T.81, B.1.1.5).
_AFTER_PIXELS = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")
_INCOMPLETE, _DAMAGED = 0, -1
_CHUNK = 1 << 16
_BYTES_PER_PIXEL = 4  # no JPEG has more; it bounds what is read of a stream without images
_FLAGS = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION  # the intrinsics are those of the stored pixels


class MjpegStream:
    """A :class:`~monoloc.live.newest_frame.Grabber` of JPEG images; the time of capture is that of arrival.

    Args:
        stream: unbuffered, so that a read gives what has come.
        camera: intrinsics, of whose size the images must be.
    """

    def __init__(self, stream: RawIOBase, camera: Camera) -> None:
        self.name = "standard input"
        self._stream, self._camera, self._buffer = stream, camera, b""
        self._skipped = 0  # bytes that belong to no image, since the last one
        self._is_empty = True
        self._other_sizes: set[tuple[int, int]] = set()  # that images stated since the last one of the right size
        self._most_bytes = camera.width * camera.height * _BYTES_PER_PIXEL + _CHUNK

    def open(self) -> None:
        """Nothing: the stream is open."""

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        """See :meth:`monoloc.live.newest_frame.Grabber.grab`.

        Raises:
            DataError: the stream holds no JPEG images, ends without one, or has images of another size.
        """
        while True:
            jpeg = self._next_jpeg()
            arrived_s = time.monotonic()
            bgr = cv2.imdecode(np.frombuffer(jpeg, np.uint8), _FLAGS)
            if bgr is not None:  # a damaged image is left out
                self._is_empty = False
                return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8), arrived_s

    def _next_jpeg(self) -> bytes:
        while True:
            end = self._find_image()
            if end != _INCOMPLETE:
                jpeg, self._buffer, self._skipped = self._buffer[:end], self._buffer[end:], 0
                self._other_sizes.clear()
                return jpeg
            if self._skipped + len(self._buffer) > self._most_bytes:
                raise DataError(self.name, "holds no JPEG images", "write motion JPEG to it, without a container")
            chunk = self._stream.read(_CHUNK)
            if chunk is None:  # nothing yet: who started this program may have made the stream one that does not wait
                select.select([self._stream], [], [])
                continue
            if not chunk and self._is_empty:
                raise DataError(self.name, "ended without a JPEG image", "write motion JPEG to it")
            if not chunk:
                raise EndOfStreamError
            self._buffer += chunk

    def _find_image(self) -> int:
        """Skip to the first image, and find where it ends. One in which another begins was cut: it is skipped."""
        self._skip_to(0)
        while (end := self._end()) == _DAMAGED:
            self._skip_to(len(_BEGIN))
        return end

    def _skip_to(self, at: int) -> None:
        """Skip to the next image at or after a place in the buffer, or to what may become its first bytes."""
        begin = self._buffer.find(_BEGIN, at)
        at = begin if begin >= 0 else max(at, len(self._buffer) - len(_BEGIN) + 1)
        self._buffer, self._skipped = self._buffer[at:], self._skipped + at

    def _end(self) -> int:
        """Where the image ends that begins the buffer.

        Segments are skipped by their lengths, since a thumbnail in one is itself a JPEG.
        """
        at, data = 2, self._buffer
        while at + 2 <= len(data):
            marker = data[at + 1]
            if data[at] != 0xFF or marker == _SOI:
                return _DAMAGED
            if marker == _FILL:
                at += 1
                continue
            if marker == _EOI:
                return at + 2
            if at + 9 > len(data):
                break
            if marker in _SIZES and not self._is_of_camera(data[at + 5 : at + 9]):
                return _DAMAGED
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
            if marker == _SCAN:
                following = _AFTER_PIXELS.search(data, at)
                at = len(data) if following is None else following.start()
        return _INCOMPLETE

    def _is_of_camera(self, size: bytes) -> bool:
        """Whether an image has the camera's size. Among right ones, one that states another may be damaged.

        Raises:
            DataError: it is the first image, or the second that states this size.
        """
        height, width = int.from_bytes(size[:2], "big"), int.from_bytes(size[2:], "big")
        if (width, height) == (self._camera.width, self._camera.height):
            return True
        if self._is_empty or (width, height) in self._other_sizes:
            expected = f"{self._camera.width}x{self._camera.height}"
            problem = f"gives images of {width}x{height}, but the camera is {expected}"
            raise DataError(self.name, problem, "give the intrinsics of these images")
        self._other_sizes.add((width, height))
        return False

    def close(self) -> None:
        """Nothing: the stream belongs to the caller."""
