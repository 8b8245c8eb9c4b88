"""Views of the board: its corners in images, and the choice of sharp views that differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board import COLUMNS, Board
from monoloc.geometry import FloatArray

_LEAST_CORNERS = 10  # of a view; fewer hardly determine the board's pose
_LEAST_LINES = 3  # rows, and columns, of corners
_NEIGHBOURS = 6  # frames of a video of which the sharpest is kept


@dataclass(frozen=True)
class BoardView:
    """The N corners of the board that one image shows.

    Attributes:
        name: of the image.
        ids: (N,) numbers of the corners, see :attr:`Board.corners`.
        pixels: (N, 2).
        outline: (4, 2) where the board's outline is in the image, by a homography.
        sharpness: variance of the image's Laplacian over that of its grey levels, within the board.
    """

    name: str
    ids: NDArray[np.int64]
    pixels: FloatArray
    outline: FloatArray
    sharpness: float


class BoardDetector:
    """Finds the board in images."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._detector = cv2.aruco.CharucoDetector(board.charuco)

    def __call__(self, name: str, gray: NDArray[np.uint8]) -> BoardView | None:
        """The board in an image (H, W), or None where too little of it shows."""
        corners, found, _, _ = self._detector.detectBoard(gray)
        if found is None or len(found) < _LEAST_CORNERS:
            return None
        ids, pixels = np.ravel(found).astype(np.int64), np.reshape(corners, (-1, 2)).astype(np.float64)
        rows, columns = np.divmod(ids, COLUMNS - 1)
        if min(len(np.unique(rows)), len(np.unique(columns))) < _LEAST_LINES:
            return None
        homography, _ = cv2.findHomography(self._board.corners[ids, :2], pixels)
        outline = cv2.perspectiveTransform(self._board.outline[None, :, :2], homography)[0]
        return BoardView(name, ids, pixels, np.asarray(outline, np.float64), _sharpness(gray, pixels))


def _sharpness(gray: NDArray[np.uint8], pixels: FloatArray) -> float:
    (left, top), (right, bottom) = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int)
    patch = gray[max(top, 0) : bottom + 1, max(left, 0) : right + 1].astype(np.float32)
    return float(cv2.Laplacian(patch, cv2.CV_32F).var() / max(patch.var(), 1.0))


def sharp_views(views: Sequence[BoardView]) -> list[BoardView]:
    """The sharpest of every few neighbouring frames of a video."""
    groups = (views[start : start + _NEIGHBOURS] for start in range(0, len(views), _NEIGHBOURS))
    return [max(group, key=lambda view: view.sharpness) for group in groups]


def diverse_views(views: Sequence[BoardView], most: int) -> list[BoardView]:
    """At most so many views, in order, of which each differs as much as possible from all others.

    Two views differ by the distance of the board's outlines in the image: place, distance, tilt and roll change it.
    """
    if len(views) <= most:
        return list(views)
    outlines = np.stack([view.outline for view in views])
    chosen = [int(np.argmax(np.linalg.norm(outlines - outlines.mean(axis=0), axis=2).mean(axis=1)))]
    distance = np.full(len(views), np.inf)
    while len(chosen) < most:
        to_last = np.linalg.norm(outlines - outlines[chosen[-1]], axis=2).mean(axis=1)
        distance = np.minimum(distance, to_last)
        chosen.append(int(np.argmax(distance)))
    return [views[index] for index in sorted(chosen)]
