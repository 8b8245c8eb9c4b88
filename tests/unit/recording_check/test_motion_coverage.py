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
    assert cover(make_pose(TURNS, np.zeros((20, 3)))).problem == "the camera only turns on the spot"
    assert cover(make_pose(TURNS[:4], np.zeros((4, 3)))).problem == "the camera hovers in one place"
