"""The interface of live cameras: the newest frame, and when it was captured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LiveFrame:
    """One image of a camera in flight.

    Attributes:
        color: (H, W, 3) uint8 RGB.
        captured_s: time of capture by the source's clock, not of arrival.
        sequence: number of the image among all that the camera gave; the missing ones were dropped.
    """

    color: NDArray[np.uint8]
    captured_s: float
    sequence: int


class FrameSource(Protocol):
    """Gives the newest frame of a camera.

    Attributes:
        name: short name for reports.
        reconnections: how often the camera came back after it had gone.
    """

    name: str
    reconnections: int

    def now_s(self) -> float:
        """The clock of the times of capture, seconds."""
        ...

    def next(self, timeout_s: float) -> LiveFrame | None:
        """The newest frame that was not given yet, or None where none comes in time.

        Raises:
            EndOfStreamError: there will be no more frames.
            DataError: a frame cannot be read, and none that follows.
        """
        ...

    def close(self) -> None:
        """Release the camera; a second call does nothing."""
        ...


class EndOfStreamError(Exception):
    """A source has no more frames."""


class CameraGoneError(Exception):
    """A camera gives no more frames, but may come back."""
