"""A camera that is mounted on its side or upside down, whose images are turned upright."""

from __future__ import annotations

from dataclasses import replace

from monoloc.image_turns import turned_image
from monoloc.live.frame_source import FrameSource, LiveFrame


class TurnedFrames:
    """A :class:`~monoloc.live.frame_source.FrameSource` of another one's images, turned counter-clockwise.

    Args:
        quarter_turns: of each image.
    """

    def __init__(self, source: FrameSource, quarter_turns: int) -> None:
        self._source, self._turns = source, quarter_turns
        self.name, self.reconnections = source.name, source.reconnections

    def now_s(self) -> float:
        return self._source.now_s()

    def next(self, timeout_s: float) -> LiveFrame | None:
        """See :meth:`monoloc.live.frame_source.FrameSource.next`."""
        frame = self._source.next(timeout_s)
        self.reconnections = self._source.reconnections
        return frame and replace(frame, color=turned_image(frame.color, self._turns))

    def close(self) -> None:
        self._source.close()
