"""A room whose furniture is moved from day to day, and the round that a drone flies in it every day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, se3_exp
from monoloc.progress import Progress
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.flights import FlightConfig, plan_flight
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.rooms import Object, Room
from monoloc_lab.synth.sequence import RenderConfig, render_sequence

CAMERA = Camera(160, 120, 136.6, 136.6, 79.5, 59.5)
"""The field of view of NYU Depth v2, at a size that renders quickly."""

RATE_HZ = 5.0
"""Of the frames of a round."""

_SECONDS = 10.0
# Slow, so that neighbouring frames overlap at this rate.
_ROUND = FlightConfig(seconds=_SECONDS, speed=0.5, acceleration=0.8, yaw_rate_deg=30.0, clearance_m=0.45)
_LEAST_SHIFT_M, _MOST_SHIFT_M = 0.25, 0.8
_CLEAR_M = 0.25  # of the round from what was moved
_TRIES = 200
_SAMPLES = 16  # a pixel
_OFF_ROUND = np.repeat([0.04, 0.03], 3)  # standard deviations of a day's round from the first one, m and rad
_OFF_PERIOD_S = 6.0


@dataclass(frozen=True)
class Round:
    """A flight along the round.

    Attributes:
        times_s: (N,).
        poses: ``T_world_camera``, (N, 4, 4).
    """

    times_s: FloatArray
    poses: FloatArray


def plan_round(room: Room, seed: int) -> Round:
    """The round: a slow flight through a room.

    Raises:
        SettingError: the room has no space for it.
    """
    flight = plan_flight(room, _ROUND, seed)
    every = round(len(flight.times_s) / (_SECONDS * RATE_HZ))
    return Round(flight.times_s[::every], flight.camera_poses()[::every])


def flown(planned: Round, rng: np.random.Generator) -> Round:
    """The round as it is flown on some day: some centimetres and degrees off, slowly varying."""
    phase, size = rng.uniform(0.0, 2.0 * np.pi, 6), _OFF_ROUND * rng.normal(size=6)
    wave = np.sin(2.0 * np.pi * planned.times_s[:, None] / _OFF_PERIOD_S + phase)
    return Round(planned.times_s, planned.poses @ se3_exp(np.sqrt(2.0) * size * wave))


def changed(room: Room, planned: Round, count: int, rng: np.random.Generator) -> tuple[Room, list[str]]:
    """The room with some objects moved, out of the way of the round, and their names.

    What hangs on a wall or stands before one is moved along it, the rest anywhere. What carries something stays.

    Raises:
        SettingError: no so many objects can be moved.
    """
    moved: list[str] = []
    for _ in range(_TRIES):
        if len(moved) == count:
            return room, moved
        name = str(rng.choice([thing.name for thing in room.objects if _is_movable(room, thing)]))
        shift = rng.choice([-1.0, 1.0]) * rng.uniform(_LEAST_SHIFT_M, _MOST_SHIFT_M)
        direction = room[name].pose[:3, 0]
        if name in moved:
            continue
        try:
            other = room.move(name, shift * direction)
        except SettingError:
            continue
        if float(other[name].boxes.distance_m(planned.poses[:, :3, 3]).min()) >= _CLEAR_M and _stands(other, name):
            room, moved = other, [*moved, name]
    raise SettingError("room", f"lets only {len(moved)} objects be moved", "choose another seed")


def render_round(room: Room, round_: Round, seed: int, out: Path, progress: Progress) -> Path:
    """Render a flight in even light, with exact depth; frames that an earlier call rendered are reused."""
    moving = velocities(round_.poses, round_.times_s)
    config = RenderConfig(samples=_SAMPLES, is_even=True)
    given = (room, round_.poses, round_.times_s, moving, CAMERA, [LIGHTS["L1"]], config, seed, out, progress)
    return render_sequence(*given)[0]


def _is_movable(room: Room, thing: Object) -> bool:
    return not (thing.fixed or thing.underfoot) and not _carried(room.objects, thing)


def _carried(objects: Sequence[Object], thing: Object) -> list[Object]:
    """What stands on an object."""
    corners = thing.boxes.corners().reshape(-1, 3)
    (left, front), (right, back), top = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0), corners[:, 2].max()
    return [
        other
        for other in objects
        if left <= other.position[0] <= right
        and front <= other.position[1] <= back
        and abs(other.position[2] - top) < 0.02
    ]


def _stands(room: Room, name: str) -> bool:
    """Whether an object stands on the floor, hangs on a wall, or stands on another one."""
    thing = room[name]
    height = thing.position[2]
    hangs = height > 1.2  # what is that high is a picture
    return height < 0.05 or hangs or any(thing in _carried(room.objects, other) for other in room.objects)
