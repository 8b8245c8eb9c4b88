"""The empty room: floor, ceiling, walls with windows and a door, curtains, and a lamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc_lab.synth import fittings
from monoloc_lab.synth.fittings import Opening
from monoloc_lab.synth.furniture import CLOTHS, WOODS, Parts, a_color, box
from monoloc_lab.synth.materials import Material, lacquer, paint, wood
from monoloc_lab.synth.rooms import Object, Room, Vector

_SKY = 5000.0  # cd/m^2 of a bright overcast sky (CIE standard overcast, about 15 klx outdoors)
_SILL, _DOOR_WIDTH, _DOOR_HEIGHT = 0.9, 0.86, 2.03


@dataclass(frozen=True)
class Wall:
    """One of the four walls: north, east, south, west.

    Attributes:
        pose: ``T_world_wall``, (4, 4): the origin is the bottom centre of the inner face, x points to the right seen
            from inside, y outwards.
        yaw_rad: rotation about z.
        width: metres.
        openings: in the wall.
    """

    name: str
    pose: FloatArray
    yaw_rad: float
    width: float
    openings: tuple[Opening, ...] = ()

    def at(self, along: float, inwards: float, z: float = 0.0) -> Vector:
        """A position near the wall, in the world frame."""
        x, y, z = (float(c) for c in self.pose[:3, :3] @ np.array([along, -inwards, z]) + self.pose[:3, 3])
        return (x, y, z)


def make_walls(size: Vector, rng: np.random.Generator) -> tuple[Wall, ...]:
    """The walls of a room with one or two windows and a door, all in different walls."""
    sx, sy, height = size
    places = (
        ("north", (sx / 2.0, sy, 0.0), 0.0, sx),
        ("east", (sx, sy / 2.0, 0.0), -np.pi / 2.0, sy),
        ("south", (sx / 2.0, 0.0, 0.0), np.pi, sx),
        ("west", (0.0, sy / 2.0, 0.0), np.pi / 2.0, sy),
    )
    order = rng.permutation(4)
    windows = {int(order[0])} | ({int(order[1])} if rng.uniform() < 0.35 else set())
    walls = []
    for index, (name, position, yaw, width) in enumerate(places):
        openings: tuple[Opening, ...] = ()
        if index in windows:
            wide = float(rng.uniform(1.2, min(2.2, width - 1.2)))
            middle = float(rng.uniform(-0.3, 0.3) * (width - wide - 0.8))
            openings = (Opening(middle, wide, _SILL, min(height - 0.2, 2.25)),)
        elif index == order[2]:
            side = float(rng.choice([-1.0, 1.0]))
            openings = (Opening(side * (width / 2.0 - rng.uniform(0.65, 1.0)), _DOOR_WIDTH, 0.0, _DOOR_HEIGHT),)
        pose = make_pose(so3_exp(np.array([0.0, 0.0, yaw])), np.array(position))
        walls.append(Wall(name, pose, float(yaw), float(width), openings))
    return tuple(walls)


def is_window(opening: Opening) -> bool:
    return opening.bottom > 0.0


def empty_room(size: Vector, walls: tuple[Wall, ...], seed: int, rng: np.random.Generator) -> Room:
    """Floor, ceiling, walls, windows with curtains and radiators, a door and the ceiling lamp."""
    sx, sy, height = size
    room = Room(size, seed=seed)

    def put(name: str, parts: Parts, position: Vector = (0.0, 0.0, 0.0), yaw_rad: float = 0.0) -> None:
        nonlocal room
        room = room.add(Object(name, parts, position, yaw_rad, fixed=True))

    thick = 0.1
    slab = (sx + 2.0 * fittings.WALL_M, sy + 2.0 * fittings.WALL_M, thick)
    put("floor", (box(slab, (sx / 2.0, sy / 2.0, -thick / 2.0), _floor(rng), 0.0),))
    put("ceiling", (box(slab, (sx / 2.0, sy / 2.0, height + thick / 2.0), paint((0.90, 0.89, 0.87)), 0.0),))
    main, feature = _paints(rng)
    skirting = lacquer((0.86, 0.85, 0.83))
    featured = int(rng.integers(4))
    leaf = lacquer((0.84, 0.83, 0.80)) if rng.uniform() < 0.6 else wood(*WOODS[rng.integers(len(WOODS))], seed=3)
    cloth = Material(
        "stripes" if rng.uniform() < 0.4 else "fabric",
        *(CLOTHS[rng.integers(len(CLOTHS))] if rng.uniform() < 0.5 else ((0.80, 0.77, 0.70), (0.70, 0.66, 0.58))),
        repeat_m=0.6,
        roughness=0.95,
        seed=int(rng.integers(1 << 16)),
    )
    for index, wall in enumerate(walls):
        surface = feature if index == featured else main.seeded(index)
        put(
            f"wall {wall.name}",
            fittings.wall(wall.width, height, wall.openings, surface, skirting),
            wall.at(0, 0),
            wall.yaw_rad,
        )
        for opening in wall.openings:
            if opening.is_passage:
                continue
            if not is_window(opening):
                put("door", fittings.door(opening, leaf), wall.at(0, 0), wall.yaw_rad)
                continue
            name = f"{wall.name} window"
            panes = 2 if opening.width < 1.7 else 3
            put(name, fittings.window(opening, panes, _SKY, int(rng.integers(1 << 16))), wall.at(0, 0), wall.yaw_rad)
            heater = fittings.radiator(0.8 * opening.width)
            put(f"{name}, radiator", heater, wall.at(opening.middle, 0), wall.yaw_rad)
            top = min(height - 0.06, opening.top + 0.14)
            put(f"{name}, rail", fittings.rail(opening.width + 0.9), wall.at(opening.middle, 0.15, top), wall.yaw_rad)
            for side in (-1.0, 1.0):
                wide = float(rng.uniform(0.28, 0.42))
                along = opening.middle + side * (opening.width / 2.0 + 0.04)
                hung = fittings.curtain(wide, top - 0.03, cloth)
                put(
                    f"{name}, curtain {'left' if side < 0 else 'right'}",
                    hung,
                    wall.at(along, 0.15, 0.02),
                    wall.yaw_rad,
                )
    drop = float(rng.uniform(0.25, 0.45))
    put("ceiling lamp", fittings.pendant(drop, 1100.0), (sx / 2.0, sy / 2.0, height))
    return room


def _floor(rng: np.random.Generator) -> Material:
    kind = rng.uniform()
    seed = int(rng.integers(1 << 16))
    if kind < 0.6:
        return Material("boards", *WOODS[rng.integers(len(WOODS))], repeat_m=1.4, roughness=0.4, seed=seed)
    if kind < 0.8:
        return Material("tiles", (0.66, 0.63, 0.58), (0.48, 0.46, 0.43), 1.6, 0.35, seed=seed)
    return Material("fabric", (0.52, 0.49, 0.45), (0.42, 0.40, 0.37), 0.7, 1.0, seed=seed)


def _paints(rng: np.random.Generator) -> tuple[Material, Material]:
    """The paint of the walls, and another surface for one of them."""
    tones = ((0.88, 0.86, 0.80), (0.84, 0.85, 0.84), (0.87, 0.82, 0.74), (0.78, 0.81, 0.83))
    main = paint(tones[rng.integers(len(tones))])
    kind = rng.uniform()
    if kind < 0.3:
        return main, Material("brick", (0.58, 0.33, 0.25), (0.70, 0.67, 0.62), 1.0, 0.9, seed=int(rng.integers(99)))
    if kind < 0.65:
        return main, paint(a_color(rng, 0.3, 0.7), 7)
    return main, main
