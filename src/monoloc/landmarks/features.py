"""Keypoints with binary descriptors.

Rublee et al., *ORB: an efficient alternative to SIFT or SURF* (ICCV 2011).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import monoloc._core as _core
from monoloc.camera import Camera
from monoloc.contrast import equaliser
from monoloc.geometry import FloatArray
from monoloc.image_size import gray_image

FOCAL_PX = 330.0  # of the images in which keypoints are detected, so that their scales are comparable
MATCH_BITS = 64  # of 256, by which the descriptors of one corner may differ
_LEAST_SIDE_PX = 96.0  # of an image in which keypoints are detected
_KEYPOINTS = 600
# Width of the border without keypoints. ORB's 31 px would be a third of the image; here, descriptors near the border
# read a few mirrored pixels.
_MARGIN_PX = 12
# FAST's threshold, and a lower one for dim images: those with fewer keypoints than _FEW_KEYPOINTS.
_THRESHOLD, _LOW_THRESHOLD, _FEW_KEYPOINTS = 12, 5, 450
_CORNER_SD_PX = 1.0  # standard deviation of a keypoint's position, at the pyramid's finest level


@dataclass(frozen=True)
class Keypoints:
    """N corners of one image.

    Attributes:
        pixels: (N, 2) of the detector's camera.
        descriptors: (N, 32) uint8.
        sd_px: (N,) standard deviations of their positions.
    """

    pixels: FloatArray
    descriptors: NDArray[np.uint8]
    sd_px: FloatArray

    def select(self, chosen: NDArray[np.int64]) -> Keypoints:
        return Keypoints(self.pixels[chosen], self.descriptors[chosen], self.sd_px[chosen])

    def rays(self, camera: Camera) -> tuple[FloatArray, FloatArray]:
        """Normalised image coordinates (N, 2) and their standard deviations (N, 2), for the camera of the pixels."""
        rays = camera.rays(self.pixels)[:, :2]
        return rays, self.sd_px[:, None] * camera.ray_spread(rays)


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
        self._orb, self._sensitive_orb = (
            library.ORB_create(
                nfeatures=_KEYPOINTS, scaleFactor=1.25, nlevels=6, edgeThreshold=_MARGIN_PX, fastThreshold=threshold
            )
            for threshold in (_THRESHOLD, _LOW_THRESHOLD)
        )
        self._patch_px = float(self._orb.getPatchSize())

    def __call__(self, color: NDArray[np.uint8]) -> Keypoints:
        """Keypoints of an image (H, W, 3) uint8 RGB."""
        gray = self._equalise.apply(gray_image(color, (self.camera.width, self.camera.height)))
        found, descriptors = self._orb.detectAndCompute(gray, None)
        if len(found) < _FEW_KEYPOINTS:
            found, descriptors = self._sensitive_orb.detectAndCompute(gray, None)
        if descriptors is None:
            return Keypoints(np.zeros((0, 2)), np.zeros((0, 32), np.uint8), np.zeros(0))
        pixels = np.array([keypoint.pt for keypoint in found], dtype=np.float64)
        sd_px = np.array([keypoint.size for keypoint in found]) / self._patch_px * _CORNER_SD_PX
        return Keypoints(pixels, descriptors, sd_px)

    def reaches(self, pixels: FloatArray) -> NDArray[np.bool_]:
        """Whether keypoints are detected at pixels (N, 2) of the camera, (N,): none are near the border."""
        beyond = np.array([self.camera.width, self.camera.height]) - _MARGIN_PX
        return np.asarray(np.all((pixels >= _MARGIN_PX) & (pixels < beyond), axis=1))


def match_descriptors(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    radius_px: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Mutual nearest neighbours of landmarks and keypoints within a radius: their indices, (M,) each.

    Of several that are as near, the first landmark counts, and the keypoint with the least x, then the first. NumPy
    twin: :func:`monoloc.landmarks.landmark_numpy_twins.match_descriptors`.

    Args:
        expected: (L, 2) expected pixels of landmarks; one with a NaN matches none.
        known: (L, 32) their descriptors.
        pixels: (N, 2) of keypoints.
        descriptors: (N, 32) of keypoints.
    """
    return _core.match_descriptors(expected, known, pixels, descriptors, radius_px, MATCH_BITS)


def nearest_descriptors(
    descriptors: NDArray[np.uint8], known: NDArray[np.uint8], count: int, most_bits: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The most similar known descriptors, most similar first; of several that are as similar, the first.

    All pairs are compared: half a second for 600 descriptors and a million known ones. NumPy twin:
    :func:`monoloc.landmarks.landmark_numpy_twins.nearest_descriptors`.

    Args:
        descriptors: (N, 32).
        known: (L, 32).
        count: C, at most L.
        most_bits: only those that differ by fewer count.

    Returns:
        Differing bits and indices, (N, C) each; where fewer count, 257 and 0 in the rest of the row.
    """
    return _core.nearest_descriptors(descriptors, known, count, most_bits)
