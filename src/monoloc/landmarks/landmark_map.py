"""The landmark map: corners of a room with descriptors.

Away from the views that it was tuned on, a depth network errs in the same way from frame to frame. Where a corner is
does not depend on what a network has learnt.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Landmarks:
    """L corners of a room, with ORB descriptors.

    Attributes:
        points: (L, 3) float32, world frame, metres.
        descriptors: (L, 32) uint8, binary.

    Raises:
        ValueError: other shapes or types.
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __post_init__(self) -> None:
        points, descriptors = self.points, self.descriptors
        shapes = f"{points.shape} and {descriptors.shape}"
        if points.shape[1:] != (3,) or descriptors.shape[1:] != (32,) or len(points) != len(descriptors):
            raise ValueError(f"points and descriptors must be (L, 3) and (L, 32), got {shapes}")
        if points.dtype != np.float32 or descriptors.dtype != np.uint8:
            types = f"{points.dtype} and {descriptors.dtype}"
            raise ValueError(f"points and descriptors must be float32 and uint8, got {types}")

    @classmethod
    def none(cls) -> Landmarks:
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 32), np.uint8))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def bytes(self) -> int:
        return self.points.nbytes + self.descriptors.nbytes
