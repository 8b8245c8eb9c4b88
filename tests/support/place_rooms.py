"""Three bundles for tests of places: two of the halves of one room, in worlds of their own, and one of another room.

A camera that turns from the left half of the room to the right one goes through the door between the first two.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.bundle import write_bundle
from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, so3_exp
from monoloc.map.em import fit_mixture
from monoloc.place.place_manifest import Door
from monoloc.progress import NoProgress
from synthetic_room import Room, RoomRecording, make_bundle

LEFT, RIGHT, OTHER = "left", "right", "other"
T_LEFT_RIGHT = se3_exp(np.array([1.5, -0.4, 0.7, 0.1, 0.9, -0.2]))
"""From the world of the right bundle to that of the left one, which is the room's."""

_VIEWS = 11  # of each bundle


def turning(first_deg: float, last_deg: float, count: int) -> FloatArray:
    """Poses of a camera that turns from left to right and sways, in the room's world, (count, 4, 4)."""
    yaw = np.deg2rad(np.linspace(first_deg, last_deg, count))
    turns = so3_exp(np.stack([0.0 * yaw, yaw, 0.0 * yaw], axis=1))
    positions = np.stack([0.3 * np.sin(2.0 * yaw), 0.05 * np.cos(5.0 * yaw), -0.8 + 0.2 * np.sin(3.0 * yaw)], axis=1)
    return make_pose(turns, positions)


def write_rooms(folder: Path, count: int = 3) -> list[Path]:
    """The first of the three bundles, ``left``, ``right`` and ``other``."""
    rooms = (
        (LEFT, Room(), turning(-50.0, 12.0, _VIEWS), np.eye(4)),
        (RIGHT, Room(), turning(-12.0, 50.0, _VIEWS), T_LEFT_RIGHT),
        (OTHER, Room(seed=5), turning(-30.0, 30.0, _VIEWS), np.eye(4)),
    )
    return [_written(folder / f"{name}.monoloc", room, poses, T) for name, room, poses, T in rooms[:count]]


def _written(path: Path, room: Room, poses: FloatArray, T_room_world: FloatArray) -> Path:
    recording = RoomRecording(room, poses)
    cloud = room.cloud(0.1) @ T_room_world[:3, :3] - T_room_world[:3, 3] @ T_room_world[:3, :3]
    recording.poses = invert(T_room_world) @ poses
    mixture = fit_mixture(cloud, 60, np.random.default_rng(0)).mixture
    landmarks, bias, evidence = build_landmarks(recording, recording.depth, NoProgress())
    bundle = make_bundle(mixture, recording, range(_VIEWS))
    settings = bundle.settings.model_copy(update={"landmark_bias": bias, "particles": 200})
    integrity = bundle.integrity.model_copy(update=vars(evidence))
    write_bundle(path, replace(bundle, settings=settings, landmarks=landmarks, integrity=integrity))
    return path


def true_door(sds: tuple[float, float] = (0.02, 0.01)) -> Door:
    """The door between the halves, where the camera turns."""
    return Door.between(LEFT, RIGHT, T_LEFT_RIGHT, sds, np.array([0.0, 0.0, -0.8]), 1.0)
