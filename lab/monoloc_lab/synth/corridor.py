"""A corridor with equal doors, in which many places look alike, and walks through it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc_lab.synth import fittings
from monoloc_lab.synth.fittings import Opening
from monoloc_lab.synth.furniture import WOODS, Parts, box
from monoloc_lab.synth.materials import Material, lacquer, paint, wood
from monoloc_lab.synth.rooms import Object, Room, Vector

SPACING_M = 3.0
"""Distance between neighbouring doors; the period of every texture divides it."""

WIDTH_M, HEIGHT_M = 2.2, 2.5

_EYE_M, _SPEED, _TURN_RATE = 1.4, 0.7, np.deg2rad(40.0)  # of a walk: metres, m/s, rad/s


def corridor(doors: int) -> Room:
    """A corridor along x, with so many doors in each side wall, all equal; its ends differ from each other.

    Between the ends, a view of a side wall is the same at every door.
    """
    room = Room((doors * SPACING_M, WIDTH_M, HEIGHT_M))

    def put(name: str, parts: Parts, position: Vector, yaw_rad: float = 0.0) -> None:
        nonlocal room
        room = room.add(Object(name, parts, position, float(yaw_rad), fixed=True))

    wall = replace(paint((0.86, 0.83, 0.76), 3), repeat_m=SPACING_M)
    boards = Material("boards", *WOODS[0], repeat_m=SPACING_M / 2.0, roughness=0.4, seed=5)
    skirting, leaf = lacquer((0.5, 0.42, 0.35)), wood(*WOODS[2], seed=3)
    opening = Opening(0.35, 0.9, 0.0, 2.05)
    notice = Material("poster", (0.85, 0.8, 0.3), (0.2, 0.3, 0.6), 0.0, seed=11)
    thick = 0.1
    for number in range(doors):
        middle = (number + 0.5) * SPACING_M
        slab = (SPACING_M, WIDTH_M + 2.0 * fittings.WALL_M, thick)
        put(f"floor {number}", (box(slab, (0.0, 0.0, -thick / 2.0), boards, 0.0),), (middle, WIDTH_M / 2.0, 0.0))
        ceiling = box(slab, (0.0, 0.0, thick / 2.0), paint((0.90, 0.89, 0.87)), 0.0)
        put(f"ceiling {number}", (ceiling,), (middle, WIDTH_M / 2.0, HEIGHT_M))
        for side, yaw, y in (("left", 0.0, WIDTH_M), ("right", np.pi, 0.0)):
            place = (middle, y, 0.0)
            put(f"{side} wall {number}", _segment(opening, wall, skirting), place, yaw)
            put(f"{side} door {number}", fittings.door(opening, leaf), place, yaw)
            x, inner = middle + (-0.8 if side == "left" else 0.8), y + (-0.001 if side == "left" else 0.001)
            put(f"{side} notice {number}", fittings.picture(0.4, 0.55, notice, leaf), (x, inner, 1.5), yaw)
        put(f"lamp {number}", fittings.pendant(0.1, 700.0), (middle, WIDTH_M / 2.0, HEIGHT_M))
    window = Opening(0.0, 1.2, 0.9, 2.1)
    end = paint((0.55, 0.66, 0.72), 8)
    east, west = (doors * SPACING_M, WIDTH_M / 2.0, 0.0), (0.0, WIDTH_M / 2.0, 0.0)
    put("east wall", fittings.wall(WIDTH_M, HEIGHT_M, (window,), end, skirting), east, -np.pi / 2.0)
    put("window", fittings.window(window, 2, 600.0, 21), east, -np.pi / 2.0)
    put("west wall", fittings.wall(WIDTH_M, HEIGHT_M, (), paint((0.62, 0.45, 0.36), 9), skirting), west, np.pi / 2.0)
    picture = Material("landscape", (0.6, 0.5, 0.3), (0.2, 0.35, 0.5), 0.0, seed=31)
    put("picture", fittings.picture(1.1, 0.8, picture, leaf), (0.001, WIDTH_M / 2.0, 1.5), np.pi / 2.0)
    return room


def _segment(opening: Opening, surface: Material, skirting: Material) -> Parts:
    """One period of a side wall."""
    # A wall reaches around the corners of a room, here into its neighbours.
    return fittings.wall(SPACING_M - 2.0 * fittings.WALL_M, HEIGHT_M, (opening,), surface, skirting)


def mapping_walk(doors: int) -> tuple[FloatArray, FloatArray]:
    """A walk to the east end along the left wall, and back along the right one, as :func:`walk`."""
    length_m = doors * SPACING_M
    places = np.array([0.8, length_m - 0.9, length_m - 1.5, length_m - 1.5, 0.9, 1.5, 1.5])
    return walk(places, np.deg2rad([75.0, 75.0, 0.0, -80.0, -80.0, -180.0, -180.0]), 3.0)


def door_walk(doors: int, door: int) -> tuple[FloatArray, FloatArray]:
    """A walk past the doors, which it faces, from one of them (0 is at the west) to the east end, as :func:`walk`."""
    length_m, start_m = doors * SPACING_M, (door + 0.5) * SPACING_M
    places = np.array([start_m - 0.6, start_m + 0.4, length_m - 2.5, length_m - 2.0, length_m - 1.5])
    return walk(places, np.deg2rad([90.0, 90.0, 90.0, 30.0, 10.0]), 5.0)


def walk(places: FloatArray, yaws_rad: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Poses of a camera that goes from place to place.

    Args:
        places: (P,) x of the places, metres; the camera stays in the middle of the corridor.
        yaws_rad: (P,) directions of view there, 0 along x, positive to the left.
        rate_hz: of the frames.

    Returns:
        Times, (N,) s, and ``T_world_camera``, (N, 4, 4).
    """
    durations = np.maximum(np.abs(np.diff(places)) / _SPEED, np.abs(np.diff(yaws_rad)) / _TURN_RATE)
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    times = np.arange(int(knots[-1] * rate_hz) + 1) / rate_hz
    x, yaw = np.interp(times, knots, places), np.interp(times, knots, yaws_rad)
    positions = np.stack([x, np.full_like(x, WIDTH_M / 2.0), np.full_like(x, _EYE_M)], axis=1)
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x
    turns = so3_exp(np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], axis=1))
    return times, make_pose(turns @ level, positions)
