"""A building of furnished rooms in a row, with an open passage between neighbours, and walks through it.

Building axes: x along the row, z up; the origin is an inner corner of the first room on the floor. Each room has a
world of its own, as if it had been recorded by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from monoloc.geometry import FloatArray, invert, make_pose, so3_exp
from monoloc_lab.synth.building import is_window, make_walls
from monoloc_lab.synth.fittings import WALL_M, Opening
from monoloc_lab.synth.layout import furnished_room
from monoloc_lab.synth.rooms import Room

EYE_M = 1.4
"""Height of the camera."""

_WIDTH_M, _HEIGHT_M = 4.2, 2.55  # of every room, across the row
_PASSAGE_M, _PASSAGE_HEIGHT_M = 0.95, 2.1
_RADIUS_M = 0.5  # of the circle in the middle of a room from which its surroundings are recorded
_VIEWS = 36  # on that circle
_STEPS_M = (1.5, 0.8, 0.1)  # before and behind a passage, where it is recorded
_BEFORE_M = np.array([0.7, 0.0, 0.0])  # of a passage, where a walk turns towards it
_DOWN_RAD = np.deg2rad(8.0)


@dataclass(frozen=True)
class RowOfRooms:
    """N rooms in a row.

    Attributes:
        rooms: from west to east; the passage of each to the next is in its east wall.
        starts_m: (N,) x of their west walls' inner faces.
        passages_m: (N - 1,) y of the passages.
        T_building_worlds: (N, 4, 4) of the rooms' worlds.
    """

    rooms: tuple[Room, ...]
    starts_m: FloatArray
    passages_m: FloatArray
    T_building_worlds: FloatArray

    def placed(self, first: int, last: int) -> list[tuple[Room, FloatArray]]:
        """Rooms from a number up to another one, each with its ``T_building_room``."""
        numbers = range(max(0, first), min(len(self.rooms), last + 1))
        return [(self.rooms[n], make_pose(np.eye(3), np.array([self.starts_m[n], 0.0, 0.0]))) for n in numbers]

    def in_world(self, number: int, T_building_camera: FloatArray) -> FloatArray:
        """Poses (..., 4, 4) in a room's world."""
        return np.asarray(invert(self.T_building_worlds[number]) @ T_building_camera)

    def passage(self, number: int) -> FloatArray:
        """Where a walk crosses the wall from a room to the next one, (3,) building frame."""
        west = self.starts_m[number] + self.rooms[number].size[0]
        return np.array([0.5 * (west + self.starts_m[number + 1]), self.passages_m[number], EYE_M])

    def middle(self, number: int) -> FloatArray:
        """The middle of a room at the camera's height, (3,) building frame."""
        room = self.rooms[number]
        return np.array([self.starts_m[number] + room.size[0] / 2.0, room.size[1] / 2.0, EYE_M])

    def mapping_views(self, number: int) -> FloatArray:
        """``T_building_camera`` of a recording of a room, (V, 4, 4): all around from its middle, and at its passages.

        At a passage it looks out of the room and into it.
        """
        angles = np.linspace(0.0, 2.0 * np.pi, _VIEWS, endpoint=False)
        around = self.middle(number) + _RADIUS_M * np.stack(
            [np.cos(angles), np.sin(angles), np.zeros(_VIEWS)], axis=1
        )
        views = [looking(place, angle) for place, angle in zip(around, angles, strict=True)]
        for passage, out in ((number, 0.0), (number - 1, np.pi)):
            if not 0 <= passage < len(self.rooms) - 1:
                continue
            at, ahead = self.passage(passage), np.array([np.cos(out), 0.0, 0.0])
            views += [looking(at - step * ahead, out) for step in _STEPS_M]
            views += [looking(at + step * ahead, out + np.pi) for step in (0.5, -0.1, -0.8)]
        return np.stack(views)

    def walk(self, first: int, last: int, step_m: float, aside_m: float = 0.0) -> FloatArray:
        """``T_building_camera`` of a walk from the middle of a room to that of a later one, looking ahead, (F, 4, 4).

        Args:
            aside_m: by which the walk is off to the left.
        """
        knots = [self.middle(first)]
        for number in range(first, last):
            at = self.passage(number)
            knots += [at - _BEFORE_M, at + _BEFORE_M, self.middle(number + 1)]
        places = np.array(knots) + np.array([0.0, aside_m, 0.0])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
        at = np.arange(0.0, along[-1], step_m)
        positions = np.stack([np.interp(at, along, places[:, axis]) for axis in range(3)], axis=1)
        sway = 0.12 * np.sin(0.9 * at)  # of the view
        return np.stack([looking(place, yaw) for place, yaw in zip(positions, sway, strict=True)])


def looking(place: FloatArray, yaw_rad: float) -> FloatArray:
    """Pose (4, 4) of a camera at a place (3,) that looks along a yaw, 0 along x, and a little down."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x
    turn = so3_exp(np.array([0.0, 0.0, yaw_rad])) @ so3_exp(np.array([0.0, _DOWN_RAD, 0.0]))
    return make_pose(turn @ level, place)


def row_of_rooms(count: int, seed: int) -> RowOfRooms:
    """A building of some rooms; the same seed and count give the same building."""
    rooms, starts_m, worlds, passages_m = [], [0.0], [], []
    west: float | None = None  # y of the passage in the west wall
    for number in range(count):
        rng = np.random.default_rng([seed, number, 0x0B1D])
        size = (float(rng.uniform(4.0, 5.2)), _WIDTH_M, _HEIGHT_M)
        east = float(_WIDTH_M / 2.0 + rng.uniform(-0.5, 0.5)) if number + 1 < count else None
        rooms.append(_room(size, west, east, seed + number, rng))
        turn = so3_exp(np.array([0.0, 0.0, float(rng.uniform(-np.pi, np.pi))]))
        worlds.append(make_pose(turn, np.array([starts_m[-1], 0.0, 0.0]) + rng.uniform(-1.0, 1.0, 3)))
        starts_m.append(starts_m[-1] + size[0] + 2.0 * WALL_M)
        passages_m.append(0.0 if east is None else east)
        west = east
    return RowOfRooms(tuple(rooms), np.array(starts_m[:-1]), np.array(passages_m[:-1]), np.stack(worlds))


def _room(
    size: tuple[float, float, float], west: float | None, east: float | None, seed: int, rng: np.random.Generator
) -> Room:
    """A furnished room with windows to the north and the south, and passages at some y of its other walls."""
    walls = []
    for wall in make_walls(size, rng):
        openings = tuple(opening for opening in wall.openings if is_window(opening))
        if wall.name in ("east", "west"):
            at, side = (east, -1.0) if wall.name == "east" else (west, 1.0)
            middle = 0.0 if at is None else side * (at - size[1] / 2.0)
            passage = Opening(middle, _PASSAGE_M, 0.0, _PASSAGE_HEIGHT_M, is_passage=True)
            openings = () if at is None else (passage,)
        walls.append(replace(wall, openings=openings))
    return furnished_room(size, tuple(walls), seed, rng)
