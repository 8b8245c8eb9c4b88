"""Approaches end at a contact, and at no earlier one."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc_lab.synth.approaches import OBSTACLE, plan_approach
from monoloc_lab.synth.layout import generate_room

ROOM = generate_room(3)


@pytest.mark.parametrize("is_new", [False, True])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_way_is_straight_clear_and_ends_at_a_contact(is_new: bool, seed: int) -> None:
    approach = plan_approach(ROOM, is_new, 0.25, 0.8, 5.0, 12.0, np.random.default_rng(seed))
    places = approach.poses[:, :3, 3]
    assert (OBSTACLE in approach.room.names) == is_new == approach.is_new
    np.testing.assert_allclose(np.diff(places, axis=0), np.tile(places[1] - places[0], (len(places) - 1, 1)))
    ahead = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])
    assert ahead[2] == pytest.approx(0.0) and approach.poses[0, 2, 2] == pytest.approx(-np.sin(np.deg2rad(12.0)))
    assert np.linalg.norm(places[-1] - places[0]) < approach.contact_m
    assert (
        approach.room.clearance_m(places[0] + np.outer(np.linspace(0.0, approach.contact_m - 0.03, 50), ahead)).min()
        > 0.24
    )
    assert approach.room.clearance_m((places[0] + approach.contact_m * ahead)[None])[0] < 0.25
    if is_new:  # without the obstacle, the way would be free
        assert ROOM.clearance_m((places[0] + approach.contact_m * ahead)[None])[0] > 0.25
