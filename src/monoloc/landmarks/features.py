"""Keypoints with binary descriptors.

Rublee et al., *ORB: an efficient alternative to SIFT or SURF* (ICCV 2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.contrast import equaliser
from monoloc.geometry import FloatArray
from monoloc.image_size import gray_image

FOCAL_PX = 260.0  # of the images in which keypoints are detected, so that their scales are comparable
MATCH_BITS = 64  # of 256, by which the descriptors of one corner may differ
_LEAST_SIDE_PX = 96.0  # of an image in which keypoints are detected: ORB ignores a margin of 31 px
_KEYPOINTS = 600
_CORNER_SD_PX = 1.0  # standard deviation of a keypoint's position, at the pyramid's finest level
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


@dataclass(frozen=True)
class Keypoints:
    """N corners of one image.

    Attributes:
        pixels: (N, 2) of the detector's camera.
        descriptors: (N, 32) uint8.
        sd_px: (N,) standard deviation of their place.
    """

    pixels: FloatArray
    descriptors: NDArray[np.uint8]
    sd_px: FloatArray

    def select(self, chosen: NDArray[np.int64]) -> Keypoints:
        return Keypoints(self.pixels[chosen], self.descriptors[chosen], self.sd_px[chosen])

    def rays(self, camera: Camera) -> tuple[FloatArray, FloatArray]:
        """Normalised image coordinates (N, 2) and their standard deviations (N, 2), for the camera of the pixels."""
        rays = camera.rays(self.pixels)[:, :2]
        shifts = (camera.rays(self.pixels + self.sd_px[:, None] * step)[:, :2] - rays for step in np.eye(2))
        return rays, np.stack([np.abs(shift[:, axis]) for axis, shift in enumerate(shifts)], axis=1)


class KeypointDetector:
    """Detects keypoints in a camera's images.

    Attributes:
        camera: of the resized images in which keypoints are detected.
    """

    def __init__(self, camera: Camera) -> None:
        width, height = camera.width, camera.height
        factor = max(FOCAL_PX / camera.focal_px, _LEAST_SIDE_PX / min(width, height))
        self.camera = camera.resized(round(width * factor), round(height * factor))
        self._equalise = equaliser()
        library: Any = cv2  # whose stubs lack it
        self._orb = library.ORB_create(nfeatures=_KEYPOINTS, scaleFactor=1.25, nlevels=6, fastThreshold=5)
        self._patch_px = float(self._orb.getPatchSize())

    def __call__(self, color: NDArray[np.uint8]) -> Keypoints:
        """Keypoints of an image (H, W, 3) uint8 RGB."""
        gray = gray_image(color, (self.camera.width, self.camera.height))
        found, descriptors = self._orb.detectAndCompute(self._equalise.apply(gray), None)
        if descriptors is None:
            return Keypoints(np.zeros((0, 2)), np.zeros((0, 32), np.uint8), np.zeros(0))
        pixels = np.array([keypoint.pt for keypoint in found], dtype=np.float64)
        sd_px = np.array([keypoint.size for keypoint in found]) / self._patch_px * _CORNER_SD_PX
        return Keypoints(pixels, descriptors, sd_px)


def match_descriptors(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    radius_px: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Mutual nearest neighbours of landmarks and keypoints within a radius: their indices, (M,) each.

    Args:
        expected: (L, 2) expected pixels of landmarks.
        known: (L, 32) their descriptors.
        pixels: (N, 2) of keypoints.
        descriptors: (N, 32) of keypoints.
    """
    by_x = np.argsort(pixels[:, 0])
    first, last = (np.searchsorted(pixels[by_x, 0], expected[:, 0] + side * radius_px) for side in (-1.0, 1.0))
    counts = last - first
    which = np.repeat(np.arange(len(expected)), counts)
    where = by_x[np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts - first, counts)]
    is_near = np.abs(expected[which, 1] - pixels[where, 1]) < radius_px
    which, where = which[is_near], where[is_near]
    bits = _ONES[known[which] ^ descriptors[where]].sum(axis=1, dtype=np.int64)
    matches = bits < MATCH_BITS
    which, where, bits = which[matches], where[matches], bits[matches]
    order = np.argsort(bits, kind="stable")
    first_which, first_where = np.full(len(expected), -1), np.full(len(pixels), -1)
    first_which[which[order[::-1]]] = order[::-1]  # the last to be written is the best match
    first_where[where[order[::-1]]] = order[::-1]
    both = np.flatnonzero(
        (first_which[which] == np.arange(len(which))) & (first_where[where] == np.arange(len(which)))
    )
    return which[both], where[both]
