"""The calibration board: a chessboard whose white squares carry markers (ChArUco), so that part of it is enough.

Garrido-Jurado et al., *Automatic generation and detection of highly reliable fiducial markers under occlusion*
(2014).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray

COLUMNS, ROWS = 8, 6  # squares: 240 x 180 mm at 30 mm, with a margin on A4 and on Letter
DEFAULT_SQUARE_MM = 30.0
MODULES = 8  # of a square, along a side; a marker is 6 of them, its border included
_MARKER_SHARE = 6.0 / MODULES
_DICTIONARY, _DICTIONARY_NAME = cv2.aruco.DICT_4X4_50, "DICT_4X4_50"
_MOST_MM = 1000.0


@dataclass(frozen=True)
class Board:
    """The board, printed at some size.

    Attributes:
        square_mm: side of a square.

    Raises:
        SettingError: the side is not from 1 to 1000 mm.
    """

    square_mm: float = DEFAULT_SQUARE_MM

    def __post_init__(self) -> None:
        if not 1.0 <= self.square_mm <= _MOST_MM:  # false for NaN
            fix = f"measure the side of a square on the printed board, from 1 to {_MOST_MM:.0f} mm"
            raise SettingError("square_mm", f"is {self.square_mm}", fix)

    @property
    def name(self) -> str:
        return f"ChArUco {COLUMNS}x{ROWS} {_DICTIONARY_NAME}, square {self.square_mm:g} mm"

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the pattern."""
        return COLUMNS * self.square_mm, ROWS * self.square_mm

    @cached_property
    def charuco(self) -> Any:
        """OpenCV's board, lengths in metres."""
        square_m = self.square_mm / 1000.0
        dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
        return cv2.aruco.CharucoBoard((COLUMNS, ROWS), square_m, _MARKER_SHARE * square_m, dictionary)

    @cached_property
    def corners(self) -> FloatArray:
        """Inner corners of the chessboard by number, (N, 3) m, board's frame: x right, y down, z away, z = 0."""
        return np.asarray(self.charuco.getChessboardCorners(), dtype=np.float64)

    @cached_property
    def outline(self) -> FloatArray:
        """Corners of the pattern, (4, 3) m, clockwise from the origin, as :attr:`corners`."""
        width, height = (length / 1000.0 for length in self.size_mm)
        return np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0], [width, height, 0.0], [0.0, height, 0.0]])

    def modules(self) -> NDArray[np.bool_]:
        """Which modules are black, (rows, columns), :data:`MODULES` to a square."""
        image = self.charuco.generateImage((COLUMNS * MODULES, ROWS * MODULES), marginSize=0, borderBits=1)
        return np.asarray(image) < 128
