"""Reader of a gyroscope's samples: CSV with the columns ``t_s,wx,wy,wz``, as ``monoloc synth flight`` writes them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text
from monoloc.io.pose_files import check_increasing

_MOST_RAD_S = 70.0  # 4000 degrees a second, about the largest range of small gyroscopes
_COLUMNS = ("t_s", "wx", "wy", "wz")


def read_gyroscope(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read samples: increasing times (N,) in seconds and angular velocities (N, 3) in rad/s, N >= 1.

    Other columns, such as those of an accelerometer, are ignored.

    Raises:
        DataError: the file cannot be read, lacks a column or samples, has a line that is no sample, or the times do
            not increase.
    """
    lines = csv.DictReader(read_text(path).splitlines())
    try:
        if not set(_COLUMNS) <= set(lines.fieldnames or ()):
            fix = f"write {','.join(_COLUMNS)} in the first line: seconds, and rad/s about forward, left and up"
            raise DataError(path, "has no columns of a gyroscope", fix)
        rows = [[float(line[name]) for name in _COLUMNS] for line in lines]
    except (TypeError, ValueError, csv.Error) as error:
        raise DataError(path, f"line {max(1, lines.line_num)} is no sample", "remove this line") from error
    if not rows:
        raise DataError(path, "has no samples", "give a file with at least one a frame")
    samples = np.array(rows)
    check_increasing(samples[:, 0], path)
    finite = np.isfinite(samples).all(axis=1)
    if not finite.all():
        raise DataError(path, f"sample {int(np.argmin(finite)) + 1} is NaN or infinite", "remove this line")
    is_fast = (np.abs(samples[:, 1:]) > _MOST_RAD_S).any(axis=1)
    if is_fast.any():
        row = int(np.argmax(is_fast))
        fastest = np.abs(samples[row, 1:]).max()
        raise DataError(path, f"sample {row + 1} turns by {fastest:.3g} rad/s", "write rad/s, not degrees")
    return samples[:, 0], samples[:, 1:]
