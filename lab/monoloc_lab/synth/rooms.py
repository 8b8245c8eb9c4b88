"""A room: its size and its named objects, which consist of simple parts. Editing returns a new room.

World axes: x and y along the walls, z up; the origin is an inner corner on the floor. The frame of an object has its
origin below the object's centre, on the surface that it stands on, x to its right and y towards its back.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter, ValidationError

from monoloc.config import describe
from monoloc.errors import DataError, SettingError
from monoloc.files import read_regular, write_whole
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from monoloc.map.arguments import float64
from monoloc_lab.synth.boxes import Boxes
from monoloc_lab.synth.materials import Material
from monoloc_lab.synth.mesh_files import read_mesh
from monoloc_lab.synth.shapes import sample_surface

Vector = tuple[float, float, float]

_SPACING_M = 0.08  # of the points that sample the surface of a mesh
_AT_ONCE = 64  # points that are compared with them at a time, to limit memory

Shape = Literal["box", "panel", "cylinder", "ellipsoid", "mesh"]


@dataclass(frozen=True)
class Part:
    """A simple shape of one material.

    Attributes:
        shape: "panel" is a rectangle that faces the front; "mesh" is read from ``file``.
        size: of its bounding box, metres.
        centre: of that box, object frame.
        rotation: rotation vector about the centre, radians.
        bevel_m: radius of the edges of a box.
        taper: width of the top of a cylinder as a share of its bottom.
        cell: index of its cell in an atlas texture.
        file: of a mesh, in the object frame.
    """

    shape: Shape
    size: Vector
    centre: Vector
    material: Material
    rotation: Vector = (0.0, 0.0, 0.0)
    bevel_m: float = 0.0
    taper: float = 1.0
    cell: int | None = None
    file: str | None = None

    @property
    def pose(self) -> FloatArray:
        """``T_object_part``, (4, 4)."""
        return make_pose(so3_exp(np.array(self.rotation)), np.array(self.centre))


@dataclass(frozen=True)
class Object:
    """An object that can be named, moved and removed.

    Attributes:
        position: of its origin, world frame, metres.
        yaw_rad: rotation about z.
        fixed: part of the building; it may touch anything.
        underfoot: lies flat on the floor; other objects may stand on it.
    """

    name: str
    parts: tuple[Part, ...]
    position: Vector = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    fixed: bool = False
    underfoot: bool = False

    @property
    def pose(self) -> FloatArray:
        """``T_world_object``, (4, 4)."""
        return make_pose(so3_exp(np.array([0.0, 0.0, self.yaw_rad])), np.array(self.position))

    @cached_property
    def boxes(self) -> Boxes:
        """Boxes of its parts; a mesh, which may be hollow, has none."""
        solid = [part for part in self.parts if part.shape != "mesh"]
        poses = np.array([self.pose @ part.pose for part in solid]).reshape(-1, 4, 4)
        return Boxes(poses, np.array([part.size for part in solid]).reshape(-1, 3) / 2.0)

    @cached_property
    def surface_points(self) -> FloatArray:
        """Points on the surfaces of its meshes, (N, 3) world frame; other parts have none."""
        points = [sample_surface(read_mesh(Path(part.file)), _SPACING_M) for part in self.parts if part.file]
        return transform(self.pose, np.concatenate([np.zeros((0, 3)), *points]))

    def intersects(self, other: Object) -> bool:
        return self.boxes.intersect(other.boxes)


@dataclass(frozen=True)
class Room:
    """A room; every change returns a new one.

    Attributes:
        size: inner length, width and height, metres.
        objects: including the parts of the building.
        seed: of its generation; None if it was made by hand.
    """

    size: Vector
    objects: tuple[Object, ...] = field(default_factory=tuple)
    seed: int | None = None

    def __getitem__(self, name: str) -> Object:
        for thing in self.objects:
            if thing.name == name:
                return thing
        raise SettingError("object", f"there is no {name!r}", f"choose one of {', '.join(self.names)}")

    @property
    def names(self) -> list[str]:
        return [thing.name for thing in self.objects]

    def add(self, thing: Object) -> Room:
        """The room with one more object.

        Raises:
            SettingError: its name is taken, or it intersects another object.
        """
        if thing.name in self.names:
            raise SettingError("object", f"{thing.name!r} exists already", "give it another name")
        blocker = self.blocker(thing)
        if blocker is not None:
            raise SettingError(thing.name, f"intersects {blocker}", "put it elsewhere, or move that first")
        return replace(self, objects=(*self.objects, thing))

    def remove(self, name: str) -> Room:
        """The room without an object.

        Raises:
            SettingError: there is no object of that name.
        """
        gone = self[name]
        return replace(self, objects=tuple(thing for thing in self.objects if thing is not gone))

    def move(self, name: str, by_m: ArrayLike = (0.0, 0.0, 0.0), turn_rad: float = 0.0) -> Room:
        """The room with an object moved (world frame) and turned about its vertical axis.

        Raises:
            SettingError: there is no object of that name, or it intersects another object at its new place.
            ValueError: ``by_m`` is not three finite numbers.
        """
        thing = self[name]
        x, y, z = (float(v) for v in np.asarray(thing.position) + float64("by_m", by_m, 3))
        return self.remove(name).add(replace(thing, position=(x, y, z), yaw_rad=thing.yaw_rad + turn_rad))

    def blocker(self, thing: Object) -> str | None:
        """Name of an object that ``thing`` would intersect, or "the walls", or None.

        Parts of the building may touch. Other objects must be apart and inside the room.
        """
        if thing.fixed or thing.underfoot:
            return None
        corners = thing.boxes.corners().reshape(-1, 3)
        if np.any(corners < -1e-3) or np.any(corners > np.array(self.size) + 1e-3):
            return "the walls"
        for other in self.objects:
            if not other.underfoot and thing.intersects(other):
                return other.name
        return None

    def clearance_m(self, points: ArrayLike) -> FloatArray:
        """Distance of points (N, 3) to the nearest surface, (N,); negative inside an object or a wall."""
        p = np.asarray(points, dtype=np.float64)
        walls = np.minimum(p, np.array(self.size) - p).min(axis=1)
        for thing in self.objects:
            walls = np.minimum(walls, thing.boxes.distance_m(p))
            for start in range(0, len(p) if len(thing.surface_points) else 0, _AT_ONCE):
                rows = slice(start, start + _AT_ONCE)
                apart = np.linalg.norm(p[rows, None] - thing.surface_points[None], axis=2).min(axis=1)
                walls[rows] = np.minimum(walls[rows], np.maximum(apart - _SPACING_M / 2.0, 0.0))
        return np.asarray(walls)

    def to_json(self) -> str:
        """The room as JSON; equal rooms have equal text."""
        return _ROOMS.dump_json(self, indent=1).decode()

    @staticmethod
    def from_json(text: str) -> Room:
        """The room of :meth:`to_json`.

        Raises:
            pydantic.ValidationError: the text is not a room.
        """
        return _ROOMS.validate_json(text)


_ROOMS = TypeAdapter(Room)


def write_room(path: Path, room: Room) -> None:
    """Write a room as JSON."""
    write_whole(path, room.to_json().encode())


def read_room(path: Path) -> Room:
    """Read a room written by :func:`write_room`.

    Raises:
        DataError: the file cannot be read or is not a room.
    """
    fix = "make one with: monoloc synth room"
    try:
        return Room.from_json(read_regular(path).decode())
    except ValidationError as error:
        raise DataError(path, f"is not a room ({describe(error)})", fix) from error
    except (OSError, ValueError) as error:
        problem = error.strerror if isinstance(error, OSError) else error
        raise DataError(path, f"cannot be read ({problem})", fix) from error
