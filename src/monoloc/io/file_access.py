"""Opening files and folders so that whatever is wrong with them is one line naming the fix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from monoloc.errors import DataError
from monoloc.geometry import FloatArray


def require_folder(path: Path) -> None:
    """Raise DataError unless ``path`` is a folder."""
    if not path.exists():
        raise DataError(path.absolute(), "does not exist", "check the path")
    if not path.is_dir():
        raise DataError(path, "is a file, not a folder", "give the folder that holds the recording")


def require_file(path: Path, fix: str) -> None:
    """Raise DataError, with ``fix``, unless ``path`` is a file."""
    try:
        is_there = path.is_file()
    except OSError:  # its name is too long
        is_there = False
    if not is_there:
        raise DataError(path, "is missing", fix)


def read_bytes(path: Path) -> bytes:
    """All bytes of a file; DataError where it cannot be read or is empty."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path, or restore the file") from error
    if not data:
        raise DataError(path, "is empty", "copy the file again")
    return data


def read_text(path: Path) -> str:
    """All text of a file, less a byte-order mark; DataError where it cannot be read or is not text."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, "is not a text file", "copy the file again") from error


def read_rows(path: Path, columns: int, meaning: str) -> FloatArray:
    """Rows of numbers separated by blanks; lines that are empty or begin with # are skipped.

    Args:
        columns: how many numbers each row has.
        meaning: what a row holds, for the message.

    Returns:
        (rows, columns) float64; NaN and infinity are passed on.

    Raises:
        DataError: unreadable file, no rows at all, or a row with another count or something not a number.
    """
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != columns:
            raise DataError(path, f"line {number} is not {columns} numbers", f"each line holds: {meaning}")
        rows.append(row)
    if not rows:
        raise DataError(path, "has no lines of numbers", f"each line holds: {meaning}")
    return np.array(rows)
