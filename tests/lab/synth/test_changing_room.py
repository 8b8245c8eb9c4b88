"""Furniture that is moved from day to day, and the round that stays clear of it."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import pose_distance_m
from monoloc_lab.synth.changing_room import Round, changed, flown, plan_round
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.rooms import Room
from refusals import refuses_setting


@pytest.fixture(scope="module")
def room() -> Room:
    return generate_room(2)


@pytest.fixture(scope="module")
def planned(room: Room) -> Round:
    return plan_round(room, 2)


def test_a_day_moves_so_many_objects_and_no_others(room: Room, planned: Round) -> None:
    other, names = changed(room, planned, 3, np.random.default_rng(1))
    assert len(set(names)) == 3
    for before in room.objects:
        after = other[before.name]
        shift_m = float(np.linalg.norm(np.subtract(after.position, before.position)))
        assert 0.25 <= shift_m <= 0.8 if before.name in names else after == before
        if before.name in names:
            assert after.boxes.distance_m(planned.poses[:, :3, 3]).min() >= 0.25
    # The days build on each other.
    assert changed(other, planned, 3, np.random.default_rng(2))[0][names[0]].position != room[names[0]].position


def test_more_moves_than_objects_are_refused(room: Room, planned: Round) -> None:
    refuses_setting(
        lambda: changed(room, planned, 100, np.random.default_rng(1)), "room", "lets only", "another seed"
    )


def test_a_round_is_flown_beside_the_first_and_slowly_off_it(planned: Round) -> None:
    day = flown(planned, np.random.default_rng(3))
    off_m = np.array([pose_distance_m(a, b[None])[0] for a, b in zip(planned.poses, day.poses, strict=True)])
    assert 0.01 < np.median(off_m) < 0.3
    steps_m = np.linalg.norm(np.diff(day.poses[:, :3, 3], axis=0), axis=1)
    assert steps_m.max() < 0.15 and len(day.times_s) == 50
