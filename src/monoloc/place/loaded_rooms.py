"""The rooms of a place that are held in memory: a few, whatever the number of rooms."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.config import override
from monoloc.errors import BundleError
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.place.place_files import Place

MOST_LOADED = 3
"""Rooms in memory at most: the current one and two neighbours, or three that are searched."""

_RETRY_S = 3.0  # before a room that could not be read is read again, which may take longer than a frame
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


@dataclass(frozen=True)
class _Failure:
    """Why a room could not be read, and until when it is not read again."""

    error: BundleError
    until_s: float


class LoadedRooms:
    """Reads rooms when they are asked for, and drops those that were not asked for the longest.

    While a room is read, one more is in memory: a room that cannot be read takes no other's place. It is read again
    at the earliest three seconds later, by :meth:`pass_time`.

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
        self._failures: dict[str, _Failure] = {}
        self._now_s = 0.0

    @property
    def names(self) -> list[str]:
        """Of the rooms in memory, the one that was asked for last at the end."""
        return list(self._rooms)

    @property
    def unreadable(self) -> Mapping[str, str]:
        """Why rooms could not be read when they were asked for last, by name."""
        return {name: str(failure.error) for name, failure in self._failures.items()}

    def keep(self, name: str) -> None:
        """Count a room in memory as asked for now, so that others are dropped before it."""
        if name in self._rooms:
            self._rooms.move_to_end(name)

    def pass_time(self, elapsed_s: float) -> None:
        """Let the time from one frame to the next pass."""
        self._now_s += elapsed_s

    def __getitem__(self, name: str) -> LoadedRoom:
        """A room, which is read if it is not in memory.

        Raises:
            BundleError: its bundle is missing, damaged or changed, or was so less than three seconds ago.
            SettingError: ``budget_ms`` or ``threads`` is out of range.
        """
        if name not in self._rooms:
            bundle = self._read(name)
            integrity = bundle.integrity.model_copy(update={"scan_search_precision": _NEVER})
            settings = override(bundle.settings, budget_ms=self._budget_ms, threads=self._threads)
            landmarks = OrbLandmarkLocalizer(bundle.landmarks, self._camera)
            while len(self._rooms) >= MOST_LOADED:
                self._rooms.popitem(last=False)
            self._rooms[name] = LoadedRoom(replace(bundle, integrity=integrity, settings=settings), landmarks)
        self._rooms.move_to_end(name)
        return self._rooms[name]

    def _read(self, name: str) -> Bundle:
        failure = self._failures.get(name)
        if failure is not None and self._now_s < failure.until_s:
            raise copy(failure.error)
        try:
            bundle = self._place.read_room(name)
        except BundleError as error:
            # A copy has no traceback, which would keep alive what was read.
            self._failures[name] = _Failure(copy(error), self._now_s + _RETRY_S)
            raise
        self._failures.pop(name, None)
        return bundle
