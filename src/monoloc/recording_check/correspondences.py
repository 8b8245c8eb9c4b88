"""Corners matched between neighbouring frames of a recording, with which its poses, depth and camera are compared.

Sources: Shi & Tomasi 1994 (corners); Bouguet 2000 (pyramidal Lucas-Kanade); Kalal et al. 2010 (forward-backward
check).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.contrast import equaliser, has_contrast
from monoloc.depth.depth_image import sample_depth
from monoloc.geometry import FloatArray
from monoloc.image_size import gray_image
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.odometry.corner_tracking import find_corners, track_corners
from monoloc.odometry.odometry_config import OdometryConfig

DepthOf = Callable[[int], NDArray[np.float32]]
MatchedPair = tuple[tuple[int, int], NDArray[np.float32]]  # two frames, and their matches (M, 2, 2)

PAIRS = 30
"""Number of pairs of frames that are compared."""

LEAST_MATCHES = 20
"""Number of matches, with fewer of which a pair is left out."""

LEAST_MOTION = 0.01
"""Median motion of a pair's corners, share of the image's width, with less of which it is left out."""

_TRACKING = OdometryConfig()  # the odometry's settings for corners
_STEPS = (1, 2, 4, 8)  # frames apart; the first that moves far enough is used
_ENOUGH_MOTION = 0.05  # median motion of the corners, share of the image's width
_LEAST_CORNERS = 30  # of a frame
_MOST_MATCHES = 120  # of a pair: enough for a median


@dataclass(frozen=True)
class Matches:
    """P corners matched over N pairs of frames.

    Attributes:
        camera: of the images in which corners are matched, which may be smaller than those of the recording.
        frames: (N, 2) indices of the two frames of each pair.
        pair: (P,) index of the pair of each match, ascending.
        pixels: (P, 2, 2) where the corner is in the first and in the second frame, pixels of ``camera``.
        motion_px: (N,) median motion of the pair's corners.
    """

    camera: Camera
    frames: NDArray[np.int64]
    pair: NDArray[np.int64]
    pixels: NDArray[np.float32]
    motion_px: FloatArray

    def __len__(self) -> int:
        return len(self.frames)

    def of_pair(self, index: int) -> slice:
        """The matches of one pair."""
        first, last = np.searchsorted(self.pair, [index, index + 1])
        return slice(int(first), int(last))

    def select(self, pairs: NDArray[np.int64]) -> Matches:
        """The matches of some pairs, in ascending order."""
        kept = np.isin(self.pair, pairs)
        renumbered = np.searchsorted(pairs, self.pair[kept])
        return Matches(self.camera, self.frames[pairs], renumbered, self.pixels[kept], self.motion_px[pairs])

    def rays(self) -> tuple[FloatArray, FloatArray]:
        """Rays with z = 1 of the corners in the first and in the second frame, (P, 3) each."""
        return self.camera.rays(self.pixels[:, 0]), self.camera.rays(self.pixels[:, 1])

    def depth_m(self, recording: Recording, depth_of: DepthOf) -> FloatArray:
        """Depth of the corners in the first frame, (P,) metres; 0 where it is unknown or at an occlusion edge.

        Args:
            recording: the one that was matched.
            depth_of: returns the depth (H, W) m of a frame.
        """
        depth = np.zeros(len(self.pair))
        for index, first in enumerate(self.frames[:, 0].tolist()):
            of = self.of_pair(index)
            depth[of] = sample_depth(
                self.pixels[of, 0], self.camera, depth_of(first), recording.camera, _TRACKING.depth_jump
            )
        return depth


def match_corners(recording: Recording, pairs: int = PAIRS) -> Matches:
    """Match corners over pairs of neighbouring frames, spread over the recording.

    The frames of a pair are 1, 2, 4 or 8 frames apart, so that their corners move by 5 % of the image's width if
    they can. Pairs with too little motion or too few corners are left out.

    Args:
        recording: to match.
        pairs: most that are matched.

    Raises:
        DataError: a frame cannot be read.
    """
    images = tracking_images(recording)
    starts = evenly_spaced(len(recording) - 1, pairs) if len(recording) > 1 else np.zeros(0, np.int64)
    count, least_px = len(recording), LEAST_MOTION * images.camera.width
    found = [pair for start in starts.tolist() if (pair := _match(images, start, count, least_px)) is not None]
    return joined_pairs(images.camera, found, np.array([median_motion_px(pixels) for _, pixels in found]))


def match_neighbours(recording: Recording, starts: Iterable[int]) -> Matches:
    """Match corners from frames to those that follow them, however little they move; ``motion_px`` is 1.

    Raises:
        DataError: a frame cannot be read.
    """
    images = tracking_images(recording)
    found = [pair for start in starts if (pair := _match(images, start, start + 2, 0.0)) is not None]
    return joined_pairs(images.camera, found, np.ones(len(found)))


def joined_pairs(camera: Camera, found: list[MatchedPair], motion_px: FloatArray) -> Matches:
    """The matches of pairs, with the motion of each."""
    return Matches(
        camera,
        frames=np.array([frames for frames, _ in found], dtype=np.int64).reshape(-1, 2),
        pair=np.repeat(np.arange(len(found)), [len(pixels) for _, pixels in found]),
        pixels=np.concatenate([np.zeros((0, 2, 2), np.float32), *(pixels for _, pixels in found)]),
        motion_px=motion_px,
    )


def tracking_images(recording: Recording) -> TrackingImages:
    """A recording's images at the size in which the odometry tracks corners."""
    width, height = recording.camera.width, recording.camera.height
    factor = min(1.0, _TRACKING.width / width)
    return TrackingImages(recording, recording.camera.resized(round(width * factor), round(height * factor)))


class TrackingImages:
    """Equalised grey images (h, w) uint8 of a recording, in the size of ``camera``."""

    def __init__(self, recording: Recording, camera: Camera) -> None:
        self.camera = camera
        self._recording, self._equalise = recording, equaliser()

    def __call__(self, index: int) -> NDArray[np.uint8] | None:
        """None where the image shows nothing."""
        color = self._recording.color(index)
        if not has_contrast(color):
            return None
        gray = gray_image(color, (self.camera.width, self.camera.height))
        return np.asarray(self._equalise.apply(gray), dtype=np.uint8)


def median_motion_px(pixels: NDArray[np.float32]) -> float:
    """Median distance between the two places of corners (M, 2, 2)."""
    return float(np.median(np.linalg.norm(pixels[:, 1] - pixels[:, 0], axis=1)))


def _match(images: TrackingImages, start: int, count: int, least_px: float) -> MatchedPair | None:
    """The pair of frames from ``start`` on, and its matches (M, 2, 2); None if it has none, or moves less."""
    before = images(start)
    if before is None:
        return None
    corners = find_corners(before, _TRACKING.corners, _TRACKING)
    if len(corners) < _LEAST_CORNERS:
        return None
    best = None
    for step in _STEPS:
        after = images(start + step) if start + step < count else None
        matched = None if after is None else _follow(before, after, corners)
        if matched is None or len(matched) < LEAST_MATCHES:
            break
        best = (start, start + step), matched
        if median_motion_px(matched) > _ENOUGH_MOTION * images.camera.width:
            break
    if best is None or median_motion_px(best[1]) < least_px:
        return None
    frames, pixels = best
    return frames, pixels[evenly_spaced(len(pixels), _MOST_MATCHES)]


def _follow(before: NDArray[np.uint8], after: NDArray[np.uint8], corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Corners (N, 2) that are found again, and found back from there: (M, 2, 2)."""
    forward, valid = track_corners(before, after, corners, _TRACKING)
    return np.asarray(np.stack([corners, forward], axis=1)[valid], dtype=np.float32)
