"""A camera on its side or upside down, where the build's stood upright."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from monoloc.supervision.turn_check import TurnCheck


def turned(yaw_deg: float = 0.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """A camera in a world whose y axis points down: to the right, then up, then clockwise as it sees."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("YXZ", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_matrix()
    return pose


WALK = np.stack([turned(yaw, pitch) for yaw in (0, 60, 120, 180) for pitch in (-20, 10)])
DOWN = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("pose", "is_turned"),
    [
        (turned(90), False),
        (turned(-45, 30, 50), False),
        (turned(10, -20, 70), True),
        (turned(200, 30, -90), True),
        (turned(0, 0, 180), True),
        (turned(0, 75, 180), False),  # looks up
    ],
)
def test_camera_on_its_side_is_told(pose: np.ndarray, is_turned: bool) -> None:
    assert TurnCheck(WALK, DOWN).is_turned(pose) == is_turned


@pytest.mark.parametrize("roll_deg", [90.0, 180.0])
def test_nothing_is_said_where_the_build_did_not_stand_upright(roll_deg: float) -> None:
    for walk in (WALK @ turned(0, 0, roll_deg), np.stack([turned(yaw, -90) for yaw in range(0, 360, 30)]), WALK[:0]):
        assert not any(TurnCheck(walk, DOWN).is_turned(turned(0, 0, roll)) for roll in (0, 90, 180))


def test_nothing_is_said_where_gravity_is_not_known() -> None:
    assert not TurnCheck(WALK, None).is_turned(turned(0, 0, 180))
