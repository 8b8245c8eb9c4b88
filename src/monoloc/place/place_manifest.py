"""The manifest of a place: its rooms, the bundles that hold them, and the doors between them."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from monoloc.bundle_manifest import PLACE_MANIFEST
from monoloc.config import describe
from monoloc.errors import DataError
from monoloc.files import read_regular
from monoloc.geometry import FloatArray, invert, make_pose, quaternion_to_rotation, rotation_to_quaternion, transform
from monoloc.io.pose_files import UNIT_TOLERANCE

SCHEMA = 1

_MOST_BYTES = 1 << 22  # of a manifest: 10,000 rooms
_MAKE = "make it by: monoloc place new"
MOST_NAME = 100
"""Characters of a room's name."""
_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class RoomEntry(BaseModel):
    """A room of a place.

    Attributes:
        name: of the room, one of its kind in the place.
        bundle: path of its bundle, relative to the place's folder, with slashes.
        sha256: digest of the bundle, as :func:`monoloc.bundle.digest_of` gives it.
    """

    model_config = _STRICT

    name: str = Field(min_length=1, max_length=MOST_NAME)
    bundle: str = Field(min_length=1, max_length=4096)
    sha256: str = Field(pattern="^[0-9a-f]{64}$")

    @field_validator("bundle")
    @classmethod
    def _is_relative(cls, path: str) -> str:
        if PurePosixPath(path).is_absolute() or PureWindowsPath(path).is_absolute():
            raise ValueError("must be relative to the place")
        return path


class Door(BaseModel):
    """A way between two rooms, which holds in both directions.

    Attributes:
        a, b: names of the rooms.
        pose: ``T_a_b``, from the world of b to that of a: tx, ty, tz in metres, then qx, qy, qz, qw.
        position_sd_m, rotation_sd_rad: standard deviations an axis of where ``T_a_b`` puts a camera in the door.
        centre_m: position of the door in the world of a, (3,).
        radius_m: distance from the centre within which a camera may be on its way through.
    """

    model_config = _STRICT

    a: str
    b: str
    pose: tuple[_Coordinate, _Coordinate, _Coordinate, float, float, float, float]
    position_sd_m: float = Field(gt=0.0, le=10.0)
    rotation_sd_rad: float = Field(gt=0.0, le=math.pi)
    centre_m: tuple[_Coordinate, _Coordinate, _Coordinate]
    radius_m: float = Field(gt=0.0, le=100.0)

    @model_validator(mode="after")
    def _check(self) -> Door:
        if self.a == self.b:
            raise ValueError(f"a door must join two rooms, not {self.a} with itself")
        if abs(math.hypot(*self.pose[3:]) - 1.0) > UNIT_TOLERANCE:
            raise ValueError("pose must end in a quaternion of length 1")
        return self

    @classmethod
    def between(
        cls,
        a: str,
        b: str,
        T_a_b: FloatArray,
        sds: tuple[float, float],
        centre_m: FloatArray,
        radius_m: float,
    ) -> Door:
        """A door from a pose (4, 4), its standard deviations in metres and radians, and its place (3,) in a."""
        numbers = (*T_a_b[:3, 3].tolist(), *rotation_to_quaternion(T_a_b[:3, :3]).tolist())
        return cls(
            a=a,
            b=b,
            pose=numbers,
            position_sd_m=sds[0],
            rotation_sd_rad=sds[1],
            centre_m=(float(centre_m[0]), float(centre_m[1]), float(centre_m[2])),
            radius_m=radius_m,
        )

    @property
    def T_a_b(self) -> FloatArray:
        return make_pose(quaternion_to_rotation(np.array(self.pose[3:])), np.array(self.pose[:3]))

    def joins(self, room: str) -> bool:
        return room in (self.a, self.b)

    def beyond(self, room: str) -> str:
        """The room on the other side."""
        return self.b if room == self.a else self.a

    def T_beyond_here(self, room: str) -> FloatArray:
        """From the world of a room to that of the room on the other side, (4, 4)."""
        return invert(self.T_a_b) if room == self.a else self.T_a_b

    def centre_in(self, room: str) -> FloatArray:
        """Its position in the world of one of its rooms, (3,)."""
        centre = np.array(self.centre_m)
        return centre if room == self.a else transform(invert(self.T_a_b), centre[None])[0]


class PlaceManifest(BaseModel):
    """Rooms and doors of a place, and the digest of the index of its rooms."""

    model_config = _STRICT

    schema_version: int = SCHEMA
    monoloc_version: str
    rooms: tuple[RoomEntry, ...] = Field(min_length=1)
    doors: tuple[Door, ...] = ()
    index_sha256: str = Field(pattern="^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _check(self) -> PlaceManifest:
        names = Counter(room.name for room in self.rooms)
        twice = [name for name, count in names.items() if count > 1]
        if twice:
            raise ValueError(f"two rooms have the name {twice[0]}")
        unknown = [name for door in self.doors for name in (door.a, door.b) if name not in names]
        if unknown:
            raise ValueError(f"a door leads to {unknown[0]}, which is no room of the place")
        return self


def parse_place(content: bytes, file: Path) -> PlaceManifest:
    """The manifest that a file holds.

    Raises:
        DataError: it is damaged, or is of a schema that cannot be read.
    """
    try:
        body = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise DataError(file, "is cut short or edited", _MAKE) from error
    found = body.get("schema_version") if isinstance(body, dict) else None
    if found != SCHEMA:
        raise DataError(file, f"has schema {found}, this monoloc reads {SCHEMA}", "make it with this version")
    try:
        return PlaceManifest.model_validate(body)
    except ValidationError as error:
        raise DataError(file, describe(error), _MAKE) from error


def place_content(path: Path) -> bytes:
    """A place's manifest, as it lies there.

    Raises:
        DataError: there is no place at the path.
    """
    file = path / PLACE_MANIFEST
    try:
        return read_regular(file, _MOST_BYTES)
    except OSError as error:
        problem = (
            f"is not a place (no {PLACE_MANIFEST})" if path.is_dir() else "is not a place (there is no such folder)"
        )
        raise DataError(path, problem, _MAKE) from error
    except ValueError as error:
        raise DataError(file, f"cannot be read ({error})", _MAKE) from error
