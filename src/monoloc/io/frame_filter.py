"""Frames of a recording that cannot be used: left out, counted and reported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.errors import DataError


class FrameFilter:
    """Decides which of a number of frames remain.

    Attributes:
        usable: (count,) bool, the frames that passed every requirement so far.
    """

    def __init__(self, count: int) -> None:
        self.usable: NDArray[np.bool_] = np.ones(count, dtype=np.bool_)
        self._reasons: list[str] = []

    def require(self, met: ArrayLike, reason: str) -> None:
        """Leave out frames that do not meet a requirement.

        Args:
            met: (count,) bool.
            reason: why a frame is left out, after a number of frames: "without depth".
        """
        mask = np.asarray(met, dtype=np.bool_)
        lost = int(np.sum(self.usable & ~mask))
        if lost:
            self._reasons.append(f"{lost} {reason}")
        self.usable &= mask

    def require_if_any(self, met: ArrayLike, reason: str) -> bool:
        """As :meth:`require`, of what a recording may lack as a whole; returns whether any frame has it.

        Args:
            met: (count,) bool.
            reason: as for :meth:`require`.
        """
        has_any = bool(np.any(met))
        if has_any:
            self.require(met, reason)
        return has_any

    def positions(self, path: Path, fix: str) -> NDArray[np.int64]:
        """Indices of the frames that remain.

        Raises:
            DataError: none remains; the error names the path, the reasons and the fix.
        """
        if not self.usable.any():
            found = f"none of its {len(self.usable)} frames can be used" if len(self.usable) else "it has no frames"
            raise DataError(path, ": ".join([found, *([", ".join(self._reasons)] if self._reasons else [])]), fix)
        return np.flatnonzero(self.usable)

    def notes(self) -> list[str]:
        """One sentence on the frames that were left out, or none."""
        if not self._reasons:
            return []
        count = len(self.usable)
        return [f"{count - int(self.usable.sum())} of {count} frames are left out: {', '.join(self._reasons)}"]
