"""The rooms of a place that are held in memory: a few, whatever the number of rooms."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.config import override
from monoloc.errors import BundleError
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.place.place_files import Place

MOST_LOADED = 3
"""Rooms in memory at most: the current one and two neighbours, or three that are searched."""

_NEVER = 0.01  # precision of a search by scans in a place


@dataclass(frozen=True)
class LoadedRoom:
    """A room in memory.

    Attributes:
        bundle: of the room; its scans search for no camera, see :class:`LoadedRooms`.
        landmarks: measures poses by its landmarks.
    """

    bundle: Bundle
    landmarks: OrbLandmarkLocalizer


class LoadedRooms:
    """Reads rooms when they are asked for, and drops those that were not asked for the longest.

    How often a room's scans find a camera was measured inside the room. In another room they find one too. So only
    landmarks search for a camera in a place.

    Args:
        place: that the rooms are of.
        camera: that is localised in them.
        budget_ms, threads: of a step, in place of each bundle's; None takes the bundle's.
    """

    def __init__(
        self, place: Place, camera: Camera, budget_ms: float | None = None, threads: int | None = None
    ) -> None:
        self._place, self._camera = place, camera
        self._budget_ms, self._threads = budget_ms, threads
        self._rooms: OrderedDict[str, LoadedRoom] = OrderedDict()
        self._unreadable: dict[str, str] = {}

    @property
    def names(self) -> list[str]:
        """Of the rooms in memory, the one that was asked for last at the end."""
        return list(self._rooms)

    @property
    def unreadable(self) -> Mapping[str, str]:
        """Why rooms could not be read when they were asked for last, by name."""
        return dict(self._unreadable)

    def __getitem__(self, name: str) -> LoadedRoom:
        """A room, which is read if it is not in memory.

        Raises:
            BundleError: its bundle is missing, damaged or changed.
            SettingError: ``budget_ms`` or ``threads`` is out of range.
        """
        if name not in self._rooms:
            while len(self._rooms) >= MOST_LOADED:  # first, so that no more are ever in memory
                self._rooms.popitem(last=False)
            bundle = self._read(name)
            integrity = bundle.integrity.model_copy(update={"scan_search_precision": _NEVER})
            settings = override(bundle.settings, budget_ms=self._budget_ms, threads=self._threads)
            landmarks = OrbLandmarkLocalizer(bundle.landmarks, self._camera)
            self._rooms[name] = LoadedRoom(replace(bundle, integrity=integrity, settings=settings), landmarks)
        self._rooms.move_to_end(name)
        return self._rooms[name]

    def _read(self, name: str) -> Bundle:
        try:
            bundle = self._place.read_room(name)
        except BundleError as error:
            self._unreadable[name] = str(error)
            raise
        self._unreadable.pop(name, None)
        return bundle
