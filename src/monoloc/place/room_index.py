"""Which room of a place an image shows: descriptors vote for rooms.

A bounded, even selection of a room's landmark descriptors stands for the room. It ranks rooms and decides nothing:
the strict search among all landmarks of the best rooms does (:mod:`monoloc.place.room_search`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from monoloc.io.recording import evenly_spaced
from monoloc.landmarks.features import MATCH_BITS, nearest_descriptors
from monoloc.landmarks.landmark_map import Landmarks

ROOM_DESCRIPTORS = 1000
"""Of a room in the index, at most: 32 kB."""

_VOTERS = 200  # of an image's descriptors
_AS_GOOD_BITS = 4  # by which a room's nearest descriptor may differ from the best one and vote as well


def selected_descriptors(landmarks: Landmarks, most: int = ROOM_DESCRIPTORS) -> NDArray[np.uint8]:
    """Descriptors (K, 32) that stand for a room: of every view alike, those first that most views found.

    Views take turns, so that each part of the room is as well known as the others.
    """
    count = len(landmarks)
    if count <= most or landmarks.views is None or not len(landmarks.views.found):
        return landmarks.descriptors[evenly_spaced(count, min(count, most))]
    found = landmarks.views.found
    by_times = np.argsort(-found.sum(axis=0), kind="stable")
    queues = [iter(by_times[view[by_times]].tolist()) for view in found]
    taken: dict[int, None] = {}  # in order
    while queues and len(taken) < most:
        queues = [queue for queue in queues if _take_next(queue, taken)]
    return landmarks.descriptors[np.array(list(taken)[:most], dtype=np.int64)]


def _take_next(queue: Iterator[int], taken: dict[int, None]) -> bool:
    """Take the next landmark of a view that is not taken yet; False where there is none left."""
    for landmark in queue:
        if landmark not in taken:
            taken[landmark] = None
            return True
    return False


class RoomIndex:
    """Ranks R rooms by an image's descriptors.

    Args:
        rooms: (K, 32) uint8 of each room, K >= 1.
    """

    def __init__(self, rooms: Sequence[NDArray[np.uint8]]) -> None:
        self._rooms = list(rooms)

    def votes(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int64]:
        """How many of at most 200 of N descriptors (N, 32) each room knows as well as any other room does, (R,).

        A descriptor votes for all rooms that know it alike, so that rooms that look the same rank the same.
        """
        voters = descriptors[evenly_spaced(len(descriptors), _VOTERS)] if len(descriptors) else descriptors
        if not len(voters):
            return np.zeros(len(self._rooms), dtype=np.int64)
        bits = np.stack([nearest_descriptors(voters, room, 1, MATCH_BITS)[0][:, 0] for room in self._rooms])
        best = bits.min(axis=0)
        return np.asarray(((bits <= best + _AS_GOOD_BITS) & (bits < MATCH_BITS)).sum(axis=1, dtype=np.int64))
