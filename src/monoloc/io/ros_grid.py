"""Writer of occupancy grids as ROS's map_server reads them: NAME.yaml and the picture NAME.pgm beside it.

Format: https://wiki.ros.org/map_server, and nav2's map_io.cpp. Occupied is black, free nearly white, unknown grey;
with the thresholds of the file, both servers take them back as such. The picture's first row is the grid's last.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc.geometry import FloatArray

GREY_OCCUPIED: Final = 0
GREY_UNKNOWN: Final = 205
GREY_FREE: Final = 254
"""Grey levels of the picture."""

_YAML = """\
image: {image}
mode: trinary
resolution: {cell_m:.9g}
origin: [{x:.9g}, {y:.9g}, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def picture_of(path: Path) -> Path:
    """The picture that belongs to a grid's .yaml."""
    return path.with_suffix(".pgm")


def write_ros_grid(path: Path, grey: NDArray[np.uint8], lower: FloatArray, cell_m: float) -> None:
    """Write a grid.

    Args:
        path: NAME.yaml.
        grey: (X, Y) of the levels above: x to the right, y up on the picture.
        lower: (2,) lower corner of the first cell, metres, in the frame ``map``.
        cell_m: edge of a cell.

    Raises:
        DataError: a file cannot be written, or the picture's name does not fit on a line of the other.
    """
    image = picture_of(path)
    if not image.name.isprintable() or image.name != image.name.strip():
        raise DataError(path, "has a name that YAML would not read back", "name it NAME.yaml in plain characters")
    width, height = grey.shape
    write_whole(image, f"P5\n{width} {height}\n255\n".encode() + np.ascontiguousarray(grey.T[::-1]).tobytes())
    name = "'" + image.name.replace("'", "''") + "'"
    write_whole(path, _YAML.format(image=name, cell_m=cell_m, x=lower[0], y=lower[1]).encode())
