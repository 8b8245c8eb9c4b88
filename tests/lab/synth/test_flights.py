"""Flights: within their limits, clear of surfaces, repeatable."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.errors import SettingError
from monoloc.geometry import is_rigid
from monoloc_lab.synth.flights import CAMERA_RATE_HZ, Flight, FlightConfig, plan_flight
from monoloc_lab.synth.furniture import table
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.materials import BLACK_PLASTIC
from monoloc_lab.synth.rooms import Object, Room

TIMES_S = np.arange(0.0, 8.0, 0.005)
CONFIG = FlightConfig(seconds=8.0)


@pytest.fixture(scope="module")
def room() -> Room:
    return generate_room(1)


@pytest.fixture(scope="module")
def flight(room: Room) -> Flight:
    return plan_flight(room, CONFIG, 0)


def test_flight_stays_within_its_limits(flight: Flight) -> None:
    velocity, acceleration = flight.path(TIMES_S, 1), flight.path(TIMES_S, 2)[:, :3]
    slack = 1.001  # between the times that the planner checks
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= CONFIG.speed * slack
    assert np.linalg.norm(acceleration, axis=1).max() <= CONFIG.acceleration * slack
    assert np.abs(velocity[:, 3]).max() <= np.deg2rad(CONFIG.yaw_rate_deg) * slack
    tilt_rad = np.arccos(np.clip(flight.body_poses(TIMES_S)[:, 2, 2], -1.0, 1.0))
    assert tilt_rad.max() <= np.deg2rad(CONFIG.tilt_deg) * slack


@pytest.mark.slow
def test_flight_uses_its_limits(room: Room) -> None:
    slow = plan_flight(room, CONFIG.model_copy(update={"speed": 0.3}), 0)
    fast = plan_flight(room, CONFIG.model_copy(update={"speed": 1.2, "yaw_rate_deg": 120.0}), 0)
    speeds = [np.linalg.norm(f.path(f.times_s, 1)[:, :3], axis=1).max() for f in (slow, fast)]
    assert speeds[0] <= 0.3 < 0.5 < speeds[1]


@pytest.mark.parametrize("seed", [1, 2])
def test_flight_is_clear_of_surfaces(room: Room, seed: int) -> None:
    flight = plan_flight(room, CONFIG, seed)
    assert room.clearance_m(flight.path(TIMES_S)[:, :3]).min() > CONFIG.clearance_m - 0.005


@pytest.mark.slow
def test_long_flight_keeps_its_limits_and_is_smooth(room: Room) -> None:
    config = FlightConfig(seconds=90.0)
    flight, times = plan_flight(room, config, 0), np.arange(0.0, 90.0, 0.005)
    assert len(flight.times_s) == 2700 and flight.path.duration_s >= 90.0
    state, velocity, acceleration = (flight.path(times, derivative) for derivative in range(3))
    assert room.clearance_m(state[::4, :3]).min() > config.clearance_m - 0.005
    assert np.linalg.norm(velocity[:, :3], axis=1).max() <= config.speed * 1.001
    assert np.linalg.norm(acceleration[:, :3], axis=1).max() <= config.acceleration * 1.001
    # Position, yaw and their velocities have no jumps.
    np.testing.assert_allclose(np.diff(state, axis=0) / 0.005, velocity[:-1], atol=0.03)
    np.testing.assert_allclose(np.diff(velocity, axis=0) / 0.005, acceleration[:-1], atol=0.15)
    still = np.linalg.norm(velocity[:, :3], axis=1) < 0.01
    assert 0.0 < still.mean() < 0.15


def test_seed_determines_the_flight(room: Room, flight: Flight) -> None:
    again = plan_flight(generate_room(1), CONFIG, 0)
    assert again.camera_poses().tobytes() == flight.camera_poses().tobytes()
    assert plan_flight(room, CONFIG, 7).camera_poses().tobytes() != flight.camera_poses().tobytes()


def test_camera_looks_along_the_yaw_and_slightly_down(flight: Flight) -> None:
    poses = flight.camera_poses()
    assert poses.shape == (int(CONFIG.seconds * CAMERA_RATE_HZ), 4, 4) and np.all(is_rigid(poses))
    np.testing.assert_allclose(poses[:, :3, 3], flight.path(flight.times_s)[:, :3], atol=1e-12)
    forward, down = poses[:, :3, 2], poses[:, :3, 1]
    yaw = flight.path(flight.times_s)[:, 3]
    horizontal = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    assert np.all(np.sum(forward[:, :2] * horizontal, axis=1) > 0.9)
    assert np.all(down[:, 2] < -0.9)
    pitch = np.rad2deg(np.arcsin(-forward[:, 2]))
    assert np.abs(pitch - CONFIG.look_down_deg).max() < CONFIG.tilt_deg


def test_room_without_space_is_refused() -> None:
    block = Object("block", table(3.6, 3.6, 2.3, BLACK_PLASTIC, BLACK_PLASTIC), (2.0, 2.0, 0.0))
    room = Room((4.0, 4.0, 2.5)).add(block)
    with pytest.raises(SettingError, match="clearance_m: leaves no path through this room; choose a smaller one"):
        plan_flight(room, FlightConfig(low_m=2.0, high_m=2.4, seconds=2.0), 0)
