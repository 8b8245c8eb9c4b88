"""Quadrotor flights through a room: smooth, within limits, free of collisions, with a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc_lab.synth.minimum_snap import Spline, concatenated, minimum_snap
from monoloc_lab.synth.rooms import Room

GRAVITY = 9.81  # m/s^2
CAMERA_RATE_HZ = 30.0
_TRIES = 400
_IN_ONE_S, _PIECE_S = 30.0, 10.0  # longer flights consist of pieces, because long random paths rarely stay clear
_CHECK_EVERY_M, _CHECK_EVERY_S = 0.05, 0.02
_STRETCH = 1.05  # factor by which durations grow until the limits are met


class FlightConfig(BaseModel):
    """Limits of a flight; the defaults are those of a small indoor drone flown carefully.

    Attributes:
        seconds: duration.
        speed: largest, m/s.
        acceleration: largest, m/s^2.
        tilt_deg: largest angle of the thrust to the vertical.
        yaw_rate_deg: largest, degrees/s.
        clearance_m: smallest distance of the drone's centre from any surface.
        low_m, high_m: range of heights, as far as the clearance allows.
        look_down_deg: downward angle of the camera.
        look_spread_deg: standard deviation of the yaw from the centre of the room.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seconds: float = Field(10.0, gt=0.0, le=600.0)
    speed: float = Field(0.9, gt=0.0)
    acceleration: float = Field(1.5, gt=0.0)
    tilt_deg: float = Field(12.0, gt=0.0, lt=60.0)
    yaw_rate_deg: float = Field(60.0, gt=0.0)
    clearance_m: float = Field(0.3, gt=0.0)
    low_m: float = Field(0.9, gt=0.0)
    high_m: float = Field(1.8, gt=0.0)
    look_down_deg: float = Field(12.0, ge=-45.0, le=80.0)
    look_spread_deg: float = Field(35.0, ge=0.0, le=180.0)


@dataclass(frozen=True)
class Flight:
    """A flight as a function of time.

    Attributes:
        path: spline of x, y, z (world frame, m) and yaw (rad).
        config: its limits.
    """

    path: Spline
    config: FlightConfig

    @property
    def times_s(self) -> FloatArray:
        """Times of the camera frames, (N,)."""
        return np.arange(round(self.config.seconds * CAMERA_RATE_HZ)) / CAMERA_RATE_HZ

    @property
    def T_body_camera(self) -> FloatArray:
        """``T_body_camera``, (4, 4); the body axes are forward, left, up."""
        forward = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        down = so3_exp(np.array([0.0, np.deg2rad(self.config.look_down_deg), 0.0]))
        return make_pose(down @ forward, np.zeros(3))

    def body_poses(self, times_s: FloatArray) -> FloatArray:
        """``T_world_body`` at (N,) times, (N, 4, 4): z axis along the thrust, x axis towards the yaw."""
        state, acceleration = self.path(times_s), self.path(times_s, 2)[:, :3]
        up = acceleration + np.array([0.0, 0.0, GRAVITY])
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        heading = np.stack([np.cos(state[:, 3]), np.sin(state[:, 3]), np.zeros(len(state))], axis=1)
        left = np.cross(up, heading)
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        return make_pose(np.stack([np.cross(left, up), left, up], axis=-1), state[:, :3])

    def camera_poses(self) -> FloatArray:
        """``T_world_camera`` of the camera frames, (N, 4, 4)."""
        return self.body_poses(self.times_s) @ self.T_body_camera


def plan_flight(room: Room, config: FlightConfig, seed: int) -> Flight:
    """Plan a flight through random free positions of a room; the same seed gives the same flight.

    A flight of more than half a minute consists of pieces, and stops for an instant between them.

    Raises:
        SettingError: the room has no space for it.
    """
    rng = np.random.default_rng([seed, 0xF117])
    first_s = config.seconds if config.seconds <= _IN_ONE_S else _PIECE_S
    pieces = [_piece(room, config, first_s, rng, None)]
    while (left_s := config.seconds - sum(piece.duration_s for piece in pieces)) > 0.0:
        end = pieces[-1]([pieces[-1].duration_s])[0]
        pieces.append(_piece(room, config, min(_PIECE_S, left_s), rng, end))
    return Flight(concatenated(pieces), config)


def free_places(room: Room, config: FlightConfig, rng: np.random.Generator, count: int) -> FloatArray:
    """Random positions with enough clearance, (count, 3).

    Raises:
        SettingError: there are none.
    """
    found = np.zeros((0, 3))
    low = np.array([config.clearance_m, config.clearance_m, max(config.clearance_m, config.low_m)])
    high = np.array(room.size) - config.clearance_m
    high[2] = min(high[2], config.high_m)
    if np.any(high <= low):
        raise _no_space()
    for _ in range(_TRIES):
        drawn = rng.uniform(low, high, (4 * count, 3))
        found = np.concatenate([found, drawn[room.clearance_m(drawn) >= config.clearance_m]])
        if len(found) >= count:
            return found[:count]
    raise _no_space()


def _no_space() -> SettingError:
    return SettingError("clearance_m", "leaves no path through this room", "choose a smaller one, or another room")


def _piece(
    room: Room, config: FlightConfig, least_s: float, rng: np.random.Generator, start: FloatArray | None
) -> Spline:
    """A path of at least so many seconds with enough clearance, from a start (x, y, z, yaw) or from anywhere."""
    for _ in range(_TRIES):
        spline = _spline(room, config, least_s, rng, start)
        if spline is not None:
            return spline
    raise _no_space()


def _spline(
    room: Room, config: FlightConfig, least_s: float, rng: np.random.Generator, start: FloatArray | None
) -> Spline | None:
    waypoints = [free_places(room, config, rng, 1)[0] if start is None else start[:3]]
    seconds = 0.0
    durations: list[float] = []
    while seconds < least_s:
        step = _next(room, config, waypoints, rng)
        if step is None:
            return None
        durations.append(max(1.2, 1.6 * float(np.linalg.norm(step - waypoints[-1])) / config.speed))
        waypoints.append(step)
        seconds += durations[-1]
    yaws = _yaws(room, np.stack(waypoints), config, rng, start)
    spline = minimum_snap(np.column_stack([waypoints, yaws]), durations)
    while not _gentle(spline, config):
        spline = spline.slowed(_STRETCH)
    times = np.arange(0.0, spline.duration_s, _CHECK_EVERY_S)
    clear = room.clearance_m(spline(times)[:, :3]) >= config.clearance_m
    return spline if clear.all() else None


def _next(
    room: Room, config: FlightConfig, waypoints: list[FloatArray], rng: np.random.Generator
) -> FloatArray | None:
    """A position that a straight line can reach, not too close to the previous ones."""
    here = waypoints[-1]
    for place in free_places(room, config, rng, 40):
        distance = float(np.linalg.norm(place - here))
        if distance < 0.5:
            continue
        along = np.linspace(0.0, 1.0, max(2, int(distance / _CHECK_EVERY_M)))[:, None]
        if np.all(room.clearance_m(here + along * (place - here)) >= config.clearance_m):
            return np.asarray(place)
    return None


def _yaws(
    room: Room, waypoints: FloatArray, config: FlightConfig, rng: np.random.Generator, start: FloatArray | None
) -> FloatArray:
    """Yaws that look roughly across the centre of the room, with the shorter turn between waypoints."""
    middle = np.array(room.size[:2]) / 2.0
    across = middle - waypoints[:, :2]
    yaws = np.arctan2(across[:, 1], across[:, 0])
    yaws += np.deg2rad(config.look_spread_deg) * rng.uniform(-1.0, 1.0, len(yaws))
    if start is not None:
        yaws[0] = start[3]
    return np.unwrap(yaws)


def _gentle(spline: Spline, config: FlightConfig) -> bool:
    times = np.arange(0.0, spline.duration_s, _CHECK_EVERY_S)
    velocity, acceleration = spline(times, 1), spline(times, 2)[:, :3]
    tilt = np.arctan2(np.linalg.norm(acceleration[:, :2], axis=1), GRAVITY + acceleration[:, 2])
    return bool(
        np.linalg.norm(velocity[:, :3], axis=1).max() <= config.speed
        and np.abs(velocity[:, 3]).max() <= np.deg2rad(config.yaw_rate_deg)
        and np.linalg.norm(acceleration, axis=1).max() <= config.acceleration
        and tilt.max() <= np.deg2rad(config.tilt_deg)
    )
