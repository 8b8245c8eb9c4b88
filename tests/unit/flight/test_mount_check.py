"""Whether a wrong mount shows in the autopilot's attitude."""

from __future__ import annotations

import numpy as np
import pytest

from mavlink_helpers import result_at, step_at
from monoloc.flight.flight_settings import Mount
from monoloc.flight.mount_check import MountCheck
from monoloc.geometry import make_pose, so3_exp
from monoloc.mavlink.autopilot_frames import AutopilotFrames, euler_of
from monoloc.mavlink.autopilot_link import Attitude
from monoloc.supervision.state import State

UP = np.array([0.0, 0.0, -1.0])  # direction of gravity in the map
TRUE = Mount(forward_m=0.1, pitch_deg=15.0, yaw_deg=20.0)
NORTH_RAD = 0.4


def check(stated: Mount, north_off_deg: float = 0.0, state: State = "tracking", frames: int = 12) -> MountCheck:
    """Of a vehicle that turns, with a mount that is TRUE."""
    rng = np.random.default_rng(0)
    true = AutopilotFrames(TRUE.T_body_camera, UP, NORTH_RAD)
    attitudes: dict[float, Attitude] = {}
    made = MountCheck(
        AutopilotFrames(stated.T_body_camera, UP, NORTH_RAD + np.deg2rad(north_off_deg)),
        lambda time_s: attitudes[time_s],
    )
    for index in range(frames):
        pose = make_pose(so3_exp(rng.uniform(-0.5, 0.5, 3)), rng.normal(size=3))
        roll, pitch, yaw = euler_of(true.body_pose(step_at(pose).estimate).T_ned_body[:3, :3]).tolist()
        result = result_at(0.1 * index, step_at(pose, state))
        attitudes[result.frame.captured_s] = Attitude(0.0, roll, pitch, yaw)
        made.take(result)
    return made


def test_right_mount_and_north_differ_by_nothing() -> None:
    errors = check(TRUE).errors
    assert errors is not None
    assert (errors.tilt_deg, errors.pitch_deg, errors.roll_deg, errors.yaw_deg) == pytest.approx((0,) * 4, abs=1e-4)


def test_wrong_pitch_of_the_mount_is_the_tilt() -> None:
    """Of a mount that is said to look 30 degrees lower than it does, but for the part along gravity."""
    errors = check(TRUE.model_copy(update={"pitch_deg": -15.0})).errors
    assert errors is not None and 25.0 < errors.tilt_deg < 30.1


def test_wrong_north_is_the_heading_alone() -> None:
    errors = check(TRUE, north_off_deg=170.0).errors
    assert errors is not None and errors.tilt_deg == pytest.approx(0.0, abs=1e-4)
    assert abs(errors.yaw_deg) == pytest.approx(170.0, abs=0.1)


def test_few_frames_and_frames_that_are_lost_say_nothing() -> None:
    assert check(TRUE, frames=9).errors is None
    assert check(TRUE, state="lost").errors is None
