"""Triangle meshes out of ply files."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.synth.shapes import Mesh

_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_FIX = "export it as a ply of triangles"
_TOO_FEW = "it ends before what its header announces"
_Read = Callable[[Sequence[str], int], FloatArray]  # NumPy's type of every column, and R -> the next R rows


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    length: str | None  # the type of a list's length


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_mesh(path: Path) -> Mesh:
    """A triangle mesh, ascii or binary little endian; other properties than x, y, z and corners are skipped.

    Normals are made of the triangles, so that flat surfaces stay flat.

    Raises:
        DataError: unreadable, another format, without triangles, or faces that name vertices that are not there.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path") from error
    try:
        vertices, faces = _parse(content)
    except (ValueError, TypeError, OverflowError, LookupError) as error:
        raise DataError(path, f"is not a mesh that can be read ({error})", _FIX) from error
    if len(faces) == 0 or not np.all(np.isfinite(vertices)):
        raise DataError(path, "has no triangles, or vertices that are not finite", _FIX)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(path, "has triangles of vertices that are not there", _FIX)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    corners, normals = corners[lengths > 0.0], normals[lengths > 0.0] / lengths[lengths > 0.0, None]
    # Seen along its main direction, every triangle takes its texture from the plane it faces.
    axis = np.abs(normals).argmax(axis=1)
    others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv = np.take_along_axis(corners, np.repeat(others[:, None, :], 3, axis=1), axis=2).reshape(-1, 2)
    index = np.arange(3 * len(corners)).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), uv, uv, index)


def _parse(content: bytes) -> tuple[FloatArray, NDArray[np.int64]]:
    match = re.match(rb"ply\s(.*?)end_header\r?\n", content, re.DOTALL)
    if match is None:
        raise ValueError("no ply header")
    encoding, elements = _header(match[1].decode("ascii"))
    if encoding not in _ENCODINGS:
        raise ValueError(f"format {encoding!r} is neither {' nor '.join(_ENCODINGS)}")
    read = _ENCODINGS[encoding](content[match.end() :])
    values = {element.name: _values(element, read) for element in elements}  # in the order of the file
    vertex, face = values.get("vertex", {}), values.get("face", {})
    vertices = np.stack([np.ravel(vertex[axis]) for axis in "xyz"], axis=1)
    corners = face["vertex_index" if "vertex_index" in face else "vertex_indices"] if face else []
    triangles = [triangle for each in corners for triangle in _fan(each.tolist())]
    return vertices, np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _header(text: str) -> tuple[str, list[_Element]]:
    encoding = ""
    elements: list[_Element] = []
    for words in (line.split() for line in text.splitlines()):
        if words[:1] == ["format"]:
            encoding = words[1]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            length = _TYPES[words[2]] if words[1] == "list" else None
            elements[-1].properties.append(_Property(words[-1], _TYPES[words[-2]], length))
    return encoding, elements


def _values(element: _Element, read: _Read) -> dict[str, FloatArray | list[FloatArray]]:
    """What an element's rows hold by the name of the property: numbers (N,), or N lists of them."""
    if all(each.length is None for each in element.properties):
        table = read([each.kind for each in element.properties], element.count)
        return {each.name: column for each, column in zip(element.properties, table.T, strict=True)}
    values: dict[str, list[FloatArray]] = {each.name: [] for each in element.properties}
    for _ in range(element.count):
        for each in element.properties:
            count = 1 if each.length is None else int(read([each.length], 1)[0, 0])
            values[each.name].append(read([each.kind], count)[:, 0])
    return {**values}


def _ascii(body: bytes) -> _Read:
    words, at = body.decode("ascii").split(), 0

    def read(kinds: Sequence[str], rows: int) -> FloatArray:
        nonlocal at
        start, at = at, at + rows * len(kinds)
        if not start <= at <= len(words):
            raise ValueError(_TOO_FEW)
        return np.array(words[start:at], dtype=np.float64).reshape(rows, len(kinds))

    return read


def _binary(body: bytes) -> _Read:
    at = 0

    def read(kinds: Sequence[str], rows: int) -> FloatArray:
        nonlocal at
        row = np.dtype(",".join(f"<{kind}" for kind in kinds))
        start, at = at, at + rows * row.itemsize
        if not start <= at <= len(body):
            raise ValueError(_TOO_FEW)
        table = np.frombuffer(body, row, rows, start)
        if row.names is None:  # a single column
            return table.astype(np.float64)[:, None]
        return structured_to_unstructured(table, dtype=np.float64)

    return read


_ENCODINGS = {"ascii": _ascii, "binary_little_endian": _binary}


def _fan(corners: list[float]) -> list[list[float]]:
    return [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
