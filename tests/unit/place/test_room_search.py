"""Which room a search says that a camera is in."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.errors import BundleError
from monoloc.geometry import FloatArray
from monoloc.landmarks.features import KeypointDetector
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.place.room_index import RoomIndex
from monoloc.place.room_search import RoomSearch
from monoloc.progress import NoProgress
from synthetic_room import CAMERA, Room, RoomRecording, make_path

POSES = make_path(60)


@pytest.fixture(scope="module")
def landmarks() -> Landmarks:
    recording = RoomRecording(Room(), POSES[::3])
    built, _, _ = build_landmarks(recording, recording.depth, NoProgress())
    return Landmarks(built.points, built.descriptors)


class Loaded(dict[str, Any]):
    """Rooms in memory, by the order of their use; others cannot be read."""

    def keep(self, name: str) -> None:
        self.kept = name

    def __missing__(self, name: str) -> Any:
        raise BundleError(name, "cannot be read", "put it back")


def search_among(
    unreadable: tuple[str, ...] = (), T_other_room: FloatArray | None = None, **rooms: Landmarks
) -> RoomSearch:
    """A search among rooms that are all joined by a door whose transform is ``T_other_room``, or by none."""
    place: Any = SimpleNamespace(
        names=list(rooms),
        index=lambda: RoomIndex([room.descriptors for room in rooms.values()]),
        T_other_room=lambda other, room: T_other_room,
    )
    loaded = {name: SimpleNamespace(landmarks=OrbLandmarkLocalizer(room, CAMERA)) for name, room in rooms.items()}
    return RoomSearch(place, cast(Any, Loaded({name: loaded[name] for name in loaded if name not in unreadable})))


def part_of(landmarks: Landmarks, share: float, shift_m: float = 0.0) -> Landmarks:
    kept = np.random.default_rng(3).uniform(size=len(landmarks)) < share
    return Landmarks(landmarks.points[kept] + np.float32([shift_m, 0.0, 0.0]), landmarks.descriptors[kept])


def test_a_room_whose_places_look_alike_speaks_against_another_that_looks_like_them(landmarks: Landmarks) -> None:
    """The camera is in *two*, which holds one place twice; *one* holds something like it once."""
    twin = part_of(landmarks, 0.9, shift_m=12.0)
    two = Landmarks(
        np.concatenate([landmarks.points, twin.points]), np.concatenate([landmarks.descriptors, twin.descriptors])
    )
    one = part_of(landmarks, 0.7)
    other, _, _ = build_landmarks(recording := RoomRecording(Room(seed=5), POSES[::3]), recording.depth, NoProgress())
    for pose in POSES[5::20]:
        seen = KeypointDetector(CAMERA)(Room().view(pose)[0])
        assert search_among(one=one, other=other).find(seen) == "one"
        assert search_among(one=one, two=two).find(seen) is None
        assert search_among(two=two, other=other).find(seen) is None  # its own search could not find the pose


def test_two_rooms_that_overlap_find_a_camera_where_both_see_it(landmarks: Landmarks) -> None:
    """A door between them says that both mean one place, or that what they see alike is elsewhere."""
    west, east = landmarks, part_of(landmarks, 0.8)
    elsewhere = np.eye(4)
    elsewhere[0, 3] = 5.0
    for pose in POSES[5::20]:
        seen = KeypointDetector(CAMERA)(Room().view(pose)[0])
        assert search_among(T_other_room=np.eye(4), west=west, east=east).find(seen) == "west"
        assert search_among(T_other_room=elsewhere, west=west, east=east).find(seen) is None
        assert search_among(west=west, east=east).find(seen) is None


def test_a_room_that_cannot_be_read_is_left_out_unless_the_view_may_be_of_it(landmarks: Landmarks) -> None:
    other, _, _ = build_landmarks(recording := RoomRecording(Room(seed=5), POSES[::3]), recording.depth, NoProgress())
    alike = part_of(landmarks, 0.9)
    for pose in POSES[5::20]:
        seen = KeypointDetector(CAMERA)(Room().view(pose)[0])
        assert search_among(("other",), one=landmarks, other=other).find(seen, known="other") == "one"
        assert search_among(("alike",), one=landmarks, alike=alike).find(seen) is None
        assert search_among(("one", "other"), one=landmarks, other=other).find(seen) is None
