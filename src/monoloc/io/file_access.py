"""File and folder access; every problem raises an error of one line that names the fix."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.errors import DataError
from monoloc.files import MOST_BYTES, read_regular
from monoloc.geometry import FloatArray

_MOST_TEXT_BYTES = 1 << 26
_MOST_SHOWN = 80  # characters of a value in a message


def require_folder(path: Path) -> None:
    """Raise DataError unless ``path`` is a folder."""
    if not path.exists():
        raise DataError(path.absolute(), "does not exist", "check the path")
    if not path.is_dir():
        raise DataError(path, "is a file, not a folder", "give the folder that holds the recording")
    require_access(path)


def require_file(path: Path, fix: str) -> None:
    """Raise DataError, with ``fix``, unless ``path`` is a file."""
    try:
        is_there = path.is_file()
    except (OSError, ValueError):  # its name is too long, or holds a null character
        is_there = False
    if not is_there:
        require_access(path.parent)
        raise DataError(path, "is missing", fix)


def require_access(folder: Path) -> None:
    """Raise DataError if ``folder`` is there but may not be listed: its files would seem to be missing."""
    try:
        is_closed = os.access(folder, os.F_OK) and not os.access(folder, os.R_OK | os.X_OK)
    except ValueError:  # its name holds a null character
        return
    if is_closed:
        raise DataError(folder, "may not be read", f"its owner can allow it: chmod -R a+rX {folder}")


def visible(folder: Path, ending: str = "") -> list[Path]:
    """Files of a folder by the end of their name, without the ``._`` files that macOS leaves on other disks."""
    return [file for file in folder.glob(f"*{ending}") if not file.name.startswith(".")]


def read_bytes(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read all bytes of a file; raise DataError if it is unreadable, empty or larger."""
    try:
        data = read_regular(path, most_bytes)
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        raise DataError(path, f"cannot be read ({problem})", "check the path, or restore the file") from error
    if not data:
        raise DataError(path, "is empty", "copy the file again")
    return data


def read_text(path: Path) -> str:
    """Read a text file without its byte-order mark; raise DataError if it is unreadable, not text or large."""
    try:
        return read_bytes(path, _MOST_TEXT_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(path, "is not a text file", "copy the file again, or save it as UTF-8") from error


def read_rows(path: Path, columns: int, meaning: str, *, optional: int = 0) -> FloatArray:
    """Read rows of numbers separated by white space; empty lines and lines that start with # are skipped.

    Args:
        path: the file.
        columns: number of values in each row.
        meaning: description of a row, for error messages.
        optional: number of further values that all rows may have.

    Returns:
        (rows, columns) or (rows, columns + optional) float64; NaN and infinity are not rejected.

    Raises:
        DataError: the file is unreadable or has no rows, or a row is not that many numbers.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        expected = (len(rows[0]),) if rows else (columns, columns + optional)
        if len(row) not in expected:
            separators = ", separated by spaces, with decimal points" if "," in line or ";" in line else ""
            separators += "; a heading begins with #" if not rows and not row else ""
            problem = f"line {number} is not {expected[0]} numbers"
            raise DataError(path, problem, f"each line holds: {meaning}{separators}")
        rows.append(row)
    if not rows:
        raise DataError(path, "has no lines of numbers", f"each line holds: {meaning}")
    return np.array(rows)


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; raise DataError if the file is unreadable or not an object."""
    return decode_json(read_text(path), path)


def decode_json(text: str, path: Path) -> dict[str, Any]:
    """Parse a JSON object; raise DataError, which names ``path``, if it is not one."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise DataError(path, f"is not valid JSON ({error})", "export the recording again") from error
    if not isinstance(content, dict):
        raise DataError(path, "is not a JSON object", "export the recording again")
    return content


def finite_number(value: object) -> float | None:
    """A number of TOML or JSON; None of anything else, such as NaN or a whole number beyond 1e308."""
    number = numbers_of(value)
    return float(number) if number.shape == () and np.isfinite(number) else None


def numbers_of(value: object) -> FloatArray:
    """Nested lists of TOML or JSON as an array; an empty one where not all are numbers, such as texts and true."""
    content = np.array(value, dtype=object)
    # TOML's and JSON's true becomes Python's True, which is an int.
    if not all(isinstance(each, int | float) and not isinstance(each, bool) for each in content.ravel()):
        return np.empty(0)
    try:
        return content.astype(np.float64)
    except OverflowError:
        return np.empty(0)


def json_number(content: dict[str, Any], key: str, path: Path) -> float:
    """A finite number of a JSON object; raise DataError if it is missing or something else."""
    number = finite_number(content.get(key))
    if number is None:
        raise DataError(path, f"{key} is {brief(content.get(key))}, not a number", "export the recording again")
    return number


def brief(value: object) -> str:
    """A value of a file for a message of one line."""
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."


def json_rows(content: dict[str, Any], key: str, columns: int, path: Path) -> FloatArray:
    """Rows of numbers of a JSON object, (rows, columns); NaN and infinity are not rejected.

    Raises:
        DataError: the key is missing, or is not a list of lists of that many numbers.
    """
    rows = numbers_of(content.get(key))
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise DataError(path, f"{key} is not a list of {columns} numbers each", "export the recording again")
    return rows
