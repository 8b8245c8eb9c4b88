"""A bounded selection of descriptors stands for a room, and tells rooms apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.place.room_index import RoomIndex, selected_descriptors


def seen_landmarks(views: int, in_each: int, rng: np.random.Generator) -> Landmarks:
    """Landmarks of which each view found some that no other view found, one view a hundred times as many."""
    counts = [100 * in_each, *[in_each] * (views - 1)]
    count = sum(counts)
    found = np.zeros((views, count), dtype=np.bool_)
    first = 0
    for view, number in enumerate(counts):
        found[view, first : first + number] = True
        first += number
    poses = np.tile(np.eye(4), (views, 1, 1))
    descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)
    return Landmarks(np.zeros((count, 3), np.float32), descriptors, LandmarkViews(poses, found))


def as_set(descriptors: NDArray[np.uint8]) -> set[bytes]:
    return {each.tobytes() for each in descriptors}


def test_every_view_is_stood_for_alike() -> None:
    landmarks = seen_landmarks(8, 20, np.random.default_rng(0))
    chosen = as_set(selected_descriptors(landmarks, 80))
    assert landmarks.views is not None and len(chosen) == 80
    for found in landmarks.views.found:
        assert len(chosen & as_set(landmarks.descriptors[found])) == 10


def test_views_with_few_landmarks_leave_their_turns_to_others() -> None:
    landmarks = seen_landmarks(4, 5, np.random.default_rng(0))
    assert len(as_set(selected_descriptors(landmarks, 100))) == 100


def test_small_rooms_are_kept_whole() -> None:
    landmarks = seen_landmarks(2, 3, np.random.default_rng(0))
    few = Landmarks(landmarks.points[:7], landmarks.descriptors[:7])
    assert as_set(selected_descriptors(few, 100)) == as_set(few.descriptors)
    assert as_set(selected_descriptors(landmarks, 1000)) == as_set(landmarks.descriptors)


def changed(descriptors: NDArray[np.uint8], share: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Descriptors of the same corners in another image: a share of their bits differs."""
    return np.asarray(descriptors ^ np.packbits(rng.uniform(size=(len(descriptors), 256)) < share, axis=1))


def test_the_room_whose_landmarks_are_seen_gets_the_votes() -> None:
    rng = np.random.default_rng(0)
    rooms = [rng.integers(0, 256, (200, 32), dtype=np.uint8) for _ in range(6)]
    strays = rng.integers(0, 256, (200, 32), dtype=np.uint8)
    votes = RoomIndex(rooms).votes(np.concatenate([changed(rooms[3][:80], 0.1, rng), strays]))
    assert votes.argmax() == 3 and votes[3] >= 50 and np.delete(votes, 3).max() < 10


def test_rooms_that_look_alike_get_the_same_votes() -> None:
    rng = np.random.default_rng(0)
    room = rng.integers(0, 256, (100, 32), dtype=np.uint8)
    votes = RoomIndex([room, changed(room, 0.005, rng), ~room]).votes(changed(room, 0.1, rng))
    assert votes[0] >= 95 and votes[1] >= 80 and votes[2] == 0


def test_an_image_without_keypoints_votes_for_none() -> None:
    index = RoomIndex([np.zeros((3, 32), np.uint8), np.ones((2, 32), np.uint8)])
    assert index.votes(np.zeros((0, 32), np.uint8)).tolist() == [0, 0]
