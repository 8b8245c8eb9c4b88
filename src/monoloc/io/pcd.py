"""Reader and writer of the Point Cloud Library's .pcd files: ascii, binary and binary_compressed; written in binary.

Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html. Compressed data is one LZF stream of all
values of the first field, then all of the second, and so on.
"""

from __future__ import annotations

import struct
import warnings
from io import BufferedReader
from pathlib import Path

import numpy as np

from monoloc.files import write_whole
from monoloc.geometry import FloatArray

_Fields = list[tuple[str, str]]  # name and little-endian NumPy type of each value of a point
_MOST_VALUES = 1000  # of a point
_MOST_POINTS = 1 << 28
_MOST_LZF_RATIO = 100  # three bytes of LZF make at most 264
_KINDS = {"F": "f", "I": "i", "U": "u"}


def read_pcd(path: Path) -> FloatArray:
    """Points of a .pcd file, (N, 3).

    Raises:
        OSError, ValueError, TypeError, LookupError: the file cannot be read, is not such a file, or is truncated.
    """
    with path.open("rb") as file:
        header = _header(file)
        missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA") if not header.get(key)]
        if missing:
            raise ValueError(f"the header has no {missing[0]}")
        repeats = [int(count) for count in header.get("COUNT", ["1"] * len(header["FIELDS"]))]
        if min(repeats) < 1 or sum(repeats) > _MOST_VALUES:
            raise ValueError(f"COUNT is {' '.join(header['COUNT'])}")
        fields: _Fields = []
        for name, size, kind, repeat in zip(header["FIELDS"], header["SIZE"], header["TYPE"], repeats, strict=True):
            if kind not in _KINDS:
                raise ValueError(f"field {name!r} has the unknown type {kind!r}")
            fields += [(name, f"<{_KINDS[kind]}{size}")] * repeat
        count, encoding = int(header["POINTS"][0]), header["DATA"][0]
        if not 0 <= count <= _MOST_POINTS:
            raise ValueError(f"the header does not say how many points there are, but {count}")
        readers = {"ascii": _ascii_points, "binary": _binary_points, "binary_compressed": _compressed_points}
        if encoding not in readers:
            raise ValueError(f"DATA {encoding} is none of {', '.join(readers)}")
        return readers[encoding](file, fields, count)


def decompress_lzf(data: bytes, size: int) -> bytes:
    """Decompress an LZF stream of ``size`` bytes (Lehmann, liblzf: ``lzf_d.c``).

    A control byte below 32 starts a literal run of one byte more. Another has a length in its upper three bits, to
    which the next byte is added if it is 7, and with the byte after them a distance: so many bytes plus two are
    copied from that far back.

    Raises:
        ValueError: the stream is not LZF, or has another size.
    """
    result, at = bytearray(), 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                result += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(result) - ((control & 31) << 8) - data[at] - 1
            at += 1
            if start < 0 or len(result) + length > size:
                raise ValueError("the compressed data is damaged")
            # The copy may overlap what it writes, and then repeats it.
            period = bytes(result[start : start + length + 2])
            result += (period * ((length + 2) // len(period) + 1))[: length + 2]
    except IndexError:
        raise ValueError("the compressed data is cut short") from None
    if len(result) != size:
        raise ValueError(f"the compressed data holds {len(result)} of {size} bytes")
    return bytes(result)


def _header(file: BufferedReader) -> dict[str, list[str]]:
    """Words of each header line by its first word, up to and including DATA."""
    header: dict[str, list[str]] = {}
    for raw in file:
        words = raw.decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
            if words[0] == "DATA":
                return header
    raise ValueError("the header has no DATA")


def _positions(fields: _Fields) -> tuple[int, int, int]:
    names = [name for name, _ in fields]
    for axis in "xyz":
        if axis not in names:
            raise ValueError(f"points have no property {axis!r}")
    return names.index("x"), names.index("y"), names.index("z")


def _ascii_points(file: BufferedReader, fields: _Fields, count: int) -> FloatArray:
    columns = _positions(fields)
    if count == 0:
        return np.empty((0, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "input contained no data": an empty file is reported below
        points = np.loadtxt(file, dtype=np.float64, usecols=columns, max_rows=count, ndmin=2)
    _check_count(len(points), count)
    return points


def _binary_points(file: BufferedReader, fields: _Fields, count: int) -> FloatArray:
    positions = _positions(fields)
    # Fields are named by number: all padding fields of a file share one name.
    dtype = np.dtype([(str(index), kind) for index, (_, kind) in enumerate(fields)])
    data = file.read()
    _check_count(len(data) // dtype.itemsize, count)
    vertices = np.frombuffer(data, dtype=dtype, count=count)
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return np.column_stack([vertices[str(index)].astype(np.float64) for index in positions])


def _compressed_points(file: BufferedReader, fields: _Fields, count: int) -> FloatArray:
    sizes = [np.dtype(kind).itemsize for _, kind in fields]
    lengths = file.read(8)
    if len(lengths) < 8:
        raise ValueError("the compressed data is cut short")
    compressed, uncompressed = struct.unpack("<II", lengths)
    if uncompressed != sum(sizes) * count:
        raise ValueError(
            f"the compressed data is of {uncompressed} bytes, but {count} points are {sum(sizes) * count}"
        )
    data = file.read(compressed)
    if len(data) < compressed or uncompressed > _MOST_LZF_RATIO * compressed:
        raise ValueError("the compressed data is cut short")
    columns, content = [], decompress_lzf(data, uncompressed)
    for position in _positions(fields):
        start = sum(sizes[:position]) * count
        columns.append(np.frombuffer(content, fields[position][1], count, start).astype(np.float64))
    return np.column_stack(columns)


def _check_count(got: int, count: int) -> None:
    if got < count:
        raise ValueError(f"it ends after {got} of {count} points")


def write_pcd(path: Path, points: FloatArray) -> None:
    """Write points (N, 3) m, binary, float32.

    Raises:
        DataError: the file cannot be written.
    """
    header = f"""\
# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH {len(points)}
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS {len(points)}
DATA binary
"""
    write_whole(path, header.encode() + points.astype("<f4").tobytes())
