"""Motion JPEG on standard input: ``-``. Such a stream is JPEG files one after the other, as many tools write them."""

from __future__ import annotations

import time
from typing import BinaryIO

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.live.frame_source import EndOfStreamError

_BEGIN, _END = b"\xff\xd8\xff", b"\xff\xd9"
_SCAN = 0xDA  # marker of the segment that the compressed pixels follow
_SIZES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of the segment that states the image's size
_CHUNK = 1 << 16
_BYTES_PER_PIXEL = 4  # no JPEG has more; it bounds what is kept of a stream without images


class MjpegStream:
    """A :class:`~monoloc.live.newest_frame.Grabber` of JPEG images; the time of capture is that of arrival.

    Args:
        stream: unbuffered, so that a read gives what has come.
        camera: intrinsics, of whose size the images must be.
    """

    def __init__(self, stream: BinaryIO, camera: Camera) -> None:
        self.name = "standard input"
        self._stream, self._camera, self._buffer = stream, camera, b""
        self._most_bytes = camera.width * camera.height * _BYTES_PER_PIXEL + _CHUNK

    def open(self) -> None:
        """Nothing: the stream is open."""

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        """See :meth:`monoloc.live.newest_frame.Grabber.grab`.

        Raises:
            DataError: the stream holds no JPEG images, or images of another size.
        """
        while True:
            jpeg = self._next_jpeg()
            arrived_s = time.monotonic()
            bgr = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
            if bgr is not None:  # a damaged image is left out
                return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8), arrived_s

    def _next_jpeg(self) -> bytes:
        while True:
            begin = self._buffer.find(_BEGIN)
            self._buffer = self._buffer[max(begin, 0) :]
            end = self._end() if begin >= 0 else -1
            if end >= 0:
                jpeg, self._buffer = self._buffer[:end], self._buffer[end:]
                return jpeg
            if len(self._buffer) > self._most_bytes:
                raise DataError(self.name, "holds no JPEG images", "write motion JPEG to it, without a container")
            chunk = self._stream.read(_CHUNK)
            if not chunk:
                raise EndOfStreamError
            self._buffer += chunk

    def _end(self) -> int:
        """Where the image ends that begins the buffer, or -1 where it is not yet complete.

        Segments are skipped by their lengths, since a thumbnail in one is itself a JPEG.
        """
        at = 2
        while at + 9 <= len(self._buffer) and self._buffer[at] == 0xFF:
            marker, length = self._buffer[at + 1], int.from_bytes(self._buffer[at + 2 : at + 4], "big")
            if marker == _SCAN:
                end = self._buffer.find(_END, at)
                return end + 2 if end >= 0 else -1
            if marker in _SIZES:
                self._check_size(self._buffer[at + 5 : at + 9])
            at += 2 + length
        return -1

    def _check_size(self, size: bytes) -> None:
        height, width = int.from_bytes(size[:2], "big"), int.from_bytes(size[2:], "big")
        if (width, height) != (self._camera.width, self._camera.height):
            problem = (
                f"gives images of {width}x{height}, but the camera is {self._camera.width}x{self._camera.height}"
            )
            raise DataError(self.name, problem, "give the intrinsics of these images")

    def close(self) -> None:
        """Nothing: the stream belongs to the caller."""
