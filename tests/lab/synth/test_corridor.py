"""A corridor whose doors look alike."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray, transform
from monoloc_lab.synth.corridor import SPACING_M, WIDTH_M, corridor, door_walk, mapping_walk
from monoloc_lab.synth.rooms import Room
from monoloc_lab.synth.scene import room_meshes

DOORS = 3


def between(low: float, high: float, room: Room) -> dict[object, FloatArray]:
    """Of each material, the vertices whose x is in a range, relative to it, and their texture coordinates."""
    found = {}
    for material, mesh in room_meshes(room).items():
        inside = (mesh.vertices[:, 0] > low + 0.01) & (mesh.vertices[:, 0] < high - 0.01)
        rows = np.column_stack([mesh.vertices[inside] - [low, 0.0, 0.0], mesh.span[inside]]).round(6)
        found[material] = rows[np.lexsort(rows.T)]
    return found


def test_every_door_looks_like_the_next_and_the_ends_differ() -> None:
    room = corridor(DOORS)
    # Half a period from the ends, whose walls reach into the corridor.
    first, second = (between(start, start + SPACING_M, room) for start in (SPACING_M / 2.0, 1.5 * SPACING_M))
    assert sum(len(rows) for rows in first.values()) > 500
    for material, rows in first.items():
        np.testing.assert_allclose(rows, second[material], atol=1e-5)
    assert {"window", "picture"} <= set(room.names)


def test_walks_stay_clear_of_the_walls_and_end_at_the_east_end() -> None:
    room = corridor(DOORS)
    for times_s, poses in (mapping_walk(DOORS), door_walk(DOORS, 0)):
        assert len(times_s) == len(poses) > 30 and np.all(np.diff(times_s) > 0.0)
        assert room.clearance_m(poses[:, :3, 3]).min() > 0.4
    _, poses = door_walk(DOORS, 1)
    looks_at = transform(poses[0], np.array([[0.0, 0.0, 1.0]]))[0] - poses[0, :3, 3]
    np.testing.assert_allclose(looks_at, [0.0, 1.0, 0.0], atol=1e-9)
    assert poses[0, 1, 3] == pytest.approx(WIDTH_M / 2.0)
    assert poses[-1, 0, 3] > (DOORS - 1) * SPACING_M and poses[-1, 0, 2] > 0.9
