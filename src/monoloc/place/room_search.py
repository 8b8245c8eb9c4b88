"""Which room of a place a camera is in, of which nothing is known: by the index, then by landmarks.

The index ranks all rooms at a small cost. In the best few, the strict search among all landmarks decides. Two rooms
that agree nearly alike decide nothing, since a wrong room is worse than a lost camera, unless doors join them and
both find the camera at one place: they overlap there. Of a room that cannot be read, only the index tells whether it
may be the camera's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from monoloc.errors import BundleError
from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import FloatArray, pose_distance_m
from monoloc.landmarks.features import Keypoints
from monoloc.place.loaded_rooms import MOST_LOADED, LoadedRooms
from monoloc.place.place_files import Place

_LEAST_VOTES = 10  # of a room in which the camera is searched for
_RIVAL_SHARE = 0.5  # of the best room's landmarks with which another room counts as well
# Of its votes, with which one that cannot be read does: rooms that have nothing in common often have half of them.
_RIVAL_VOTES = 0.8


@dataclass(frozen=True)
class _Found:
    """What a search finds in a room.

    Attributes:
        room: its name.
        agreeing: number of landmarks that agree on one pose without a prior.
        pose: ``T_room_camera``, (4, 4); None where there is none.
        is_only_place: whether there is such a pose, and no other place of the room looks alike.
    """

    room: str
    agreeing: int
    pose: FloatArray | None
    is_only_place: bool


class RoomSearch:
    """Searches all rooms of a place for a camera.

    Args:
        place: with its index.
        rooms: reads the rooms that are searched.
    """

    def __init__(self, place: Place, rooms: LoadedRooms) -> None:
        self._place, self._rooms = place, rooms
        self._names, self._index = place.names, place.index()

    def ranked(self, seen: Keypoints, known: str | None = None) -> dict[str, int]:
        """The rooms that are worth a search, best first, and the votes of each.

        Args:
            seen: keypoints of an image.
            known: room that the camera was in before, which is always among them.
        """
        votes = self._index.votes(seen.descriptors)
        order = np.argsort(-votes, kind="stable")[:MOST_LOADED]
        names = [self._names[index] for index in order.tolist() if votes[index] >= _LEAST_VOTES]
        if known is not None and known not in names:
            names = [*names[: MOST_LOADED - 1], known]
        return {name: int(votes[self._names.index(name)]) for name in names}

    def find(self, seen: Keypoints, known: str | None = None) -> str | None:
        """The room that an image's keypoints show; None where none or several agree. Arguments as :meth:`ranked`.

        Rooms that cannot be read are left out, unless they may well be the camera's: then there is no room either.
        """
        if known is not None:  # whose localizer goes on in it
            self._rooms.keep(known)
        votes = self.ranked(seen, known)
        found = {name: self._found(name, seen) for name in votes}
        room = self._decided([each for each in found.values() if each is not None])
        if room is None or any(
            votes[name] >= _RIVAL_VOTES * votes[room] for name, each in found.items() if each is None
        ):
            return None
        return room

    def _found(self, name: str, seen: Keypoints) -> _Found | None:
        """What the search finds in a room; None where it cannot be read."""
        try:
            landmarks = self._rooms[name].landmarks
        except BundleError:
            return None
        pose, is_only_place = landmarks.best_place(seen)
        if pose is None:
            return _Found(name, 0, None, is_only_place)
        return _Found(name, len(pose.points), pose.pose, is_only_place)

    def _decided(self, found: Sequence[_Found]) -> str | None:
        """The room with the most landmarks, if they are of one place, and no other room has nearly as many elsewhere.

        A room whose own places look alike speaks against others all the same.
        """
        if not found:
            return None
        best = max(found, key=lambda each: each.agreeing)
        if best.pose is None or not best.is_only_place:
            return None
        rivals = [each for each in found if each is not best and each.agreeing >= _RIVAL_SHARE * best.agreeing]
        return best.room if all(self._is_same_place(best, rival) for rival in rivals) else None

    def _is_same_place(self, best: _Found, rival: _Found) -> bool:
        """Whether both rooms find the camera at one place, by the doors between them."""
        T_rival_best = self._place.T_other_room(rival.room, best.room)
        if T_rival_best is None or best.pose is None or rival.pose is None:
            return False
        return float(pose_distance_m(rival.pose, (T_rival_best @ best.pose)[None])[0]) < FAR_M
