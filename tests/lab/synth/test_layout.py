"""Random rooms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.rooms import Room
from monoloc_lab.synth.scene import room_meshes

SEEDS = range(5)


@pytest.fixture(scope="module")
def rooms() -> list[Room]:
    return [generate_room(seed) for seed in SEEDS]


@pytest.mark.slow
def test_seed_determines_the_room(rooms: list[Room]) -> None:
    assert [generate_room(seed).to_json() for seed in SEEDS] == [room.to_json() for room in rooms]
    assert len({room.to_json() for room in rooms}) == len(rooms)
    for mesh, again in zip(room_meshes(rooms[0]).values(), room_meshes(generate_room(0)).values(), strict=True):
        assert mesh.vertices.tobytes() == again.vertices.tobytes()
        assert mesh.faces.tobytes() == again.faces.tobytes()


def test_rooms_are_furnished(rooms: list[Room]) -> None:
    for room in rooms:
        assert {"floor", "ceiling", "door", "ceiling lamp"} <= set(room.names)
        assert sum(name.startswith("wall") for name in room.names) == 4
        assert any(name.endswith("window") for name in room.names)
        assert sum(not thing.fixed for thing in room.objects) >= 10
    everything = {name.rstrip(" 0123456789") for room in rooms for name in room.names}
    assert {
        "sofa",
        "table",
        "chair",
        "bookcase",
        "floor lamp",
        "plant",
        "carpet",
        "poster",
        "landscape",
    } <= everything


def test_furniture_does_not_intersect(rooms: list[Room]) -> None:
    for room in rooms:
        furniture = [thing for thing in room.objects if not (thing.fixed or thing.underfoot)]
        for one, other in itertools.combinations(furniture, 2):
            assert not one.intersects(other), f"{one.name} and {other.name} of room {room.seed}"
        for thing in furniture:
            assert room.remove(thing.name).blocker(thing) is None


def test_objects_stand_on_a_surface(rooms: list[Room]) -> None:
    for room in rooms:
        tops = [0.0, *(float(thing.boxes.corners()[..., 2].max()) for thing in room.objects)]
        for thing in room.objects:
            bottom = float(thing.boxes.corners()[..., 2].min())
            hangs = thing.fixed or thing.name.startswith(("poster", "landscape"))
            assert hangs or min(abs(bottom - top) for top in tops) < 0.015, thing.name


def test_meshes_have_the_extent_of_the_boxes(rooms: list[Room]) -> None:
    room = rooms[1]
    vertices = np.concatenate([mesh.vertices for mesh in room_meshes(room).values()])
    corners = np.concatenate([thing.boxes.corners().reshape(-1, 3) for thing in room.objects])
    np.testing.assert_allclose(vertices.min(axis=0), corners.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), corners.max(axis=0), atol=1e-6)
