"""Readers of point cloud files: ply, pcd, xyz, npz."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path

import numpy as np

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.ply import read_ply

Fields = list[tuple[str, str]]  # name and little-endian NumPy type of each value of a point

_PCD_KINDS = {"F": "f", "I": "i", "U": "u"}
_AGAIN = "export the cloud again"
# Errors that NumPy and the parsers below raise for files that are truncated or not clouds.
_UNREADABLE = (OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, zipfile.BadZipFile)


def read_cloud(path: Path) -> FloatArray:
    """Read the points of a cloud file: (N, 3) float64, in the file's frame, metres.

    The suffix selects the format: ``.ply`` (ascii, binary little endian), ``.pcd`` (ascii, binary), ``.xyz`` and
    ``.txt`` (first three columns), ``.npz`` (array ``points``). Other properties and columns are ignored.

    Raises:
        DataError: the file is missing, in an unknown format, truncated or empty, or a point is not finite.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise DataError(path, f"has the unknown suffix {path.suffix!r}", f"give one of {', '.join(sorted(_READERS))}")
    try:
        points = reader(path)
    except FileNotFoundError:
        raise DataError(path, "there is no such file", "check the path") from None
    except _UNREADABLE as error:
        raise DataError(path, f"cannot be read as {path.suffix[1:]} ({error})", _AGAIN) from None
    if len(points) == 0:
        raise DataError(path, "holds no points", _AGAIN)
    broken = int((~np.isfinite(points).all(axis=1)).sum())
    if broken:
        raise DataError(
            path,
            f"{broken} of {len(points)} points are not finite",
            "remove them, for example with np.isfinite, and save the cloud again",
        )
    return points


def _read_ply(path: Path) -> FloatArray:
    vertices = read_ply(path.read_bytes(), "vertex").get("vertex")
    if vertices is None:
        raise ValueError("it has no element 'vertex'")
    columns = list(vertices.values())
    axes = [columns[position] for position in _positions(list(vertices))]
    if any(isinstance(axis, list) for axis in axes):
        raise ValueError("x, y or z are lists")
    return np.stack(axes, axis=1)


def _read_pcd(path: Path) -> FloatArray:
    with path.open("rb") as file:
        header = {words[0].upper(): words[1:] for words in _header(file, "DATA")}
        missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA") if not header.get(key)]
        if missing:
            raise ValueError(f"the header has no {missing[0]}")
        repeats = [int(count) for count in header.get("COUNT", ["1"] * len(header["FIELDS"]))]
        fields: Fields = []
        for name, size, kind, repeat in zip(header["FIELDS"], header["SIZE"], header["TYPE"], repeats, strict=True):
            if kind not in _PCD_KINDS:
                raise ValueError(f"field {name!r} has the unknown type {kind!r}")
            fields += [(name, f"<{_PCD_KINDS[kind]}{size}")] * repeat
        count, encoding = int(header["POINTS"][0]), header["DATA"][0]
        if encoding == "ascii":
            return _ascii_points(file, fields, count)
        if encoding == "binary":
            return _binary_points(file, fields, count)
        raise ValueError(f"DATA {encoding} is neither ascii nor binary")


def _read_xyz(path: Path) -> FloatArray:
    with path.open("rb") as file:
        return _columns(file, (0, 1, 2), None)


def _read_npz(path: Path) -> FloatArray:
    with np.load(path, allow_pickle=False) as file:
        if "points" not in file:
            raise ValueError("it has no array 'points'")
        points = np.asarray(file["points"])
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"points must be numbers of shape (N, 3), got {points.dtype} of shape {points.shape}")
    return points.astype(np.float64)


def _header(file: BufferedReader, last: str) -> list[list[str]]:
    """Words of each header line without comments, up to and including the line that starts with ``last``."""
    lines: list[list[str]] = []
    for raw in file:
        words = raw.decode("ascii", errors="replace").split()
        if words and words[0] not in ("comment", "obj_info") and not words[0].startswith("#"):
            lines.append(words)
            if words[0] == last:
                return lines
    raise ValueError(f"the header has no {last}")


def _positions(names: list[str]) -> tuple[int, int, int]:
    for axis in "xyz":
        if axis not in names:
            raise ValueError(f"points have no property {axis!r}")
    return names.index("x"), names.index("y"), names.index("z")


def _ascii_points(file: BufferedReader, fields: Fields, count: int) -> FloatArray:
    points = _columns(file, _positions([name for name, _ in fields]), count)
    _check_count(len(points), count)
    return points


def _binary_points(file: BufferedReader, fields: Fields, count: int) -> FloatArray:
    positions = _positions([name for name, _ in fields])
    # Fields are named by number: all padding fields of a file share one name.
    dtype = np.dtype([(str(index), kind) for index, (_, kind) in enumerate(fields)])
    data = file.read(max(count, 0) * dtype.itemsize)
    _check_count(len(data) // dtype.itemsize, count)
    vertices = np.frombuffer(data, dtype=dtype)
    return np.column_stack([vertices[str(index)].astype(np.float64) for index in positions])


def _check_count(got: int, count: int) -> None:
    if count < 0:
        raise ValueError("the header does not say how many points there are")
    if got < count:
        raise ValueError(f"it ends after {got} of {count} points")


def _columns(file: BufferedReader, columns: tuple[int, int, int], count: int | None) -> FloatArray:
    if count == 0:
        return np.empty((0, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "input contained no data": an empty file is reported below
        return np.loadtxt(file, dtype=np.float64, usecols=columns, max_rows=count, ndmin=2)


_READERS: dict[str, Callable[[Path], FloatArray]] = {
    ".ply": _read_ply,
    ".pcd": _read_pcd,
    ".xyz": _read_xyz,
    ".txt": _read_xyz,
    ".npz": _read_npz,
}
CLOUD_SUFFIXES = frozenset(_READERS)
