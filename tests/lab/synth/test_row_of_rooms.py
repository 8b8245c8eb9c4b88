"""Rooms in a row have open passages between them, and walks go through these."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import invert, transform
from monoloc_lab.synth.row_of_rooms import EYE_M, RowOfRooms, row_of_rooms


@pytest.fixture(scope="module")
def row() -> RowOfRooms:
    return row_of_rooms(2, 1)


def test_a_walk_touches_nothing(row: RowOfRooms) -> None:
    walk = row.walk(0, 1, 0.1)
    np.testing.assert_allclose(walk[:, 2, 3], EYE_M)
    assert np.linalg.norm(np.diff(walk[:, :3, 3], axis=0), axis=1).max() < 0.11
    for room, T_building_room in row.placed(0, 1):
        local = transform(invert(T_building_room), walk[:, :3, 3])
        within = local[np.all((local > 0.0) & (local < np.array(room.size)), axis=1)]
        # A door's frame is within arm's reach; nothing else is, at the height of the eyes.
        assert len(within) > 20
        assert min(thing.boxes.distance_m(within).min() for thing in room.objects if thing.parts) > 0.05


def test_rooms_do_not_overlap_and_passages_meet(row: RowOfRooms) -> None:
    ends = [start + room.size[0] for start, room in zip(row.starts_m, row.rooms, strict=True)]
    assert all(end < start for end, start in zip(ends[:-1], row.starts_m[1:], strict=True))
    for number in range(1):
        at = row.passage(number)
        assert ends[number] < at[0] < row.starts_m[number + 1]
        for room, T_building_room in row.placed(number, number + 1):
            across = at + np.array([0.0, 0.4, 0.0]) * np.linspace(-1.0, 1.0, 9)[:, None]
            local = transform(invert(T_building_room), across)
            walls = [thing for thing in room.objects if thing.name.startswith("wall")]
            assert min(wall.boxes.distance_m(local).min() for wall in walls) > 0.0


def test_each_room_has_a_world_of_its_own_that_views_are_given_in(row: RowOfRooms) -> None:
    views = row.mapping_views(1)
    given = row.in_world(1, views)
    np.testing.assert_allclose(row.T_building_worlds[1] @ given, views, atol=1e-9)
    assert np.linalg.norm(row.T_building_worlds[1] - row.T_building_worlds[0]) > 1.0
