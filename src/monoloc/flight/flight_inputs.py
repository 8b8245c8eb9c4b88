"""What a flight is given beside its frames: how it begins, and what is known from others than the camera."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.odometry.motion import Motion
from monoloc.start import Start


@dataclass(frozen=True)
class Starting:
    """How a flight begins.

    Attributes:
        start: of the localizer; without any meaning while the flight is ``waiting``.
        find: tells a start from an image (H, W, 3), such as by a marker; asked while the state is lost.
        begins: whether the localizer has a start (``known``), searches the room and asks ``find`` (``searching``), or
            can do nothing before ``find`` tells it (``waiting``).
    """

    start: Start | None
    find: Callable[[NDArray[np.uint8]], Start | None] = lambda color: None
    begins: Literal["known", "searching", "waiting"] = "known"


@dataclass(frozen=True)
class OtherSensors:
    """What other sensors than the camera tell, by times of capture.

    Attributes:
        down_at: direction of gravity in the camera's frame at a time, (3,); None where it is not known.
        motion_between: the camera's motion between two times; None where it is not known.
    """

    down_at: Callable[[float], FloatArray | None] = lambda captured_s: None
    motion_between: Callable[[float, float], Motion | None] = lambda start_s, end_s: None
