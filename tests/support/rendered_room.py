"""A small room to render, with a window behind and two boxes in front of the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc_lab.synth.building import empty_room, make_walls
from monoloc_lab.synth.fittings import Opening
from monoloc_lab.synth.furniture import box
from monoloc_lab.synth.materials import paint
from monoloc_lab.synth.rooms import Object, Room

# Off centre and not square, so errors of half a pixel or of a sign show.
CAMERA = Camera(96, 72, 82.0, 82.0, 45.3, 38.1)


def pose_at(eye: tuple[float, float, float], yaw_deg: float, down_deg: float, roll_deg: float = 0.0) -> FloatArray:
    yaw, down = np.deg2rad(yaw_deg), np.deg2rad(down_deg)
    forward = np.array([np.cos(yaw) * np.cos(down), np.sin(yaw) * np.cos(down), -np.sin(down)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    level = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_pose(level @ so3_exp(np.array([0.0, 0.0, np.deg2rad(roll_deg)])), np.array(eye))


def cube(name: str, size: tuple[float, float, float], place: tuple[float, float], yaw_rad: float = 0.0) -> Object:
    part = box(size, (0.0, 0.0, size[2] / 2.0), paint((0.7, 0.5, 0.3)), 0.0)
    return Object(name, (part,), (*place, 0.0), yaw_rad)


def windowed_room() -> Room:
    size = (3.0, 3.2, 2.4)
    rng = np.random.default_rng(5)
    walls = tuple(
        replace(wall, openings=(Opening(0.0, 1.4, 0.9, 2.2),) if wall.name == "south" else ())
        for wall in make_walls(size, rng)
    )
    bare = empty_room(size, walls, 5, rng)
    return bare.add(cube("cube", (0.5, 0.5, 0.5), (1.5, 1.9), 0.4)).add(cube("post", (0.1, 0.1, 1.9), (0.8, 2.2)))


POSE = pose_at((1.2, 0.5, 1.3), 80.0, 15.0, 6.0)
