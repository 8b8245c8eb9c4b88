"""File and folder access; every problem raises an error of one line that names the fix."""

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
    """Read all bytes of a file; raise DataError if it is unreadable or empty."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path, or restore the file") from error
    if not data:
        raise DataError(path, "is empty", "copy the file again")
    return data


def read_text(path: Path) -> str:
    """Read a text file without its byte-order mark; raise DataError if it is unreadable or not text."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, "is not a text file", "copy the file again") from error


def read_rows(path: Path, columns: int, meaning: str) -> FloatArray:
    """Read rows of numbers separated by white space; empty lines and lines that start with # are skipped.

    Args:
        path: the file.
        columns: number of values in each row.
        meaning: description of a row, for error messages.

    Returns:
        (rows, columns) float64; NaN and infinity are not rejected.

    Raises:
        DataError: the file is unreadable or has no rows, or a row is not ``columns`` numbers.
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
