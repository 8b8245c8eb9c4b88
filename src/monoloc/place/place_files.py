"""A place as a folder ``NAME.place``: ``place.json`` and ``index.npz``. Bundles stay where they are.

The folder is written whole or not at all, and read only if every bundle is the one that the place was made of.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import decode_arrays
from monoloc.bundle import Bundle, digest_of, read_bundle
from monoloc.errors import BundleError, DataError, SettingError
from monoloc.files import read_regular, target_of
from monoloc.geometry import FloatArray, invert
from monoloc.partial_files import whole_folder
from monoloc.place.place_manifest import MANIFEST, Door, PlaceManifest, RoomEntry, parse_place, place_content
from monoloc.place.room_index import RoomIndex, selected_descriptors
from monoloc.version import __version__

SUFFIX = ".place"

_INDEX = "index.npz"
_BUNDLE_SUFFIX = ".monoloc"
_AGAIN = "make the place again: monoloc place new"


@dataclass(frozen=True)
class Place:
    """Rooms that a camera can go between.

    Attributes:
        path: of the folder.
        manifest: rooms and doors.
        descriptors: (K, 32) uint8 that stand for each room, in the manifest's order.
    """

    path: Path
    manifest: PlaceManifest
    descriptors: tuple[NDArray[np.uint8], ...]

    @property
    def names(self) -> list[str]:
        """Of the rooms."""
        return [room.name for room in self.manifest.rooms]

    def index(self) -> RoomIndex:
        return RoomIndex(self.descriptors)

    def doors_of(self, room: str) -> list[Door]:
        return [door for door in self.manifest.doors if door.joins(room)]

    def read_room(self, room: str) -> Bundle:
        """A room's bundle.

        Raises:
            BundleError: it is missing, damaged, or no longer the one that the place was made of.
        """
        entry = next(each for each in self.manifest.rooms if each.name == room)
        return read_bundle(_checked_bundle(self.path, entry))

    def T_other_room(self, other: str, room: str) -> FloatArray | None:
        """``T_other_room``, (4, 4), from the world of a room to that of another; None where no doors lead there."""
        T_room_here = {room: np.eye(4)}  # of the rooms that are reached
        queue = [room]
        while queue:
            here = queue.pop(0)
            for door in self.doors_of(here):
                beyond = door.beyond(here)
                if beyond not in T_room_here:
                    T_room_here[beyond] = T_room_here[here] @ invert(door.T_beyond_here(here))
                    queue.append(beyond)
        return invert(T_room_here[other]) if other in T_room_here else None

    def with_door(self, door: Door) -> Place:
        """The place with a door, in place of those between the same rooms that it reaches."""

        def is_same(other: Door) -> bool:
            if {other.a, other.b} != {door.a, door.b}:
                return False
            return float(np.linalg.norm(other.centre_in(door.a) - door.centre_in(door.a))) < door.radius_m

        doors = (*(each for each in self.manifest.doors if not is_same(each)), door)
        return Place(self.path, self.manifest.model_copy(update={"doors": doors}), self.descriptors)


def make_place(path: Path, bundles: Sequence[Path]) -> Place:
    """A place without doors, of bundles, named as these are; it is not written.

    Raises:
        BundleError: one is no bundle.
        DataError: one has no landmarks, which tell rooms apart.
        SettingError: two have the same name.
    """
    rooms: dict[str, RoomEntry] = {}
    descriptors = []
    for bundle in bundles:
        name = bundle.resolve().name.removesuffix(_BUNDLE_SUFFIX)
        if name in rooms:
            raise SettingError("ROOM", f"two bundles are named {name}", "rename one: a room is named as its bundle")
        room = read_bundle(bundle)
        if not room.supports_landmark_search:
            fix = "build it with landmarks, from a recording in which several frames see the same corners"
            raise DataError(bundle, "has no landmarks, which tell rooms apart", fix)
        relative = Path(os.path.relpath(bundle.resolve(), target_of(path))).as_posix()
        rooms[name] = RoomEntry(name=name, bundle=relative, sha256=digest_of(bundle))
        descriptors.append(selected_descriptors(room.landmarks))
    content = _packed(descriptors)
    manifest = PlaceManifest(
        monoloc_version=__version__, rooms=tuple(rooms.values()), index_sha256=hashlib.sha256(content).hexdigest()
    )
    return Place(path, manifest, tuple(descriptors))


def check_place_target(path: Path) -> None:
    """Refuse a path where a place must not be written, before the work is done.

    Raises:
        DataError: it is not named as a place, exists and holds other things, or its folder does not exist.
    """
    if path.suffix != SUFFIX:
        raise DataError(path, "is not named as a place", f"name it NAME{SUFFIX}")
    if not path.resolve().parent.is_dir():
        raise DataError(path, "its folder does not exist", f"make {path.parent} first")
    if path.exists() and not path.is_dir():
        raise DataError(path, "is a file", "choose another name")
    others = sorted({file.name for file in path.iterdir()} - {MANIFEST, _INDEX}) if path.exists() else []
    if others:
        raise DataError(path, f"holds more than a place ({others[0]})", "move that away or choose another name")


def write_place(place: Place) -> int:
    """Write a place, replacing an older one; returns its size in bytes, without the bundles.

    Raises:
        DataError: as :func:`check_place_target`, or the disk does not take it.
    """
    check_place_target(place.path)
    contents: Mapping[str, bytes] = {
        MANIFEST: place.manifest.model_dump_json(indent=1).encode(),
        _INDEX: _packed(place.descriptors),
    }
    try:
        with whole_folder(target_of(place.path)) as folder:
            for name, content in contents.items():
                (folder / name).write_bytes(content)
    except OSError as error:
        fix = "make room for it, or name a place you can write to"
        raise DataError(place.path, f"cannot be written ({error.strerror})", fix) from error
    return sum(len(content) for content in contents.values())


def read_place(path: str | Path) -> Place:
    """Read a place, and check that its bundles are there and unchanged.

    Raises:
        BundleError: a bundle is missing or changed.
        DataError: not a place, damaged, or of an unknown schema.
    """
    path = Path(path)
    manifest = parse_place(place_content(path), path / MANIFEST)
    for room in manifest.rooms:
        _checked_bundle(path, room)
    return Place(path, manifest, _read_index(path / _INDEX, manifest))


def _checked_bundle(path: Path, room: RoomEntry) -> Path:
    """Where a room's bundle lies, which is there and unchanged; the place itself need not be written yet."""
    bundle = Path(os.path.normpath(target_of(path) / room.bundle))
    try:
        digest = digest_of(bundle)
    except BundleError as error:
        fix = f"put it back, or {_AGAIN}"
        raise BundleError(bundle, f"the bundle of room {room.name} is missing", fix) from error
    if digest != room.sha256:
        fix = f"put the old one back, or {_AGAIN}"
        raise BundleError(bundle, f"is not the bundle that room {room.name} was made of", fix)
    return bundle


def _packed(descriptors: Sequence[NDArray[np.uint8]]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **{str(number): each for number, each in enumerate(descriptors)})  # type: ignore[arg-type]
    return buffer.getvalue()


def _read_index(file: Path, manifest: PlaceManifest) -> tuple[NDArray[np.uint8], ...]:
    try:
        content = read_regular(file)
        if hashlib.sha256(content).hexdigest() != manifest.index_sha256:
            raise ValueError("it is not what was written")
        arrays = decode_arrays(content)
        index = tuple(arrays[str(number)] for number in range(len(manifest.rooms)))
        if any(each.dtype != np.uint8 or each.shape[1:] != (32,) or not len(each) for each in index):
            raise ValueError("it holds other arrays")
    except (OSError, ValueError, KeyError) as error:
        raise DataError(file, f"cannot be read ({error})", _AGAIN) from error
    return index
