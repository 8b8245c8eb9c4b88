"""Straight flights towards an obstacle, until the vehicle touches it: what an obstacle detector must stop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, make_pose
from monoloc.progress import Progress
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.flights import FlightConfig, free_places
from monoloc_lab.synth.furniture import a_cloth, a_wood, cabinet, rod
from monoloc_lab.synth.light import Light
from monoloc_lab.synth.rooms import Object, Room
from monoloc_lab.synth.sequence import RenderConfig, render_sequence

OBSTACLE = "new obstacle"
"""Name of the object that is put in the way."""

_TRIES = 2000
_LEAST_M, _MOST_M = 1.4, 2.4  # way to the contact
_STEP_M = 0.02  # in which a contact is looked for
_PLACES = FlightConfig(clearance_m=0.4, low_m=0.9, high_m=1.5)


@dataclass(frozen=True)
class Approach:
    """A straight, level flight at constant speed that ends where the vehicle touches something.

    Attributes:
        room: with the obstacle, if it is a new one.
        is_new: whether the obstacle is not in the room that was mapped.
        poses: ``T_world_camera`` of the frames, (N, 4, 4).
        times_s: (N,).
        contact_m: way from the first frame to the contact.
    """

    room: Room
    is_new: bool
    poses: FloatArray
    times_s: FloatArray
    contact_m: float


def plan_approach(
    room: Room,
    is_new: bool,
    radius_m: float,
    speed_m_s: float,
    rate_hz: float,
    look_down_deg: float,
    rng: np.random.Generator,
) -> Approach:
    """A random approach.

    Args:
        room: that was mapped.
        is_new: whether to put a cabinet or a column in the way; else the room itself is the obstacle.
        radius_m: of the vehicle, whose centre is the camera.
        speed_m_s, rate_hz: of the flight and of its frames.
        look_down_deg: downward angle of the camera.

    Raises:
        SettingError: the room leaves no space for one.
    """
    for _ in range(_TRIES):
        place, yaw = free_places(room, _PLACES, rng, 1)[0], float(rng.uniform(-np.pi, np.pi))
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        made = _with_obstacle(room, place, ahead, rng) if is_new else room
        contact_m = None if made is None else _contact_m(made, place, ahead, radius_m)
        if made is None or contact_m is None or contact_m < _LEAST_M:
            continue
        times_s = np.arange(0.0, contact_m / speed_m_s, 1.0 / rate_hz)
        places = place + (speed_m_s * times_s)[:, None] * ahead
        poses = np.stack([_camera(each, ahead, look_down_deg) for each in places])
        return Approach(made, is_new, poses, times_s, contact_m)
    raise SettingError("room", "leaves no space for an approach", "choose another room")


def render_approach(
    approach: Approach,
    camera: Camera,
    lights: Sequence[Light],
    config: RenderConfig,
    seed: int,
    out: Path,
    progress: Progress,
) -> list[Path]:
    """Render an approach; see :func:`monoloc_lab.synth.sequence.render_sequence`."""
    moving = velocities(approach.poses, approach.times_s)
    return render_sequence(
        approach.room, approach.poses, approach.times_s, moving, camera, lights, config, seed, out, progress
    )


def _camera(place: FloatArray, ahead: FloatArray, look_down_deg: float) -> FloatArray:
    """``T_world_camera`` of a camera that looks ahead and down, (4, 4)."""
    down = np.deg2rad(look_down_deg)
    forward = np.cos(down) * ahead - np.sin(down) * np.array([0.0, 0.0, 1.0])
    right = np.array([ahead[1], -ahead[0], 0.0])
    return make_pose(np.stack([right, np.cross(forward, right), forward], axis=1), place)


def _contact_m(room: Room, place: FloatArray, ahead: FloatArray, radius_m: float) -> float | None:
    """Way until a sphere touches something; None if it is farther than the longest approach."""
    ways_m = np.arange(0.0, _MOST_M, _STEP_M)
    touches = np.flatnonzero(room.clearance_m(place + ways_m[:, None] * ahead) < radius_m)
    return float(ways_m[touches[0]]) if len(touches) else None


def _with_obstacle(room: Room, place: FloatArray, ahead: FloatArray, rng: np.random.Generator) -> Room | None:
    """The room with an obstacle on the floor in the way; None where something stands there already."""
    x, y, _ = place + rng.uniform(_LEAST_M + 0.4, _MOST_M) * ahead
    if rng.random() < 0.5:
        parts = cabinet(0.5, 0.35, 1.7, a_wood(rng), a_wood(rng), 1)
    else:
        parts = (rod(0.35, 1.75, (0.0, 0.0, 0.0), a_cloth(rng)),)
    yaw = float(np.arctan2(ahead[1], ahead[0]) - np.pi / 2.0)
    try:
        return room.add(Object(OBSTACLE, tuple(parts), (float(x), float(y), 0.0), yaw))
    except SettingError:
        return None
