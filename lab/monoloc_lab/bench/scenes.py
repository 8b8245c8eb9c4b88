"""Inputs of the measurements: a cloud of a room, a building of many rooms, and a scan with particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, make_pose, se3_exp
from monoloc.map.mixture import GaussianMixture

_ROOM_M = np.array([4.5, 2.5, 5.0])  # width, height, depth of the synthetic room
_FURNITURE = 14
_SURFACE_SD_M = 0.01
_RANGE_M = 4.0
_HALF_VIEW = np.cos(np.deg2rad(35.0))
# Spread of the particles at the start of a run, the widest while the camera is not lost.
_POSITION_SD_M, _ROTATION_SD, _LOG_SCALE_SD = 0.1, np.deg2rad(3.0), 0.05


def synthetic_cloud(count: int, rng: np.random.Generator) -> FloatArray:
    """Points on the walls of a room and on boxes in it, (count, 3), world frame, metres."""
    sizes = rng.uniform([0.3, 0.3, 0.3], [1.2, 1.5, 1.2], (_FURNITURE, 3))
    corners = rng.uniform(0.0, 1.0, (_FURNITURE, 3)) * (_ROOM_M - sizes)
    lower = np.concatenate([np.zeros((1, 3)), corners])
    edges = np.concatenate([_ROOM_M[None], sizes])
    areas = edges[:, [1, 2, 0]] * edges[:, [2, 0, 1]]  # of the faces across x, y, z
    face = rng.choice(areas.size, size=count, p=areas.ravel() / areas.sum())
    box, axis = np.divmod(face, 3)
    place = rng.uniform(0.0, 1.0, (count, 3))
    place[np.arange(count), axis] = rng.integers(0, 2, count)
    return np.asarray(lower[box] + place * edges[box] + rng.normal(0.0, _SURFACE_SD_M, (count, 3)))


def copies_m(room: GaussianMixture, rooms: int) -> FloatArray:
    """Shifts of copies of a room that stand wall to wall in a square, (rooms, 3); the first is the room itself."""
    side = int(np.ceil(np.sqrt(rooms)))
    lower, upper = room.bounds_m()
    number = np.arange(rooms)
    return np.stack([number % side, np.zeros_like(number), number // side], axis=1) * (upper - lower)


def building(room: GaussianMixture, components: int, rng: np.random.Generator) -> GaussianMixture:
    """A building of slightly different copies of a room, wall to wall, with at least ``components`` components."""
    rooms = -(-components // len(room))
    number = np.repeat(np.arange(rooms), len(room))
    offset = copies_m(room, rooms)[number]
    jitter = rng.normal(0.0, 0.02, offset.shape) * (number > 0)[:, None]  # the first copy is the room itself
    return GaussianMixture(
        np.tile(room.weights, rooms) / rooms,
        np.tile(room.means, (rooms, 1)) + offset + jitter,
        np.tile(room.covariances, (rooms, 1, 1)),
    )


@dataclass(frozen=True)
class Weighing:
    """Input of one call of the weighing kernel.

    Attributes:
        poses: ``T_world_camera`` of the particles, (N, 4, 4).
        log_scales: of the particles, (N,).
        scan: (P, 3) float32, camera frame, metres.
        points_world: (N * P, 3) the scan in the world frame, for every particle.
    """

    poses: FloatArray
    log_scales: FloatArray
    scan: NDArray[np.float32]
    points_world: FloatArray


def weighing(cloud: FloatArray, particles: int, points: int, rng: np.random.Generator) -> Weighing:
    """A scan of ``points`` points from the centre of a cloud, and particles around its pose."""
    middle = np.median(cloud, axis=0)
    offset = cloud - middle
    distance = np.linalg.norm(offset, axis=1)
    forward = offset[np.argmin(np.abs(distance - np.median(distance)))]
    T_world_camera = make_pose(_looking(forward), middle)
    seen = (distance < _RANGE_M) & (offset @ forward > _HALF_VIEW * distance * np.linalg.norm(forward))
    chosen = rng.choice(np.flatnonzero(seen), points, replace=int(seen.sum()) < points)
    scan = offset[chosen] @ T_world_camera[:3, :3]
    twists = rng.standard_normal((particles, 6)) * np.repeat([_POSITION_SD_M, _ROTATION_SD], 3)
    poses = T_world_camera @ se3_exp(twists)
    log_scales = rng.normal(0.0, _LOG_SCALE_SD, particles)
    scaled = np.exp(log_scales)[:, None, None] * scan
    points_world = np.einsum("nij,npj->npi", poses[:, :3, :3], scaled) + poses[:, None, :3, 3]
    return Weighing(poses, log_scales, scan.astype(np.float32), points_world.reshape(-1, 3))


def near_surface(cloud: FloatArray, within_m: float, rng: np.random.Generator) -> FloatArray:
    """The points of a cloud, and the same points displaced by up to ``within_m``."""
    directions = rng.normal(size=cloud.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return np.concatenate([cloud, cloud + directions * rng.uniform(0.0, within_m, (len(cloud), 1))])


def _looking(forward: FloatArray) -> FloatArray:
    """World axes of a camera, (3, 3), with z along ``forward``."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
