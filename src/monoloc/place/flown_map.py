"""What a flight is localised in, which a path names: a room, or a place of several."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from monoloc.bundle import Bundle, digest_of, read_bundle
from monoloc.bundle_manifest import MANIFEST, PLACE_MANIFEST, Provenance
from monoloc.camera import Camera
from monoloc.config import override
from monoloc.errors import DataError
from monoloc.flight.flight_loop import FlightLocalizer
from monoloc.flight.in_place import InPlace
from monoloc.geometry import FloatArray
from monoloc.localizer import Localizer
from monoloc.particle_filter.particles import Particles
from monoloc.place.place_files import SUFFIX, Place, read_place
from monoloc.place.place_flight import PlaceFlight
from monoloc.place.place_localizer import PlaceLocalizer
from monoloc.place.place_manifest import place_content
from monoloc.start import Start


@dataclass(frozen=True)
class MapLocalizer:
    """A localizer of a room or a place, and what a flight asks of it after a step.

    Attributes:
        localizer: takes the frames.
        particles: of the last step.
        in_place: where the last step was; None in a single room.
    """

    localizer: FlightLocalizer
    particles: Callable[[], Particles]
    in_place: Callable[[], InPlace | None]


@dataclass(frozen=True)
class FlownMap:
    """A room, or a place whose rooms doors join.

    Attributes:
        path: of the bundle or the place.
        down: direction of gravity, (3,) unit vector in the world of the room, or of the first room of the place; None
            where that room does not tell it.
        provenance: of that room.
        room: the bundle; None of a place.
        place: None of a room.
    """

    path: Path
    down: FloatArray | None
    provenance: Provenance
    room: Bundle | None = None
    place: Place | None = None

    @property
    def is_place(self) -> bool:
        return self.place is not None

    @property
    def is_searched(self) -> bool:
        """Whether a flight may begin without a start."""
        return self.room is None or self.room.supports_relocalization

    def rooms(self) -> Iterator[Bundle]:
        """The room, or every room of the place, which is read when it is asked for.

        Raises:
            BundleError: as :func:`open_map`.
        """
        if self.place is not None:
            yield from map(self.place.read_room, self.place.names)
        elif self.room is not None:
            yield self.room

    def scale_sd(self) -> float:
        """Relative standard deviation of the least certain map's scale; 0 where a sensor measured it.

        Raises:
            BundleError: as :func:`open_map`.
        """
        return max(room.provenance.scale_sd or 0.0 for room in self.rooms())

    def has_landmarks(self) -> bool:
        """Whether any room has landmarks.

        Raises:
            BundleError: as :func:`open_map`.
        """
        return any(len(room.landmarks) > 0 for room in self.rooms())

    def localizer(
        self,
        camera: Camera,
        start: Start | None,
        seed: int,
        budget_ms: float | None = None,
        threads: int | None = None,
    ) -> MapLocalizer:
        """A localizer that has taken no frame.

        Args:
            camera: of the frames.
            start: the first pose in the room; None searches room or place. A place takes none.
            seed: of all random numbers.
            budget_ms, threads: of a step; None takes the bundles'.

        Raises:
            DataError, SettingError, ValueError: as :class:`~monoloc.localizer.Localizer`.
        """
        if self.place is not None:
            flight = PlaceFlight(
                PlaceLocalizer(self.place, camera, seed=seed, budget_ms=budget_ms, threads=threads), self.place
            )
            return MapLocalizer(flight, lambda: flight.particles, lambda: flight.in_place)
        assert self.room is not None
        config = override(self.room.settings, budget_ms=budget_ms, threads=threads)
        localizer = Localizer(self.room, camera, start, config, seed=seed)
        return MapLocalizer(localizer, lambda: localizer.particles, lambda: None)


def is_place(path: Path) -> bool:
    """Whether a folder holds a place. Where it holds neither place nor bundle, its name says which is missing."""
    holds_bundle = (path / MANIFEST).exists()
    return (path / PLACE_MANIFEST).is_file() or (path.suffix == SUFFIX and not holds_bundle)


def open_map(path: Path, public_key: Path | None = None) -> FlownMap:
    """A bundle, or a place, to fly in.

    Args:
        path: of either; what is in the folder tells.
        public_key: of who must have signed every bundle; None takes bundles of anybody.

    Raises:
        BundleError: a bundle is none, damaged, changed, missing from the place, or not signed with the key.
        DataError: a place is damaged, or has a room that no doors join to the first, or the key is none.
        MissingExtraError: as :func:`monoloc.bundle_signature.read_public_key`, with a key only.
    """
    if not is_place(path):
        room = read_bundle(path, public_key)
        return FlownMap(path, room.down, room.provenance, room=room)
    place = read_place(path, public_key)
    first = place.names[0]
    apart = [name for name in place.names if place.way(name, first) is None]
    if apart:
        problem = f"no doors lead from room {apart[0]} to {first}, in whose world a flight sends its poses"
        fix = "measure the door: monoloc place door PLACE A B SOURCE"
        raise DataError(path, problem, fix, "how-to/many-rooms")
    room = place.read_room(first)
    return FlownMap(path, room.down, room.provenance, place=place)


def digest_of_map(path: Path) -> str:
    """SHA-256 of the manifest of a bundle or a place, which holds those of all that they are made of.

    Raises:
        BundleError, DataError: there is neither at the path.
    """
    return hashlib.sha256(place_content(path)).hexdigest() if is_place(path) else digest_of(path)
