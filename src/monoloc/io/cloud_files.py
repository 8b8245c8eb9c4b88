"""Readers of point cloud files: ply, pcd, xyz, csv, npz, and COLMAP's points3D."""

from __future__ import annotations

import codecs
import itertools
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from monoloc.array_files import read_arrays
from monoloc.errors import DataError
from monoloc.files import read_regular
from monoloc.geometry import MAX_DISTANCE_M, FloatArray
from monoloc.io.binary_reader import BinaryReader
from monoloc.io.mesh_sampling import sample_triangles, triangles_of
from monoloc.io.pcd import read_pcd
from monoloc.io.ply import Column, read_ply

_AGAIN = "export the cloud again"
# Errors that NumPy and the parsers below raise for files that are truncated or not clouds.
_UNREADABLE = (OSError, EOFError, ValueError, TypeError, LookupError, AttributeError, zipfile.BadZipFile)
_POINTS_3D = "points3D"


def read_cloud(path: Path, notes: list[str] | None = None) -> FloatArray:
    """Read the points of a cloud file: (N, 3) float64, in the file's frame, metres.

    The suffix selects the format: ``.ply`` (ascii, binary), ``.pcd`` (ascii, binary, compressed), ``.xyz``, ``.txt``
    and ``.csv`` (columns x, y, z of the header, or the first three), ``.npz`` (array ``points``), and COLMAP's
    ``points3D.bin`` and ``points3D.txt``. Other properties and columns are ignored. To the vertices of a mesh in a
    ``.ply``, points on its faces are added. Points that are not finite, or farther
    than 100 km from the origin, are left out.

    Args:
        path: the file.
        notes: receives a sentence on what was left out or added.

    Raises:
        DataError: the file is missing, in an unknown format, truncated or empty, or no point is finite.
    """
    path, notes = Path(path), [] if notes is None else notes
    reader = _reader_of(path)
    if reader is None:
        raise DataError(path, f"has the unknown suffix {path.suffix!r}", f"give one of {', '.join(sorted(_READERS))}")
    if path.exists() and not path.is_file():
        raise DataError(path, "is not a regular file", "give a file")
    try:
        points = reader(path, notes)
    except FileNotFoundError:
        raise DataError(path, "there is no such file", "check the path") from None
    except _UNREADABLE as error:
        raise DataError(path, f"cannot be read as {path.suffix[1:]} ({error})", _AGAIN) from None
    if len(points) == 0:
        raise DataError(path, "holds no points", _AGAIN)
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise DataError(path, f"none of its {len(points)} points is finite", _AGAIN)
    is_far = finite & (np.abs(points) > MAX_DISTANCE_M).any(axis=1)
    usable = finite & ~is_far
    if not usable.any():
        raise DataError(path, "all its points are 100 km from the origin and farther", "subtract an offset from them")
    for left_out, why in ((~finite, "they are not finite"), (is_far, "they are farther than 100 km from the origin")):
        if left_out.any():
            notes.append(f"{int(left_out.sum())} of {len(points)} points are left out: {why}")
    return np.asarray(points[usable])


def _reader_of(path: Path) -> Callable[[Path, list[str]], FloatArray] | None:
    if path.stem == _POINTS_3D and path.suffix == ".txt":
        return _read_points_3d_text
    return _READERS.get(path.suffix.lower())


def _read_ply(path: Path, notes: list[str]) -> FloatArray:
    elements = read_ply(read_regular(path), "vertex", "face")
    vertices = elements.get("vertex")
    if vertices is None:
        raise ValueError("it has no element 'vertex'")
    axes = []
    for axis in "xyz":
        if axis not in vertices:
            raise ValueError(f"points have no property {axis!r}")
        axes.append(vertices[axis])
    if any(isinstance(axis, list) for axis in axes):
        raise ValueError("x, y or z are lists")
    points = np.stack(axes, axis=1)
    corners = _corners(elements.get("face", {}))
    if not corners:
        return points
    sampled = sample_triangles(points, triangles_of(corners, len(points)))
    notes.append(f"{len(sampled)} points on the faces of a mesh are added to its {len(points)} vertices")
    return np.concatenate([points, sampled])


def _corners(faces: dict[str, Column]) -> list[FloatArray]:
    """Vertex indices of each face; none of files without a mesh."""
    for name in ("vertex_indices", "vertex_index"):
        column = faces.get(name)
        if isinstance(column, list):
            return column
    return []


def _read_pcd(path: Path, _: list[str]) -> FloatArray:
    return read_pcd(path)


def _read_columns(path: Path, _: list[str]) -> FloatArray:
    """Columns named by a first line, or in the order x, y, z; see :func:`_columns`."""
    with path.open("rb") as file:
        start = file.readline()
        first = start.decode("utf-8-sig", errors="replace")
        titles = first.lower().lstrip("#/ ").replace('"', "")
        names = [(title.split() or [""])[0] for title in titles.strip().split(_separator(titles))]
        if not {"x", "y", "z"} <= set(names):
            file.seek(len(codecs.BOM_UTF8) if start.startswith(codecs.BOM_UTF8) else 0)
            return _columns(file, (0, 1, 2), path)
        row = next(_filled(file), b"")
        cells = _cells(row)
        if cells and not _are_as_many(names, cells):  # a sentence, or a column without a name: which is which?
            problem = f"has {len(cells)} columns, and its first line names {len(names)}"
            raise DataError(path, problem, "name each column by one word in the first line, or remove this line")
        columns = (names.index("x"), names.index("y"), names.index("z"))
        return _columns(itertools.chain([row], file), columns, path)


def _columns(lines: Iterator[bytes], columns: tuple[int, int, int], path: Path) -> FloatArray:
    """Numbers that one separator divides, that of the first of them: semicolons, else commas, else white space.

    Spreadsheets of languages with a decimal comma separate columns by semicolons.
    """
    filled = _filled(lines)
    first = next(filled, b"")
    separator = _separator(first.decode("latin-1"))
    rows = itertools.chain([first], filled)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no data: an empty file is reported by count
            return np.loadtxt(
                (row.replace(b",", b".") for row in rows) if separator == ";" else rows,
                dtype=np.float64,
                delimiter=separator,
                usecols=columns,
                ndmin=2,
            )
    except ValueError as error:
        problem = f"cannot be read as {path.suffix[1:]} ({error})"
        fix = "separate columns by one of space, comma or semicolon; a decimal comma needs semicolons"
        raise DataError(path, problem, fix) from None


def _filled(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Lines without their comments, except those that hold nothing else."""
    return (numbers for line in lines if (numbers := line.split(b"#")[0]).strip())


def _cells(row: bytes) -> list[str]:
    line = row.decode("latin-1").strip()
    return line.split(_separator(line)) if line else []


def _are_as_many(names: list[str], cells: list[str]) -> bool:
    """Whether there is a name for each cell; what follows a separator at the end of a line may be empty."""
    longer = max(names, cells, key=len)
    return abs(len(names) - len(cells)) <= (0 if longer[-1].strip() else 1)


def _separator(line: str) -> str | None:
    """What separates the columns of a line; None for white space."""
    return next((mark for mark in (";", ",") if mark in line), None)


def _read_npz(path: Path, _: list[str]) -> FloatArray:
    arrays = read_arrays(path)
    if "points" not in arrays:
        raise ValueError("it has no array 'points'")
    points = arrays["points"]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise ValueError(f"points must be numbers of shape (N, 3), got {points.dtype} of shape {points.shape}")
    return points.astype(np.float64)


def _read_points_3d_text(path: Path, _: list[str]) -> FloatArray:
    """Lines of ``POINT3D_ID X Y Z R G B ERROR TRACK[]`` (https://colmap.github.io/format.html)."""
    with path.open("rb") as file:
        return _columns(file, (1, 2, 3), path)


def _read_points_3d_binary(path: Path, _: list[str]) -> FloatArray:
    if path.stem != _POINTS_3D:
        raise ValueError("of .bin files, only COLMAP's points3D.bin is a cloud")
    if not path.is_file():
        raise FileNotFoundError
    file = BinaryReader(path, _AGAIN)
    points = []
    for _point in range(*file.take("Q")):
        _identity, x, y, z, *_color_and_error, observations = file.take("Q3d3BdQ")
        file.skip(8 * observations)
        points.append((x, y, z))
    return np.array(points, dtype=np.float64).reshape(-1, 3)


_READERS: dict[str, Callable[[Path, list[str]], FloatArray]] = {
    ".ply": _read_ply,
    ".pcd": _read_pcd,
    ".xyz": _read_columns,
    ".txt": _read_columns,
    ".csv": _read_columns,
    ".npz": _read_npz,
    ".bin": _read_points_3d_binary,
}
CLOUD_SUFFIXES = frozenset(_READERS)
