"""Sharpness and exposure of a recording's images."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, evenly_spaced

_FRAMES = 60
_WIDTH = 320
_BLUR_PX = 9
_DARK, _SATURATED = 16, 250  # of 255
BLURRED = 0.55
"""Blur above which an image is blurred. Sharp rooms have 0.2 to 0.5, the same blurred along 9 pixels 0.52 to 0.7."""

TOO_DARK = 30.0
"""Median grey level, of 255, below which a room is dark."""


@dataclass(frozen=True)
class ImageQuality:
    """Quality of M of a recording's images.

    Attributes:
        frames: (M,) their indices.
        blur: (M,) 0 sharp to 1 without any detail, see :func:`blur_of`.
        brightness: (M,) median grey level of 255.
        dark, saturated: (M,) share of pixels that are black, or at the sensor's limit.
    """

    frames: NDArray[np.int64]
    blur: FloatArray
    brightness: FloatArray
    dark: FloatArray
    saturated: FloatArray

    @property
    def blurred_share(self) -> float:
        """Share of the images that are blurred."""
        return float(np.mean(self.blur > BLURRED))

    @property
    def grey_level(self) -> tuple[float, float]:
        """Mean and standard deviation of the brightness over the images."""
        return float(np.mean(self.brightness)), float(np.std(self.brightness))


def measure_images(recording: Recording) -> ImageQuality:
    """Measure up to 60 images, spread over the recording.

    Raises:
        DataError: an image cannot be read.
    """
    chosen = evenly_spaced(len(recording), _FRAMES)
    rows = []
    for index in chosen.tolist():
        rows.append(quality_of(recording.color(index)))
    blur, brightness, dark, saturated = np.array(rows, dtype=np.float64).T
    return ImageQuality(chosen, blur, brightness, dark, saturated)


def quality_of(color: NDArray[np.uint8]) -> tuple[float, float, float, float]:
    """Blur, brightness, dark and saturated share of an image (H, W, 3) uint8 RGB, see :class:`ImageQuality`."""
    gray = small_gray(color)
    return blur_of(gray), float(np.median(gray)), float(np.mean(gray < _DARK)), float(np.mean(gray > _SATURATED))


def small_gray(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Grey values of an image (H, W, 3) uint8 RGB at a width of 320 pixels, or its own if that is less, (h, w)."""
    factor = min(1.0, _WIDTH / color.shape[1])
    size = (round(color.shape[1] * factor), round(color.shape[0] * factor))
    resized = cv2.resize(color, size, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(resized, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def blur_of(gray: NDArray[np.uint8]) -> float:
    """Blur of an image (h, w), 0 to 1: the share of its differences that a blur along 9 pixels leaves.

    The larger of both directions. It compares an image with itself, so it hardly depends on what the image shows.
    Source: Crete et al., *The blur effect* (2007).
    """
    values = gray.astype(np.float32)
    left = []
    for axis, size in ((0, (1, _BLUR_PX)), (1, (_BLUR_PX, 1))):
        sharp = np.abs(np.diff(values, axis=axis))
        blurred = np.abs(np.diff(cv2.blur(values, size), axis=axis))
        total = float(sharp.sum())
        left.append(1.0 - float(np.maximum(sharp - blurred, 0.0).sum()) / total if total > 0.0 else 1.0)
    return max(left)
