"""Corners of an image, and corners followed from one image to the next.

Sources: Shi & Tomasi 1994 (corners); Bouguet 2000 (pyramidal Lucas-Kanade); Kalal et al. 2010 (forward-backward
check).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.odometry.odometry_config import OdometryConfig

_LEVELS, _NEAR_LEVELS = 3, 1  # of the image pyramid above the image, without and with expected pixels
_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.03)  # iterations a level, and px of the last one
_LEAST_QUALITY = 0.005  # of a corner, share of the best one's
_ENOUGH_TRACKED = 0.6  # share of the corners; if fewer are found, what was expected may be wrong


def find_corners(
    gray: NDArray[np.uint8], most: int, config: OdometryConfig, free: NDArray[np.uint8] | None = None
) -> NDArray[np.float32]:
    """The best corners of a grey image (H, W), at most so many, (N, 2) pixels.

    Args:
        free: (H, W), 0 where no corner may be; None allows them everywhere.
    """
    found: Any = cv2.goodFeaturesToTrack(gray, most, _LEAST_QUALITY, config.min_distance_px, mask=free)
    corners = np.zeros((0, 2)) if found is None else found
    return np.asarray(corners, dtype=np.float32).reshape(-1, 2)


def follow_corners(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    pixels: NDArray[np.float32],
    expected: NDArray[np.float32],
    config: OdometryConfig,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """As :func:`track_corners`, from expected pixels (N, 2); if few are found, also from where corners were."""
    near = _track(before, after, pixels, expected, _NEAR_LEVELS, config)
    if near[1].sum() >= _ENOUGH_TRACKED * len(pixels):
        return near
    tries = [_track(before, after, pixels, start, _LEVELS, config) for start in (expected, pixels)]
    return max(tries, key=lambda tracked: int(tracked[1].sum()))


def track_corners(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    pixels: NDArray[np.float32],
    config: OdometryConfig,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Track corners (N, 2) of one grey image (H, W) into another, by pyramidal Lucas-Kanade.

    Returns:
        Their pixels (N, 2), and which are found and, tracked back, lead to where they began, (N,).
    """
    return _track(before, after, pixels, pixels, _LEVELS, config)


def _track(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    pixels: NDArray[np.float32],
    start: NDArray[np.float32],
    levels: int,
    config: OdometryConfig,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Forward from ``start`` (N, 2), and back from there, over the pyramid's levels."""
    search = partial(
        cv2.calcOpticalFlowPyrLK,
        winSize=(config.search_px, config.search_px),
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    forward, found, _ = search(before, after, pixels, start.copy(), maxLevel=levels)
    # The way back begins by the same shift: from the corners themselves, it would always lead to them.
    back, found_back, _ = search(after, before, forward, forward + (pixels - start), maxLevel=levels)
    distance = np.linalg.norm(back - pixels, axis=1)
    valid = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (distance < config.forward_backward_px)
    return np.asarray(forward, dtype=np.float32), valid
