"""A recording in the place of a camera: at its own pace, or as fast as it can be localised."""

from __future__ import annotations

import time

from monoloc.io.recording import Recording
from monoloc.live.frame_source import EndOfStreamError, LiveFrame


class PacedRecording:
    """A :class:`~monoloc.live.frame_source.FrameSource` that gives each frame when its time has come.

    Frames whose successor is already due are dropped, as a camera drops them.
    """

    def __init__(self, recording: Recording) -> None:
        self.name = recording.name
        self.reconnections = 0
        self._recording = recording
        self._next = 0
        self._began_s: float | None = None  # at the first call, so that slow preparations drop nothing

    def now_s(self) -> float:
        return time.monotonic()

    def next(self, timeout_s: float) -> LiveFrame | None:
        """See :meth:`monoloc.live.frame_source.FrameSource.next`."""
        if self._next >= len(self._recording):
            raise EndOfStreamError
        due_s = self._due_s(self._next)
        wait_s = due_s - self.now_s()
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            return None
        time.sleep(max(0.0, wait_s))
        while self._next + 1 < len(self._recording) and self._due_s(self._next + 1) <= self.now_s():
            self._next += 1
        index = self._next
        self._next += 1
        return LiveFrame(self._recording.color(index), self._due_s(index), index)

    def _due_s(self, index: int) -> float:
        times_s = self._recording.timestamps_s
        self._began_s = self.now_s() if self._began_s is None else self._began_s
        return self._began_s + float(times_s[index] - times_s[0])

    def close(self) -> None:
        """Nothing: a recording holds nothing open that another would want."""


class UnpacedRecording:
    """A :class:`~monoloc.live.frame_source.FrameSource` that gives every frame at once, by the recording's clock."""

    def __init__(self, recording: Recording) -> None:
        self.name = recording.name
        self.reconnections = 0
        self._recording = recording
        self._next = 0

    def now_s(self) -> float:
        """Time of the frame that was given last: as though nothing took time."""
        return float(self._recording.timestamps_s[max(0, self._next - 1)])

    def next(self, timeout_s: float) -> LiveFrame | None:
        """See :meth:`monoloc.live.frame_source.FrameSource.next`."""
        if self._next >= len(self._recording):
            raise EndOfStreamError
        index = self._next
        self._next += 1
        return LiveFrame(self._recording.color(index), float(self._recording.timestamps_s[index]), index)

    def close(self) -> None:
        """Nothing: see :meth:`PacedRecording.close`."""
