"""How the map lies to north, from frames whose pose may be used."""

from __future__ import annotations

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.errors import DataError
from monoloc.flight.flight_settings import Mount
from monoloc.flight.north_measurement import NorthMeasurement
from monoloc.geometry import make_pose
from monoloc.mavlink.autopilot_link import Attitude
from monoloc.supervision.state import State
from refusals import refuses

DOWN = np.array([0.0, 0.0, -1.0])
# A camera that looks along the map's x axis, on a vehicle that its compass says heads 30 degrees east of north.
POSE = make_pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.0, 0.0, 1.0])


def measure(state: State, frames: int = 90, has_attitude: bool = True) -> NorthMeasurement:
    attitude = Attitude(0.0, 0.0, 0.0, np.deg2rad(30.0)) if has_attitude else None
    north = NorthMeasurement(Mount().T_body_camera, DOWN, lambda captured_s: attitude)
    for index in range(frames):
        north.take(result_at(0.1 * index, step_at(POSE, state)))
    return north


@pytest.mark.parametrize("state", ["tracking", "map-changed"])
def test_poses_that_may_be_used_tell_the_heading(state: State) -> None:
    north = measure(state)
    assert north.is_done
    assert north.north_deg() == pytest.approx((30.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(("state", "has_attitude"), [("lost", True), ("uncertain", True), ("tracking", False)])
def test_other_frames_tell_nothing(state: State, has_attitude: bool) -> None:
    north = measure(state, has_attitude=has_attitude)
    assert not north.is_done
    refuses(north.north_deg, DataError, "^--align: only 0 frames had a pose and an attitude.*; wait until")
