"""Motion that shows no parallax is named."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import make_pose, so3_exp
from monoloc.recording_check.motion_coverage import cover

TURNS = so3_exp(np.outer(np.linspace(0.0, 2.0, 20), [0.0, 1.0, 0.0]))


def test_walk_is_covered() -> None:
    motion = cover(make_pose(TURNS, np.outer(np.linspace(0.0, 2.0, 20), [1.0, 0.0, 0.0])))
    assert motion.problem is None
    assert (motion.path_m, motion.extent_m, motion.turned_rad) == pytest.approx((2.0, 2.0, 2.0))


def test_turning_and_hovering_are_named() -> None:
    on_the_spot = cover(make_pose(TURNS, np.zeros((20, 3))))
    assert on_the_spot.problem == "the camera only turns on the spot; walk through the room"
    hovering = cover(make_pose(TURNS[:4], np.zeros((4, 3))))
    assert hovering.problem == "the camera hovers in one place; walk through the room"


def test_a_walk_through_more_than_a_building_is_in_another_unit() -> None:
    motion = cover(make_pose(TURNS, np.outer(np.linspace(0.0, 170.0, 20), [1.0, 0.0, 0.0])))
    assert motion.problem == (
        "positions extend over 170 m; if their unit is another one, give --fix-poses millimetres or centimetres"
    )
