"""A room as triangle meshes, one per material, for rendering."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc_lab.synth.materials import Material
from monoloc_lab.synth.mesh_files import read_mesh
from monoloc_lab.synth.rooms import Part, Room
from monoloc_lab.synth.shapes import Mesh, box, cylinder, ellipsoid, merged, panel, placed
from monoloc_lab.synth.textures import ATLAS_CELLS

_GRAINED = ("wood", "boards")


def room_meshes(room: Room) -> dict[Material, Mesh]:
    """Meshes in the world frame, with the material's texture coordinates in ``span``."""
    pieces: dict[Material, list[Mesh]] = {}
    for thing in room.objects:
        for part in thing.parts:
            mesh = placed(part_mesh(part), thing.pose @ part.pose)
            pieces.setdefault(part.material, []).append(_textured(mesh, part))
    return {material: merged(meshes) for material, meshes in pieces.items()}


def part_mesh(part: Part) -> Mesh:
    """The mesh of a part, relative to its centre."""
    size = np.array(part.size)
    if part.shape == "box":
        return box(size, part.bevel_m, grain=part.material.texture in _GRAINED)
    if part.shape == "panel":
        return panel(size)
    if part.shape == "cylinder":
        return cylinder(size, part.taper)
    if part.shape == "ellipsoid":
        return ellipsoid(size)
    if part.file is None:
        raise DataError("room", "has a mesh part without a file", "give its file")
    return placed(
        read_mesh(Path(part.file)), np.block([[np.eye(3), -np.array(part.centre)[:, None]], [np.zeros(3), 1.0]])
    )


def _textured(mesh: Mesh, part: Part) -> Mesh:
    span = mesh.span
    if part.cell is not None:
        row, column = divmod(part.cell, ATLAS_CELLS)
        span = (span * 0.96 + 0.02 + np.array([column, ATLAS_CELLS - 1 - row])) / ATLAS_CELLS
    elif part.material.repeat_m > 0.0:
        # Parts of one material show different sections of its texture.
        shift: FloatArray = np.array([0.37, 0.61]) * (np.sum(np.array(part.centre)) * 7.0 % 1.0)
        span = mesh.uv / part.material.repeat_m + shift
    return Mesh(mesh.vertices, mesh.normals, mesh.uv, span, mesh.faces)


def linear(srgb: NDArray[np.floating]) -> NDArray[np.float32]:
    """Linear light of sRGB values from 0 to 1 (IEC 61966-2-1)."""
    low = srgb / 12.92
    return np.asarray(np.where(srgb <= 0.04045, low, ((srgb + 0.055) / 1.055) ** 2.4), dtype=np.float32)
