"""A thread that keeps the newest frame of a camera.

Drivers and decoders queue frames, and a reader that is slower than the camera would see ever older ones. So the queue
is emptied by a thread of its own, which keeps one frame.
"""

from __future__ import annotations

import contextlib
import threading
import time
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import MonolocError
from monoloc.live.frame_source import CameraGoneError, LiveFrame

_FIRST_RETRY_S, _LAST_RETRY_S = 0.2, 2.0  # between attempts to open a camera that is gone
_JOIN_S = 2.0  # for which close() waits: a driver may hang in a read


class Grabber(Protocol):
    """A camera that is read one frame after the other.

    Attributes:
        name: short name for reports.
    """

    name: str

    def open(self) -> None:
        """Open the camera.

        Raises:
            DataError: it is absent or refuses.
        """
        ...

    def grab(self) -> tuple[NDArray[np.uint8], float]:
        """Wait for the next image: (H, W, 3) uint8 RGB, and its time of capture by ``time.monotonic``, seconds.

        It is called only while the camera is open, and does not wait for ever where the camera hangs, if it can.

        Raises:
            CameraGoneError: it gives no more images; :meth:`open` may bring it back.
            EndOfStreamError: it has no more images.
        """
        ...

    def close(self) -> None:
        """Release the camera, also one that is gone or was never opened; raises nothing."""
        ...


class NewestFrame:
    """A :class:`~monoloc.live.frame_source.FrameSource` of a grabber, which is opened at once and after each loss.

    Raises:
        DataError: the camera cannot be opened.
    """

    def __init__(self, grabber: Grabber) -> None:
        grabber.open()
        self.name = grabber.name
        self.reconnections = 0
        self._grabber = grabber
        self._frame: LiveFrame | None = None
        self._count = 0
        self._is_reopened, self._retry_s = False, _FIRST_RETRY_S
        self._failure: Exception | None = None
        self._arrived = threading.Condition()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"camera {grabber.name}", daemon=True)
        self._thread.start()

    def now_s(self) -> float:
        return time.monotonic()

    def next(self, timeout_s: float) -> LiveFrame | None:
        """See :meth:`monoloc.live.frame_source.FrameSource.next`."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._frame is not None or self._failure is not None, timeout_s)
            frame, self._frame = self._frame, None
            if frame is None and self._failure is not None:
                raise self._failure
            return frame

    def close(self) -> None:
        self._closing.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        try:
            while not self._closing.is_set():
                self._read_until_gone()
                self._reopen()
        except Exception as error:
            # The flight's thread raises it: nothing of this thread may vanish.
            with self._arrived:
                self._failure = error
                self._arrived.notify_all()
        finally:
            self._grabber.close()

    def _read_until_gone(self) -> None:
        while not self._closing.is_set():
            try:
                color, captured_s = self._grabber.grab()
            except CameraGoneError:
                return
            with self._arrived:
                # A camera is back, not when it can be opened, but when it gives an image.
                self.reconnections += self._is_reopened
                self._is_reopened, self._retry_s = False, _FIRST_RETRY_S
                self._frame = LiveFrame(color, captured_s, self._count)
                self._count += 1
                self._arrived.notify_all()

    def _reopen(self) -> None:
        self._grabber.close()
        self._is_reopened = True
        while not self._closing.wait(self._retry_s):
            self._retry_s = min(2.0 * self._retry_s, _LAST_RETRY_S)
            with contextlib.suppress(MonolocError):
                self._grabber.open()
                return
