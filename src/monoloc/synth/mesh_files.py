"""Triangle meshes out of ply files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.synth.shapes import Mesh

_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2"},
    **{"uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4"},
    **{"double": "f8", "float64": "f8"},
}
_FIX = "export it as a ply of triangles"


def read_mesh(path: Path) -> Mesh:
    """A triangle mesh, ascii or binary little endian; other properties than x, y, z are skipped.

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
    except (ValueError, KeyError, IndexError, UnicodeDecodeError) as error:
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


def _parse(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    match = re.match(rb"ply\s(.*?)end_header\r?\n", content, re.DOTALL)
    if match is None:
        raise ValueError("no ply header")
    lines = match[1].decode("ascii").splitlines()
    encoding = next(line.split()[1] for line in lines if line.startswith("format"))
    elements: list[tuple[str, int, list[list[str]]]] = []
    for words in (line.split() for line in lines):
        if words and words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words and words[0] == "property":
            elements[-1][2].append(words[1:])
    body = content[match.end() :]
    if encoding == "ascii":
        return _ascii(body.decode("ascii").split(), elements)
    if encoding != "binary_little_endian":
        raise ValueError(f"{encoding}")
    return _binary(body, elements)


def _columns(properties: list[list[str]]) -> list[int]:
    names = [words[-1] for words in properties]
    return [names.index(name) for name in "xyz"]


def _ascii(
    words: list[str], elements: list[tuple[str, int, list[list[str]]]]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    at, vertices, faces = 0, np.zeros((0, 3)), []
    for name, count, properties in elements:
        if name == "vertex":
            width = len(properties)
            table = np.array(words[at : at + count * width], dtype=np.float64).reshape(count, width)
            vertices, at = table[:, _columns(properties)], at + count * width
        elif name == "face":
            for _ in range(count):
                corners = int(words[at])
                faces += _fan([int(word) for word in words[at + 1 : at + 1 + corners]])
                at += 1 + corners
    return vertices, np.array(faces, dtype=np.int64).reshape(-1, 3)


def _binary(
    body: bytes, elements: list[tuple[str, int, list[list[str]]]]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    at, vertices, faces = 0, np.zeros((0, 3)), []
    for name, count, properties in elements:
        if name == "vertex":
            kind = np.dtype([(words[-1], "<" + _TYPES[words[0]]) for words in properties])
            table = np.frombuffer(body, kind, count, at)
            vertices = np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=1)
            at += count * kind.itemsize
        elif name == "face":
            (words,) = properties
            number, index = np.dtype("<" + _TYPES[words[1]]), np.dtype("<" + _TYPES[words[2]])
            for _ in range(count):
                corners = int(np.frombuffer(body, number, 1, at)[0])
                at += number.itemsize
                faces += _fan([int(i) for i in np.frombuffer(body, index, corners, at)])
                at += corners * index.itemsize
    return vertices, np.array(faces, dtype=np.int64).reshape(-1, 3)


def _fan(corners: list[int]) -> list[list[int]]:
    return [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
