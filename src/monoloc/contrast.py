"""Contrast of images: whether there is any at all, and the same everywhere."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

_SIZE = (32, 24)  # averaged down to this, a sensor's noise is gone
_LEAST_SD = 2.0  # of 255; a covered lens has 0.5 or less, a room by moonlight with automatic exposure over 20


def shows_something(color: NDArray[np.uint8]) -> bool:
    """Whether an image (H, W, 3) uint8 has more in it than darkness, glare or a sensor's noise.

    A network gives some depth of any image, and optical flow follows noise; neither says that it is invented.
    """
    small = np.asarray(cv2.resize(color, _SIZE, interpolation=cv2.INTER_AREA), dtype=np.float64)
    return bool(small.mean(axis=2).std() >= _LEAST_SD)


def equaliser() -> cv2.CLAHE:
    """Brings gray images to one contrast everywhere, without which dim ones have no corners (Zuiderveld 1994)."""
    return cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
