"""Random rooms from a seed, with furniture placed as in homes and offices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc_lab.synth import fittings, furniture
from monoloc_lab.synth.building import Wall, empty_room, is_window, make_walls
from monoloc_lab.synth.furniture import Parts, a_cloth, a_color, a_wood, box
from monoloc_lab.synth.materials import BLACK_PLASTIC, Material, fabric, lacquer, paint
from monoloc_lab.synth.mesh_files import read_mesh
from monoloc_lab.synth.rooms import Object, Part, Room, Vector

_TRIES = 40
_GAP_M = 0.02  # between furniture and a wall; skirting is thinner


def generate_room(seed: int) -> Room:
    """A furnished room of 3.8 to 5.4 by 3.6 to 4.8 m; the same seed gives the same room."""
    rng = np.random.default_rng([seed, 0x700A])
    size = (float(rng.uniform(3.8, 5.4)), float(rng.uniform(3.6, 4.8)), float(rng.uniform(2.45, 2.7)))
    return furnished_room(size, make_walls(size, rng), seed, rng)


def furnished_room(size: Vector, walls: tuple[Wall, ...], seed: int, rng: np.random.Generator) -> Room:
    """A furnished room of some size, with given walls."""
    builder = _Builder(empty_room(size, walls, seed, rng), walls, rng)
    STYLES[int(rng.integers(len(STYLES)))](builder)
    builder.pictures()
    return builder.room


def imported_room(path: Path) -> Room:
    """A room from a mesh (ply, metres, z up), with a lamp below its highest point.

    The lowest corner of the mesh becomes the origin of the world.

    Raises:
        DataError: the mesh cannot be read.
    """
    vertices = read_mesh(path).vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y, z = (float(v) for v in high - low)
    cx, cy, cz = (float(v) for v in (high + low) / 2.0)
    scan = Part("mesh", (x, y, z), (cx, cy, cz), paint((0.72, 0.70, 0.66)), file=str(path.resolve()))
    lamp = Object("ceiling lamp", fittings.pendant(0.15, 1100.0), (x / 2.0, y / 2.0, z - 0.02), fixed=True)
    left, front, bottom = (float(v) for v in -low)
    return Room((x, y, z), (Object("scan", (scan,), (left, front, bottom), fixed=True), lamp))


@dataclass
class _Builder:
    """Builds a room; objects without a free place are left out."""

    room: Room
    walls: tuple[Wall, ...]
    rng: np.random.Generator

    def __post_init__(self) -> None:
        # Keep the swing of the door free.
        self._free = [
            Object(
                "doorway",
                (box((0.9, 1.0, 2.0), (opening.middle, -0.52, 1.0), BLACK_PLASTIC),),
                wall.at(0, 0),
                wall.yaw_rad,
            )
            for wall in self.walls
            for opening in wall.openings
            if not is_window(opening)
        ]

    def put(self, name: str, parts: Parts, position: Vector, yaw_rad: float) -> bool:
        """Add an object if its place is free."""
        if name in self.room.names:
            name = f"{name} {1 + sum(other.startswith(name) for other in self.room.names)}"
        thing = Object(name, parts, position, yaw_rad)
        if self.room.blocker(thing) is not None or any(map(thing.intersects, self._free)):
            return False
        self.room = self.room.add(thing)
        return True

    def against(self, name: str, parts: Parts) -> Object | None:
        """Add an object with its back to a wall, at a random free place along it."""
        corners = Object("", parts).boxes.corners().reshape(-1, 3)
        low, high = corners.min(0), corners.max(0)
        for _ in range(_TRIES):
            chosen = self.walls[self.rng.integers(4)]
            slack = chosen.width / 2.0 - (high[0] - low[0]) / 2.0 - 0.05
            if slack <= 0.0:
                continue
            along = float(self.rng.uniform(-slack, slack))
            position = chosen.at(along, float(high[1]) + _GAP_M)
            if self.put(name, parts, position, chosen.yaw_rad):
                return self.room.objects[-1]
        return None

    def upon(self, name: str, parts: Parts, carrier: Object, offset: tuple[float, float], turn: float = 0.0) -> None:
        """Add an object on top of another, at an offset in the frame of the other."""
        top = float(carrier.boxes.corners().reshape(-1, 3)[:, 2].max())
        x, y, _ = (float(c) for c in carrier.pose[:3, :3] @ np.array([*offset, 0.0]) + carrier.pose[:3, 3])
        self.put(name, parts, (x, y, top + 1e-3), carrier.yaw_rad + turn)

    def free(
        self, name: str, parts: Parts, around: tuple[float, float], spread: float, turn: float = 0.1
    ) -> Object | None:
        """Add an object near a position on the floor."""
        for attempt in range(_TRIES):
            reach = spread * (attempt + 1) / _TRIES
            x, y = (float(c + self.rng.uniform(-reach, reach)) for c in around)
            if self.put(
                name, parts, (x, y, 0.0), float(self.rng.choice([0.0, np.pi / 2.0]) + self.rng.normal(0, turn))
            ):
                return self.room.objects[-1]
        return None

    @property
    def middle(self) -> tuple[float, float]:
        return (self.room.size[0] / 2.0, self.room.size[1] / 2.0)

    def carpet(self, width: float, depth: float, centre: Vector, yaw_rad: float) -> None:
        """A carpet, thin enough for other objects to intersect it."""
        pile = Material(
            "carpet", a_color(self.rng, 0.5, 0.6), (0.78, 0.73, 0.63), 0.0, 1.0, seed=int(self.rng.integers(999))
        )
        rug = Object(
            "carpet", (box((width, depth, 0.012), (0.0, 0.0, 0.006), pile, 0.004),), centre, yaw_rad, underfoot=True
        )
        corners = rug.boxes.corners().reshape(-1, 3)
        if np.all(corners[:, :2] > 0.15) and np.all(corners[:, :2] < np.array(self.room.size[:2]) - 0.15):
            self.room = self.room.add(rug)

    def shelves(self, count: int) -> None:
        for _ in range(count):
            body = a_wood(self.rng) if self.rng.uniform() < 0.6 else lacquer((0.86, 0.85, 0.82))
            width, height = float(self.rng.uniform(0.75, 1.1)), float(self.rng.choice([1.1, 1.8, 2.0]))
            boards = round(height / 0.36)
            self.against("bookcase", furniture.shelf(width, height, boards, body, body, self.rng))

    def sideboard(self) -> Object | None:
        width = float(self.rng.uniform(1.0, 1.5))
        body = a_wood(self.rng)
        front = body if self.rng.uniform() < 0.5 else furniture.lacquered(self.rng)
        chest = self.against(
            "sideboard", furniture.cabinet(width, 0.42, float(self.rng.uniform(0.7, 0.9)), body, front, 3)
        )
        if chest is not None:
            self.upon("vase", furniture.vase(self.rng), chest, (-0.35 * width, 0.0))
            self.upon("small plant", fittings.plant(0.35, self.rng), chest, (0.32 * width, 0.03))
            self.upon("books", furniture.books_lying(self.rng), chest, (0.05, 0.0))
        return chest

    def floor_things(self) -> None:
        self.against("floor lamp", fittings.floor_lamp())
        self.against("plant", fittings.plant(float(self.rng.uniform(0.8, 1.25)), self.rng))
        if self.rng.uniform() < 0.6:
            self.against("basket", (furniture.rod(0.36, 0.38, (0.0, 0.0, 0.0), a_cloth(self.rng), 1.15),))

    def pictures(self) -> None:
        """Posters and framed pictures at eye level on free walls."""
        for wall in self.walls:
            for _ in range(2):
                tall = float(self.rng.uniform(0.45, 0.85))
                wide = tall * float(self.rng.choice([0.71, 1.0, 1.4]))
                kind = "poster" if self.rng.uniform() < 0.5 else "landscape"
                content = Material(
                    kind,
                    a_color(self.rng, 0.7, 0.85),
                    a_color(self.rng, 0.7, 0.5),
                    0.0,
                    0.5,
                    seed=int(self.rng.integers(9999)),
                )
                frame = None if kind == "poster" and self.rng.uniform() < 0.5 else self.rng.choice([0.05, 0.8])
                rim = None if frame is None else lacquer((float(frame),) * 3)
                parts = fittings.picture(wide, tall, content, rim)
                slack = wall.width / 2.0 - wide / 2.0 - 0.2
                along, height = float(self.rng.uniform(-slack, slack)), float(self.rng.uniform(1.4, 1.65))
                over_door = any(abs(along - o.middle) < (wide + o.width) / 2.0 + 0.3 for o in wall.openings)
                if not over_door:
                    self.put(kind, parts, wall.at(along, 0.001, height), wall.yaw_rad)


def _living_room(b: _Builder) -> None:
    cloth = a_cloth(b.rng)
    cushions = tuple(fabric(a_color(b.rng, 0.6, 0.8), a_color(b.rng, 0.5, 0.6), i) for i in range(2))
    couch = b.against("sofa", furniture.sofa(float(b.rng.uniform(1.6, 2.2)), cloth, cushions))
    if couch is not None:
        before = couch.pose[:3, :3] @ np.array([0.0, -1.05, 0.0]) + couch.pose[:3, 3]
        x, y = float(before[0]), float(before[1])
        b.carpet(2.2, 1.5, (x, y, 0.0), couch.yaw_rad)
        top = a_wood(b.rng)
        low = furniture.table(float(b.rng.uniform(0.9, 1.1)), 0.55, 0.42, top, top)
        if b.put("coffee table", low, (x, y, 0.0), couch.yaw_rad + float(b.rng.normal(0.0, 0.05))):
            here = b.room["coffee table"]
            b.upon("bowl", furniture.bowl(b.rng), here, (-0.2, 0.02))
            b.upon("books", furniture.books_lying(b.rng), here, (0.2, 0.0), 0.3)
    stand = b.sideboard()
    if stand is not None:
        b.upon("television", furniture.television(), stand, (0.0, 0.02))
    b.shelves(2)
    b.floor_things()
    b.against("armchair", furniture.sofa(0.86, a_cloth(b.rng), ()))
    b.against("stool", (furniture.rod(0.38, 0.44, (0.0, 0.0, 0.0), a_cloth(b.rng)),))


def _dining_room(b: _Builder) -> None:
    top, seat = a_wood(b.rng), a_cloth(b.rng)
    frame = top if b.rng.uniform() < 0.5 else lacquer((0.15, 0.15, 0.16))
    long = float(b.rng.uniform(1.2, 1.6))
    board = b.free("table", furniture.table(long, 0.8, 0.74, top, frame), b.middle, 0.5, 0.05)
    if board is not None:
        seats = [(sx * long / 4.0, sy) for sx in (-1, 1) for sy in (-1, 1)]
        for along, side in seats:
            turn = 0.0 if side > 0 else np.pi
            place = np.array([along + b.rng.normal(0.0, 0.04), side * b.rng.uniform(0.42, 0.66), 0.0])
            x, y, _ = (float(c) for c in board.pose[:3, :3] @ place + board.pose[:3, 3])
            b.put(
                "chair",
                furniture.chair(seat, frame),
                (x, y, 0.0),
                board.yaw_rad + turn + float(b.rng.normal(0, 0.12)),
            )
        b.upon("bowl", furniture.bowl(b.rng), board, (0.1, 0.05))
        b.upon("mug", furniture.mug(b.rng), board, (-0.35, -0.22), float(b.rng.uniform(0, 6)))
        b.upon("books", furniture.books_lying(b.rng), board, (-0.3, 0.18), 0.5)
    counter = lacquer(a_color(b.rng, 0.3, 0.75))
    b.against("counter", furniture.cabinet(1.8, 0.6, 0.9, counter, counter, 3))
    b.sideboard()
    b.shelves(2)
    b.floor_things()


def _office(b: _Builder) -> None:
    for index in range(2):
        top = a_wood(b.rng)
        desk = b.against(
            "desk", furniture.table(float(b.rng.uniform(1.2, 1.5)), 0.72, 0.73, top, lacquer((0.25,) * 3))
        )
        if desk is None:
            continue
        b.upon("monitor", furniture.monitor(b.rng), desk, (-0.05, 0.12))
        b.upon(
            "table lamp" if index == 0 else "books",
            fittings.table_lamp(400.0, b.rng) if index == 0 else furniture.books_lying(b.rng),
            desk,
            (0.45, 0.15),
        )
        b.upon("mug", furniture.mug(b.rng), desk, (-0.45, -0.1), float(b.rng.uniform(0, 6)))
        place = desk.pose[:3, :3] @ np.array([0.0, -0.75, 0.0]) + desk.pose[:3, 3]
        turn = np.pi + float(b.rng.normal(0.0, 0.5))
        b.put(
            "office chair",
            furniture.office_chair(a_cloth(b.rng)),
            (float(place[0]), float(place[1]), 0.0),
            desk.yaw_rad + turn,
        )
    b.shelves(3)
    steel = lacquer((0.62, 0.63, 0.63))
    b.against("filing cabinet", furniture.cabinet(0.8, 0.42, 1.2, steel, steel, 2))
    b.floor_things()
    if b.rng.uniform() < 0.7:
        b.carpet(1.9, 1.4, (*b.middle, 0.0), 0.0)


def _bedroom(b: _Builder) -> None:
    frame = a_wood(b.rng)
    wide = float(b.rng.choice([0.98, 1.4, 1.6]))
    cover = Material("stripes", a_color(b.rng, 0.4, 0.7), (0.80, 0.78, 0.73), 0.9, 1.0, seed=int(b.rng.integers(999)))
    sleeper = b.against("bed", furniture.bed(wide, frame, cover, fabric((0.86, 0.85, 0.83), (0.80, 0.79, 0.77))))
    if sleeper is not None:
        for side in (-1.0, 1.0):
            place = sleeper.pose[:3, :3] @ np.array([side * (wide / 2.0 + 0.3), 0.82, 0.0]) + sleeper.pose[:3, 3]
            chest = furniture.cabinet(0.44, 0.38, 0.5, frame, frame, 1)
            name = "bedside table"
            if b.put(name, chest, (float(place[0]), float(place[1]), 0.0), sleeper.yaw_rad):
                b.upon("table lamp", fittings.table_lamp(300.0, b.rng), b.room.objects[-1], (0.0, 0.03))
        foot = sleeper.pose[:3, :3] @ np.array([0.0, -0.9, 0.0]) + sleeper.pose[:3, 3]
        b.carpet(2.2, 1.4, (float(foot[0]), float(foot[1]), 0.0), sleeper.yaw_rad)
    body = furniture.lacquered(b.rng)
    b.against("wardrobe", furniture.cabinet(1.4, 0.6, 2.05, body, body, 3))
    b.sideboard()
    b.shelves(2)
    b.against("chair", furniture.chair(a_cloth(b.rng), frame))
    b.floor_things()


STYLES: tuple[Callable[[_Builder], None], ...] = (_living_room, _dining_room, _office, _bedroom)
