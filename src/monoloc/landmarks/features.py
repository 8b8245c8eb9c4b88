"""Landmarks: corners of a room that are known by what they look like.

What a network says of a view that it was never shown errs in one way from frame to frame; that a corner is where the
build saw it does not depend on what the network has learnt. Corners and descriptors are those of Rublee et al.,
*ORB: an efficient alternative to SIFT or SURF* (ICCV 2011).
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

FOCAL_PX = 260.0  # at which corners are looked for, so that theirs are of one size; small images are enlarged
ALIKE_BITS = 64  # of 256, by which descriptors of one corner may differ
_LEAST_SIDE_PX = 96.0  # of an image in which corners are looked for: ORB leaves a margin of 31 px out
_KEYPOINTS = 600
_CORNER_SD_PX = 1.0  # of a keypoint's place, at the pyramid's lowest level
_ONES = np.array([bin(byte).count("1") for byte in range(256)], dtype=np.uint8)


@dataclass(frozen=True)
class Landmarks:
    """L corners of a room.

    Attributes:
        points: (L, 3) float32, world frame, metres.
        descriptors: (L, 32) uint8, binary.

    Raises:
        ValueError: they are of other shapes or types.
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
        """At a depth of one, x and y, (N, 2), and their standard deviations, (N, 2); of the camera of the pixels."""
        rays = camera.rays(self.pixels)[:, :2]
        aside = (camera.rays(self.pixels + self.sd_px[:, None] * step)[:, :2] - rays for step in np.eye(2))
        return rays, np.stack([np.abs(off[:, axis]) for axis, off in enumerate(aside)], axis=1)


class KeypointDetector:
    """Corners of a camera's images.

    Attributes:
        camera: of the images in which corners are looked for.
    """

    def __init__(self, camera: Camera) -> None:
        width, height = camera.width, camera.height
        share = max(FOCAL_PX / camera.focal_px, _LEAST_SIDE_PX / min(width, height))
        self.camera = camera.resized(round(width * share), round(height * share))
        self._interpolation = cv2.INTER_AREA if share < 1.0 else cv2.INTER_LINEAR
        self._equalise = equaliser()
        library: Any = cv2  # whose stubs lack it
        self._orb = library.ORB_create(nfeatures=_KEYPOINTS, scaleFactor=1.25, nlevels=6, fastThreshold=5)
        self._patch_px = float(self._orb.getPatchSize())

    def __call__(self, color: NDArray[np.uint8]) -> Keypoints:
        """Of an image (H, W, 3) uint8 RGB."""
        size = (self.camera.width, self.camera.height)
        gray = cv2.cvtColor(cv2.resize(color, size, interpolation=self._interpolation), cv2.COLOR_RGB2GRAY)
        found, descriptors = self._orb.detectAndCompute(self._equalise.apply(gray), None)
        if descriptors is None:
            return Keypoints(np.zeros((0, 2)), np.zeros((0, 32), np.uint8), np.zeros(0))
        pixels = np.array([keypoint.pt for keypoint in found], dtype=np.float64)
        sd_px = np.array([keypoint.size for keypoint in found]) / self._patch_px * _CORNER_SD_PX
        return Keypoints(pixels, descriptors, sd_px)


def pairs(
    expected: FloatArray,
    known: NDArray[np.uint8],
    pixels: FloatArray,
    descriptors: NDArray[np.uint8],
    reach_px: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Landmarks and keypoints that are each other's likest within reach: their indices, (M,) each.

    Args:
        expected: (L, 2) where landmarks should be seen; ``known``: (L, 32) their descriptors.
        pixels: (N, 2) where keypoints are; ``descriptors``: (N, 32) theirs.
    """
    by_x = np.argsort(pixels[:, 0])
    first, last = (np.searchsorted(pixels[by_x, 0], expected[:, 0] + side * reach_px) for side in (-1.0, 1.0))
    counts = last - first
    which = np.repeat(np.arange(len(expected)), counts)
    where = by_x[np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts - first, counts)]
    is_near = np.abs(expected[which, 1] - pixels[where, 1]) < reach_px
    which, where = which[is_near], where[is_near]
    bits = _ONES[known[which] ^ descriptors[where]].sum(axis=1, dtype=np.int64)
    alike = bits < ALIKE_BITS
    which, where, bits = which[alike], where[alike], bits[alike]
    order = np.argsort(bits, kind="stable")
    first_which, first_where = np.full(len(expected), -1), np.full(len(pixels), -1)
    first_which[which[order[::-1]]] = order[::-1]  # the last to be written is the likest
    first_where[where[order[::-1]]] = order[::-1]
    both = np.flatnonzero(
        (first_which[which] == np.arange(len(which))) & (first_where[where] == np.arange(len(which)))
    )
    return which[both], where[both]
