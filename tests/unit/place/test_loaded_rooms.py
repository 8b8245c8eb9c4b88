"""Which rooms are in memory, and when one that cannot be read is read again."""

from __future__ import annotations

from typing import Any, cast

import pytest

from monoloc.bundle import Bundle
from monoloc.errors import BundleError
from monoloc.place.loaded_rooms import LoadedRooms
from monoloc.place.place_files import Place
from synthetic_room import CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture


class Disk:
    """A place whose rooms are all one bundle, of which some cannot be read."""

    def __init__(self, *damaged: str) -> None:
        self._bundle = make_bundle(room_mixture(Room(), 40), RoomRecording(Room(), make_path(2)))
        self.damaged, self.asked = set(damaged), list[str]()

    def read_room(self, name: str) -> Bundle:
        self.asked.append(name)
        if name in self.damaged:
            raise BundleError(name, "is damaged", "copy it again")
        return self._bundle


def rooms_on(disk: Disk, *read: str) -> LoadedRooms:
    rooms = LoadedRooms(cast(Place, cast(Any, disk)), CAMERA)
    assert all(rooms[name].bundle for name in read)
    return rooms


def test_a_room_that_cannot_be_read_is_read_again_only_after_some_seconds() -> None:
    """Near its door it is asked for at every frame, and each try may take longer than a frame."""
    disk = Disk("cellar")
    rooms = rooms_on(disk)
    for _ in range(80):
        with pytest.raises(BundleError, match="cellar: is damaged; copy it again"):
            rooms["cellar"]
        rooms.pass_time(0.1)
    assert 2 <= len(disk.asked) <= 4 and list(rooms.unreadable) == ["cellar"]
    disk.damaged.clear()
    rooms.pass_time(10.0)
    assert rooms["cellar"].bundle and not rooms.unreadable


def test_only_a_room_that_was_read_takes_the_place_of_the_least_recently_used() -> None:
    rooms = rooms_on(Disk("cellar"), "hall", "kitchen", "study", "hall")
    with pytest.raises(BundleError):
        rooms["cellar"]
    assert rooms.names == ["kitchen", "study", "hall"]
    assert rooms["attic"].bundle and rooms.names == ["study", "hall", "attic"]


def test_a_room_that_is_kept_is_dropped_after_the_others() -> None:
    rooms = rooms_on(Disk(), "hall", "kitchen", "study")
    rooms.keep("hall")
    rooms.keep("cellar")  # not in memory
    assert rooms["attic"].bundle and rooms.names == ["study", "hall", "attic"]
