"""Points on the faces of a mesh, evenly by area."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray

_SPACING_M = 0.015  # half of the cell to which a build thins a cloud
_MOST_POINTS = 4_000_000


def triangles_of(faces: Sequence[NDArray[np.floating]], vertices: int) -> NDArray[np.int64]:
    """Vertex indices of triangles (T, 3) that fan out from the first corner of each face.

    Args:
        faces: vertex indices of each face, of any number.
        vertices: number of vertices.

    Raises:
        ValueError: a face refers to a vertex that does not exist.
    """
    lengths = np.array([len(face) for face in faces], dtype=np.int64)
    triangles = [np.empty((0, 3), dtype=np.int64)]
    for corners in np.unique(lengths[lengths >= 3]):
        polygons = np.stack([face for face in faces if len(face) == corners])
        if not np.all((polygons >= 0) & (polygons < vertices)):  # NaN neither
            raise ValueError(f"a face refers to a vertex beyond the {vertices} that there are")
        polygons = polygons.astype(np.int64)
        for second in range(1, int(corners) - 1):
            triangles.append(polygons[:, [0, second, second + 1]])
    return np.concatenate(triangles)


def sample_triangles(vertices: FloatArray, triangles: NDArray[np.int64]) -> FloatArray:
    """Random points on triangles, in proportion to their areas: one for each 2.25 cm², at most 4 million.

    The same mesh gives the same points.

    Args:
        vertices: (N, 3) metres.
        triangles: (T, 3) indices of vertices; those with a corner that is not finite have no points.

    Returns:
        (M, 3) metres.
    """
    corners = vertices[triangles]
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas_m2 = 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
    total_m2 = float(areas_m2.sum())
    count = int(min(total_m2 / _SPACING_M**2, _MOST_POINTS))
    if count == 0:
        return np.empty((0, 3))
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(areas_m2), count, p=areas_m2 / total_m2)
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)  # folded into the triangle
    return np.asarray(corners[chosen, 0] + u * first[chosen] + v * second[chosen])
