"""Whether a camera gave its previous image again; a sensor's noise alone makes two images differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def is_same_image(image: NDArray[np.uint8], other: NDArray[np.uint8] | None) -> bool:
    """Whether two images (H, W, 3) are the same, bit for bit; false where there is no other."""
    if other is None:
        return False
    # A few rows already differ in most images.
    return np.array_equal(image[::32], other[::32]) and np.array_equal(image, other)
