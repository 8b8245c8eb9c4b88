"""Writer of binary ply files: points with properties, and triangles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.files import write_whole
from monoloc.geometry import FloatArray

_TRIANGLE = np.dtype([("count", "u1"), ("vertices", "<i4", (3,))])


def write_ply(
    path: Path,
    points: FloatArray,
    colors: NDArray[np.uint8] | None = None,
    normals: FloatArray | None = None,
    triangles: ArrayLike | None = None,
) -> None:
    """Write points (N, 3), little-endian, float32.

    Args:
        path: of the file.
        points: metres.
        colors: (N, 3) RGB.
        normals: (N, 3) unit vectors.
        triangles: (F, 3) indices of points.

    Raises:
        DataError: the file cannot be written.
    """
    columns: list[tuple[str, str, NDArray[Any]]]
    columns = [(name, "<f4", points[:, axis]) for axis, name in enumerate("xyz")]
    if normals is not None:
        columns += [(f"n{name}", "<f4", normals[:, axis]) for axis, name in enumerate("xyz")]
    if colors is not None:
        columns += [(name, "u1", colors[:, axis]) for axis, name in enumerate(("red", "green", "blue"))]
    rows = np.empty(len(points), dtype=[(name, kind) for name, kind, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    kinds = {"<f4": "float", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {kinds[kind]} {name}" for name, kind, _ in columns]
    content = rows.tobytes()
    if triangles is not None:
        corners = np.asarray(triangles)
        faces = np.zeros(len(corners), dtype=_TRIANGLE)
        faces["count"], faces["vertices"] = 3, corners
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        content += faces.tobytes()
    write_whole(path, "\n".join([*lines, "end_header", ""]).encode() + content)
