"""Images at another size."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def resize_image(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Resize an image (H, W) or (H, W, 3) uint8 to (width, height); training, builds and flights share it.

    Halving is an order of magnitude faster than other ratios, so an image is halved as often as it can be.
    """
    width, height = size
    while _can_be_halved(image, size):
        half = (image.shape[1] // 2, image.shape[0] // 2)
        image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
    rows, columns = image.shape[:2]
    if (columns, rows) == size:
        return image
    # Of an image that is reduced by up to a half, bilinear interpolation leaves no pixel out, and INTER_AREA makes
    # blocks where it enlarges.
    is_near = columns <= 2 * width and rows <= 2 * height
    interpolation = cv2.INTER_LINEAR if is_near else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), np.uint8)


def _can_be_halved(image: NDArray[np.uint8], size: tuple[int, int]) -> bool:
    rows, columns = int(image.shape[0]), int(image.shape[1])
    return rows % 2 == columns % 2 == 0 and columns >= 2 * size[0] and rows >= 2 * size[1]


def gray_image(color: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Grey values of an image (H, W, 3) uint8 RGB at another size (width, height): (height, width) uint8."""
    return resize_image(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8), size)
