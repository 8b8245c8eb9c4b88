"""A place as a folder ``NAME.place``: ``place.json`` and ``index.npz``. Bundles stay where they are.

The folder is written whole or not at all, and read only if every bundle is the one that the place was made of.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import decode_arrays, encode_arrays
from monoloc.bundle import Bundle, check_bytes, digest_of, read_bundle, read_described
from monoloc.bundle_manifest import PLACE_INDEX, PLACE_MANIFEST, container_of, manifest_content
from monoloc.bundle_signature import SIGNATURE, PublicKey, read_public_key
from monoloc.errors import BundleError, DataError, SettingError
from monoloc.files import read_regular, target_of, write_folder
from monoloc.geometry import FloatArray
from monoloc.landmarks.landmark_map import LEAST_RELOCALIZED
from monoloc.place.place_manifest import MOST_NAME, Door, PlaceManifest, RoomEntry, parse_place, place_content
from monoloc.place.room_index import RoomIndex, selected_descriptors
from monoloc.version import __version__

SUFFIX = ".place"

_BUNDLE_SUFFIX = ".monoloc"
_AGAIN = "make the place again: monoloc place new"


@dataclass(frozen=True)
class Place:
    """Rooms that a camera can go between.

    Attributes:
        path: of the folder.
        manifest: rooms and doors.
        descriptors: (K, 32) uint8 that stand for each room, in the manifest's order.
        public_key: of who must have signed the bundles; None takes bundles of anybody.
    """

    path: Path
    manifest: PlaceManifest
    descriptors: tuple[NDArray[np.uint8], ...]
    public_key: PublicKey | None = None

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
            BundleError: it is missing, damaged, not signed as it must be, or no longer the one that the place was
                made of.
        """
        entry = next(each for each in self.manifest.rooms if each.name == room)
        return read_described(*_checked_bundle(self.path, entry, self.public_key))

    def T_other_room(self, other: str, room: str) -> FloatArray | None:
        """``T_other_room``, (4, 4), from the world of a room to that of another; None where no doors lead there."""
        way = self.way(room, other)
        if way is None:
            return None
        T_here_room = np.eye(4)
        for here, door in way:
            T_here_room = door.T_beyond_here(here) @ T_here_room
        return T_here_room

    def way(self, room: str, other: str) -> list[tuple[str, Door]] | None:
        """The fewest doors from a room to another, each after the room that it is entered from; None without any.

        From a room to itself there are no doors, and the list is empty.
        """
        ways: dict[str, list[tuple[str, Door]]] = {room: []}  # to the rooms that are reached
        queue = [room]
        while queue:
            here = queue.pop(0)
            for door in self.doors_of(here):
                beyond = door.beyond(here)
                if beyond not in ways:
                    ways[beyond] = [*ways[here], (here, door)]
                    queue.append(beyond)
        return ways.get(other)

    def with_door(self, door: Door) -> Place:
        """The place with a door, in place of those between the same rooms that it reaches."""

        def is_same(other: Door) -> bool:
            if {other.a, other.b} != {door.a, door.b}:
                return False
            return float(np.linalg.norm(other.centre_in(door.a) - door.centre_in(door.a))) < door.radius_m

        doors = (*(each for each in self.manifest.doors if not is_same(each)), door)
        return replace(self, manifest=self.manifest.model_copy(update={"doors": doors}))


def make_place(path: Path, bundles: Sequence[Path], public_key: Path | None = None) -> Place:
    """A place without doors, of bundles, named as these are; it is not written.

    Args:
        path: of the place.
        bundles: of its rooms.
        public_key: of who must have signed them; None takes bundles of anybody.

    Raises:
        BundleError: one is no bundle, or not signed with the key.
        DataError: one has too few landmarks, which tell rooms apart, or the key is none.
        MissingExtraError: as :func:`monoloc.bundle_signature.read_public_key`, with a key only.
        SettingError: two have the same name or the same content, or one has a name that is none of a room.
    """
    rooms: dict[str, RoomEntry] = {}
    descriptors = []
    for bundle in bundles:
        name = _name_of(bundle)
        if name in rooms:
            raise SettingError("ROOM", f"two bundles are named {name}", "rename one: a room is named as its bundle")
        digest, selected = described_room(bundle, public_key)
        if same := next((other for other in rooms.values() if other.sha256 == digest), None):
            problem = f"{same.name} and {name} are copies of one bundle, which landmarks cannot tell apart"
            raise SettingError("ROOM", problem, "name the bundle of each room once")
        relative = Path(os.path.relpath(bundle.resolve(), target_of(path))).as_posix()
        rooms[name] = RoomEntry(name=name, bundle=relative, sha256=digest)
        descriptors.append(selected)
    content = _packed(descriptors)
    manifest = PlaceManifest(
        monoloc_version=__version__, rooms=tuple(rooms.values()), index_sha256=hashlib.sha256(content).hexdigest()
    )
    return Place(path, manifest, tuple(descriptors), None if public_key is None else read_public_key(public_key))


def described_room(bundle: Path, public_key: Path | None = None) -> tuple[str, NDArray[np.uint8]]:
    """What a place keeps of a bundle: its digest, and the descriptors that stand for it, (K, 32).

    Raises:
        BundleError: it is no bundle, or not signed with the key.
        DataError: it has too few landmarks, which tell rooms apart, or the key is none.
        MissingExtraError: as :func:`monoloc.bundle_signature.read_public_key`, with a key only.
    """
    room, digest = read_bundle(bundle, public_key), digest_of(bundle)
    if not room.supports_landmark_search:
        fix = "build it with landmarks, from a recording in which several frames see the same corners"
        raise DataError(bundle, f"has fewer than {LEAST_RELOCALIZED} landmarks, which tell rooms apart", fix)
    return digest, selected_descriptors(room.landmarks)


def _name_of(bundle: Path) -> str:
    name = bundle.resolve().name.removesuffix(_BUNDLE_SUFFIX)
    if not 1 <= len(name) <= MOST_NAME:
        problem = f"{bundle} has a name of {len(name)} characters before {_BUNDLE_SUFFIX}"
        raise SettingError("ROOM", problem, f"rename it, to 1 to {MOST_NAME}: a room is named as its bundle")
    return name


def check_place_target(path: Path) -> None:
    """Refuse a path where a place must not be written, before the work is done.

    Raises:
        DataError: it is not named as a place, exists and holds other things, or its folder does not exist.
    """
    if path.suffix != SUFFIX:
        raise DataError(path, "is not named as a place", f"name it NAME{SUFFIX}")
    if (container := container_of(path)) is not None:
        raise DataError(path, f"lies in {container}", "choose another folder")
    if not path.resolve().parent.is_dir():
        raise DataError(path, "its folder does not exist", f"make {path.parent} first")
    if path.exists() and not path.is_dir():
        raise DataError(path, "is a file", "choose another name")
    own = {PLACE_MANIFEST, PLACE_INDEX, SIGNATURE}
    others = sorted({file.name for file in path.iterdir()} - own) if path.exists() else []
    if others:
        raise DataError(path, f"holds more than a place ({others[0]})", "move that away or choose another name")


def replaced_doors(path: Path) -> int:
    """Number of doors of the place that :func:`write_place` would replace, 0 where there is none that can be read."""
    try:
        return len(parse_place(place_content(path), path / PLACE_MANIFEST).doors)
    except DataError:
        return 0


def write_place(place: Place) -> int:
    """Write a place, replacing an older one and its signature; returns its size in bytes, without the bundles.

    Raises:
        DataError: as :func:`check_place_target`, or the disk does not take it.
    """
    check_place_target(place.path)
    index = _packed(place.descriptors)
    # Of what is written here: another computer may have compressed the same index to other bytes.
    manifest = place.manifest.model_copy(update={"index_sha256": hashlib.sha256(index).hexdigest()})
    contents = {
        PLACE_MANIFEST: manifest.model_dump_json(indent=1).encode(),
        PLACE_INDEX: index,
    }
    return write_folder(place.path, contents)


def read_place(path: str | Path, public_key: Path | None = None, *, is_edited: bool = False) -> Place:
    """Read a place, and check that its bundles are there, unchanged and signed, and that the place is signed.

    Every byte of the bundles is checked, so that a flight does not begin in a place with a damaged room.

    Args:
        path: of the place.
        public_key: of who must have signed every bundle and the place; None takes those of anybody.
        is_edited: whether the place is read to be changed, so that only its bundles must be signed.

    Raises:
        BundleError: a bundle is missing, damaged or changed, or a bundle or the place is not signed with the key.
        DataError: not a place, damaged, or of an unknown schema, or the key is none.
        MissingExtraError: as :func:`monoloc.bundle_signature.read_public_key`, with a key only.
    """
    path = Path(path)
    content = place_content(path)
    manifest = parse_place(content, path / PLACE_MANIFEST)
    key = None if public_key is None else read_public_key(public_key)
    for room in manifest.rooms:
        check_bytes(*_checked_bundle(path, room, key))
    if key is not None and not is_edited:
        key.check(path, content)
    return Place(path, manifest, _read_index(path / PLACE_INDEX, manifest), key)


def read_unchecked(path: Path, public_key: Path | None = None) -> Place:
    """Read a place to be changed, whatever its bundles are now; raises as :func:`read_place` of the place itself."""
    manifest = parse_place(place_content(path), path / PLACE_MANIFEST)
    key = None if public_key is None else read_public_key(public_key)
    return Place(path, manifest, _read_index(path / PLACE_INDEX, manifest), key)


def bundle_of(path: Path, room: RoomEntry) -> Path:
    """Where the bundle of a room of a place lies."""
    return Path(os.path.normpath(target_of(path) / room.bundle))


def _checked_bundle(path: Path, room: RoomEntry, key: PublicKey | None) -> tuple[Path, bytes]:
    """Where a room's bundle lies, and its manifest, which is the place's and signed if there is a key.

    Its other files are not looked at. The place itself need not be written yet.
    """
    bundle = bundle_of(path, room)
    try:
        content = manifest_content(bundle)
    except BundleError as error:
        fix = f"put it back, or {_AGAIN}"
        raise BundleError(bundle, f"the bundle of room {room.name} is missing", fix) from error
    if hashlib.sha256(content).hexdigest() != room.sha256:
        fix = f"where it was edited: monoloc place update; else put the old one back, or {_AGAIN}"
        raise BundleError(bundle, f"is not the bundle that room {room.name} was made of", fix)
    if key is not None:
        key.check(bundle, content)
    return bundle, content


def _packed(descriptors: Sequence[NDArray[np.uint8]]) -> bytes:
    return encode_arrays({str(number): each for number, each in enumerate(descriptors)})


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
