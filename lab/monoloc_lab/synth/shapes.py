"""Triangle meshes of simple shapes, centred on the origin, with texture coordinates in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray

_SEGMENTS = 28  # of a circle; enough for the rendered sizes
_BEVEL_STEPS = 3


@dataclass(frozen=True)
class Mesh:
    """V vertices and F triangles.

    Attributes:
        vertices, normals: (V, 3) metres; unit, outward.
        uv: (V, 2) metres along the surface.
        span: (V, 2) the same, scaled to 0 to 1 over each face.
        faces: (F, 3) int64, counter-clockwise seen from outside.
    """

    vertices: FloatArray
    normals: FloatArray
    uv: FloatArray
    span: FloatArray
    faces: NDArray[np.int64]


def box(size: FloatArray, bevel_m: float = 0.0, grain: bool = False) -> Mesh:
    """A box with edges ``size`` (3,), rounded by a radius.

    Each face is a separate patch. With ``grain``, u runs along its longer side, like wood grain; without, v is
    vertical.
    """
    half = np.asarray(size, dtype=np.float64) / 2.0
    radius = min(bevel_m, 0.999 * float(half.min()))
    patches = [_box_face(half, radius, axis, sign, grain) for axis in range(3) for sign in (-1.0, 1.0)]
    return merged(patches)


def panel(size: FloatArray) -> Mesh:
    """A rectangle in the plane y = 0 that faces -y, ``size`` (width, ignored, height)."""
    return _box_face(np.array([size[0] / 2.0, 0.0, size[2] / 2.0]), 0.0, 1, -1.0, False)


def _box_face(half: FloatArray, radius: float, axis: int, sign: float, grain: bool) -> Mesh:
    others = [a for a in range(3) if a != axis]
    u_axis, v_axis = sorted(others, key=lambda a: (-half[a], a))
    ticks = []
    for a in (u_axis, v_axis):
        if radius > 0.0:
            # Each face takes half of a rounded edge, 45 degrees, in equal angles.
            bend = radius * np.tan(np.linspace(0.0, np.pi / 4.0, _BEVEL_STEPS + 1))
            inner = half[a] - radius
            ticks.append(np.concatenate([-(inner + bend)[::-1], inner + bend]))
        else:
            ticks.append(np.array([-half[a], half[a]]))
    u, v = (grid.ravel() for grid in np.meshgrid(*ticks, indexing="ij"))
    points = np.empty((len(u), 3))
    points[:, axis], points[:, u_axis], points[:, v_axis] = sign * half[axis], u, v
    normals = np.zeros_like(points)
    normals[:, axis] = sign
    if radius > 0.0:
        core = np.clip(points, -(half - radius), half - radius)
        normals = (points - core) / np.linalg.norm(points - core, axis=1, keepdims=True)
        points = core + radius * normals
    right_handed = (v_axis - u_axis) % 3 == 1
    faces = _grid_faces(len(ticks[0]), len(ticks[1]), flip=right_handed != (sign > 0.0))
    uv = np.stack([u, v], axis=1)
    if axis == 2:
        return Mesh(points, normals, uv, 0.5 + 0.5 * uv / half[[u_axis, v_axis]], faces)
    # v runs up and u to the right, seen from outside.
    along = points[:, 1 - axis] * sign * (1.0 if axis == 0 else -1.0)
    vertical = np.stack([along, points[:, 2]], axis=1)
    span = 0.5 + 0.5 * vertical / half[[1 - axis, 2]]
    uv = uv if grain else vertical
    return Mesh(points, normals, uv, span, faces)


def _grid_faces(rows: int, columns: int, flip: bool) -> NDArray[np.int64]:
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return faces[:, ::-1] if flip else faces


def cylinder(size: FloatArray, taper: float = 1.0) -> Mesh:
    """A vertical elliptic cylinder in a box ``size`` (3,); its top is ``taper`` times as wide as its bottom."""
    half = np.asarray(size, dtype=np.float64) / 2.0
    wide = max(1.0, taper)
    bottom, top = 1.0 / wide, taper / wide
    angle = np.linspace(0.0, 2.0 * np.pi, _SEGMENTS + 1)
    ring = np.stack([np.cos(angle) * half[0], np.sin(angle) * half[1]], axis=1)
    turns = angle / (2.0 * np.pi)
    mantle = np.concatenate(
        [np.column_stack([ring * scale, np.full(len(ring), z)]) for scale, z in ((bottom, -half[2]), (top, half[2]))]
    )
    slope = (bottom - top) * (half[0] + half[1]) / 2.0 / (2.0 * half[2])
    outward = np.column_stack([np.cos(angle) / half[0], np.sin(angle) / half[1]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    normals = np.column_stack([outward, np.full(len(outward), slope)])
    normals = np.tile(normals / np.linalg.norm(normals, axis=1, keepdims=True), (2, 1))
    span = np.column_stack([np.tile(turns, 2), np.repeat([0.0, 1.0], len(ring))])
    uv = span * np.array([np.pi * (half[0] + half[1]), 2.0 * half[2]])
    count = len(ring)
    a = np.arange(count - 1)
    faces = np.concatenate(
        [np.stack([a, a + 1, a + count + 1], axis=1), np.stack([a, a + count + 1, a + count], axis=1)]
    )
    caps = [_cap(ring * scale, sign * half[2], sign) for scale, sign in ((bottom, -1.0), (top, 1.0)) if scale > 1e-6]
    return merged([Mesh(mantle, normals, uv, span, faces), *caps])


def _cap(ring: FloatArray, z: float, sign: float) -> Mesh:
    points = np.column_stack([np.vstack([[0.0, 0.0], ring[:-1]]), np.full(len(ring), z)])
    a = np.arange(1, len(ring))
    b = np.roll(a, -1)
    faces = np.stack([np.zeros_like(a), a, b] if sign > 0.0 else [np.zeros_like(a), b, a], axis=1)
    normals = np.tile([0.0, 0.0, sign], (len(points), 1))
    uv = points[:, :2].copy()
    return Mesh(points, normals, uv, 0.5 + 0.5 * uv / np.abs(ring).max(axis=0), faces)


def ellipsoid(size: FloatArray) -> Mesh:
    """An ellipsoid in a box ``size`` (3,)."""
    half = np.asarray(size, dtype=np.float64) / 2.0
    turns, heights = np.meshgrid(
        np.linspace(0.0, 1.0, _SEGMENTS + 1), np.linspace(0.0, 1.0, _SEGMENTS // 2 + 1), indexing="ij"
    )
    longitude, latitude = 2.0 * np.pi * turns.ravel(), np.pi * (heights.ravel() - 0.5)
    unit = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=1
    )
    normals = unit / half
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    span = np.stack([turns.ravel(), heights.ravel()], axis=1)
    uv = span * np.array([np.pi * (half[0] + half[1]), np.pi * half[2]])
    return Mesh(unit * half, normals, uv, span, _grid_faces(_SEGMENTS + 1, _SEGMENTS // 2 + 1, flip=False))


def merged(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
        np.concatenate([mesh.span for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
    )


def placed(mesh: Mesh, pose: FloatArray) -> Mesh:
    """A mesh moved by ``T_world_shape`` (4, 4)."""
    R, t = pose[:3, :3], pose[:3, 3]
    return Mesh(mesh.vertices @ R.T + t, mesh.normals @ R.T, mesh.uv, mesh.span, mesh.faces)


def sample_surface(mesh: Mesh, spacing_m: float) -> FloatArray:
    """Points on every triangle, about ``spacing_m`` apart, (N, 3)."""
    points = [mesh.vertices]
    corners = mesh.vertices[mesh.faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.ceil(longest / spacing_m).astype(int)
    for count in np.unique(steps[steps > 1]):
        a, b = (grid.ravel() for grid in np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij"))
        a, b = a[a + b <= count], b[a + b <= count]
        share = np.stack([count - a - b, a, b], axis=1) / count
        points.append((share @ corners[steps == count]).reshape(-1, 3))
    return np.concatenate(points)
