"""Triangle meshes from ply files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.ply import read_ply
from monoloc_lab.synth.shapes import Mesh

_FIX = "export it as a ply of triangles"


def read_mesh(path: Path) -> Mesh:
    """Read a triangle mesh, ascii or binary little endian; properties other than x, y, z and corners are ignored.

    Normals are those of the triangles, so flat surfaces stay flat.

    Raises:
        DataError: unreadable, another format, no triangles, or vertex indices out of range.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror})", "check the path") from error
    try:
        vertices, faces = _triangles(content)
    except (ValueError, TypeError, OverflowError, LookupError) as error:
        raise DataError(path, f"is not a mesh that can be read ({error})", _FIX) from error
    if len(faces) == 0 or not np.all(np.isfinite(vertices)):
        raise DataError(path, "has no triangles, or vertices that are not finite", _FIX)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise DataError(path, "has triangles with vertices that do not exist", _FIX)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    corners, normals = corners[lengths > 0.0], normals[lengths > 0.0] / lengths[lengths > 0.0, None]
    # Texture coordinates are the two coordinates across the dominant axis of the normal.
    axis = np.abs(normals).argmax(axis=1)
    others = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    uv = np.take_along_axis(corners, np.repeat(others[:, None, :], 3, axis=1), axis=2).reshape(-1, 2)
    index = np.arange(3 * len(corners)).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0), uv, uv, index)


def _triangles(content: bytes) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices (N, 3), and the triangles (T, 3) of all faces."""
    values = read_ply(content, "vertex", "face")
    vertex, face = values.get("vertex", {}), values.get("face", {})
    vertices = np.stack([np.ravel(vertex[axis]) for axis in "xyz"], axis=1)
    corners = face["vertex_index" if "vertex_index" in face else "vertex_indices"] if face else []
    triangles = [triangle for each in corners for triangle in _fan(each.tolist())]
    return vertices, np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _fan(corners: list[float]) -> list[list[float]]:
    return [[corners[0], corners[i], corners[i + 1]] for i in range(1, len(corners) - 1)]
