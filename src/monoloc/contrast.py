"""Contrast of images: whether there is any, and its equalisation."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.image_size import gray_image, resize_image

_SIZE = (32, 24)  # at this size, a sensor's noise is averaged out
_LEAST_SD = 2.0  # of 255; a covered lens has 0.5 or less, a room by moonlight with automatic exposure over 20


def has_contrast(image: NDArray[np.uint8]) -> bool:
    """Whether an image (H, W) or (H, W, 3) uint8 shows more than darkness, glare or sensor noise.

    A depth network answers any image, and optical flow tracks noise; neither says that its output means nothing.
    """
    small = resize_image(image, _SIZE) if image.ndim == 2 else gray_image(image, _SIZE)
    return bool(small.std() >= _LEAST_SD)


def equaliser() -> cv2.CLAHE:
    """Local contrast equalisation, without which dim images have no corners (Zuiderveld 1994)."""
    return cv2.createCLAHE(clipLimit=3.0, tileGridSize=(8, 8))
