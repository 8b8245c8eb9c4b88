"""A door, measured: how two rooms' worlds lie to each other, and where the way between them is.

Frames that the landmarks of both rooms localise give ``T_a_b`` at once. Where too few see both, odometry joins the
frames before and after the door.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np

from monoloc.bundle import Bundle
from monoloc.editing.alignment import consensus
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, angle_between, invert, se3_log
from monoloc.io.recording import Recording
from monoloc.place.door_passage import Passage, observe_passage
from monoloc.place.place_manifest import Door
from monoloc.progress import Progress

_LEAST_SD_M, _LEAST_SD_RAD = 0.01, 0.005  # of a door: the landmarks' errors in its frames are not independent
_MOST_SD_M = 0.5  # of a door by odometry: landmarks are not sought farther from where they are expected
_CHAINED_FRAMES = 3  # before the door and after it, that odometry joins
_LEAST_FRAMES = 3  # that must agree, see :func:`monoloc.editing.alignment.consensus`
_REACH_M, _MOST_RADIUS_M = 1.0, 3.0  # of a door, beyond the places where both rooms explain the view
_SAME_WORLD_SDS = (0.02, 0.01)  # metres, radians: of two recordings by one system of poses
_LEAST_COSINE = np.cos(np.deg2rad(15.0))  # of two directions of gravity; floor and walls tell it to a few degrees
_WALK = "record a walk through the door: monoloc place door PLACE A B SOURCE"
_RECORD = "record a slow walk through the door that looks ahead, from well inside one room to well inside the other"


@dataclass(frozen=True)
class MeasuredDoor:
    """A door and how it was measured.

    Attributes:
        door: the result.
        by: landmarks of both rooms in the same frames, odometry between frames of either, or one world, as given.
        frames: that localise the camera in the first room, in the second, and in both.
        agreeing: pairs of poses that agree on the result.
    """

    door: Door
    by: Literal["landmarks", "odometry", "same world"]
    frames: tuple[int, int, int]
    agreeing: int


def measure_door(
    names: tuple[str, str], rooms: tuple[Bundle, Bundle], recording: Recording, progress: Progress
) -> MeasuredDoor:
    """Measure a door by a recording through it.

    Raises:
        DataError: the recording does not show both rooms, its frames contradict each other, or odometry breaks off.
    """
    passage = observe_passage(*rooms, recording, progress)
    counts = _counts(passage)
    for name, count in zip(names, counts, strict=False):
        if count < _LEAST_FRAMES:
            raise DataError(
                recording.name, f"shows room {name} in fewer than {_LEAST_FRAMES} frames ({count})", _RECORD
            )
    in_both = [index for index in range(len(passage.a)) if passage.a[index] and passage.b[index]]
    if len(in_both) >= _LEAST_FRAMES:
        by: Literal["landmarks", "odometry"] = "landmarks"
        there, here = _poses(passage, [(index, index) for index in in_both])
        walked = (0.0, 0.0)
    else:
        by = "odometry"
        there, here, walked = _chained(passage, recording.name)
    agreed = consensus(there, here)
    if agreed is None:
        problem = f"contradicts itself: no half of its {len(there)} pairs of poses agree on how the rooms lie"
        raise DataError(recording.name, problem, _RECORD)
    T_a_b, agreeing = agreed
    sds = _sds(T_a_b, there, here)
    centre_m, radius_m = _centre(passage, T_a_b, recording.name, names)
    sds = float(np.hypot(sds[0], walked[0])), float(np.hypot(sds[1], walked[1]))
    return MeasuredDoor(Door.between(*names, T_a_b, sds, centre_m, radius_m), by, counts, agreeing)


def same_world_door(names: tuple[str, str], rooms: tuple[Bundle, Bundle]) -> MeasuredDoor:
    """A door between rooms whose bundles have one world: between their nearest build poses.

    Raises:
        SettingError: the rooms' build poses are too far apart for a door, or one has none, or their directions of
            gravity are not those of one world.
    """
    for name, room in zip(names, rooms, strict=True):
        if len(room.reference_poses) == 0:
            raise SettingError("--same-world", f"the bundle of room {name} keeps no poses of its build", _WALK)
    down_a, down_b = (room.down for room in rooms)
    if down_a is not None and down_b is not None and float(down_a @ down_b) < _LEAST_COSINE:
        angle_deg = float(np.rad2deg(angle_between(down_a, down_b)))
        problem = f"gravity of rooms {names[0]} and {names[1]} differs by {angle_deg:.0f}°, so they have two worlds"
        raise SettingError("--same-world", problem, _WALK)
    a, b = (room.reference_poses.poses[:, :3, 3] for room in rooms)
    apart_m = np.linalg.norm(a[:, None] - b[None], axis=2)
    first, second = np.unravel_index(int(apart_m.argmin()), apart_m.shape)
    radius_m = 0.5 * float(apart_m[first, second]) + _REACH_M
    if radius_m > _MOST_RADIUS_M:
        problem = f"rooms {names[0]} and {names[1]} were recorded {apart_m.min():.1f} m apart"
        raise SettingError("--same-world", problem, _WALK)
    centre_m = 0.5 * (a[first] + b[second])
    door = Door.between(*names, np.eye(4), _SAME_WORLD_SDS, centre_m, radius_m)
    return MeasuredDoor(door, "same world", (0, 0, 0), 0)


def _counts(passage: Passage) -> tuple[int, int, int]:
    in_a = np.array([pose is not None for pose in passage.a])
    in_b = np.array([pose is not None for pose in passage.b])
    return int(in_a.sum()), int(in_b.sum()), int((in_a & in_b).sum())


def _poses(passage: Passage, pairs: list[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
    """Poses in a of the first frames of pairs, and in b of the second ones, (P, 4, 4) each."""
    there = [pose.pose for first, _ in pairs if (pose := passage.a[first]) is not None]
    here = [pose.pose for _, second in pairs if (pose := passage.b[second]) is not None]
    return np.stack(there), np.stack(here)


def _chained(passage: Passage, name: str) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
    """Poses of the frames after the door, by odometry in a and by landmarks in b, and odometry's deviations.

    Raises:
        DataError: no frame before the door shows one room alone, or odometry breaks off at it or drifts too far.
    """
    in_a = [index for index, pose in enumerate(passage.a) if pose is not None]
    in_b = [index for index, pose in enumerate(passage.b) if pose is not None]
    from_a = in_a[0] < in_b[0]
    before, after = (in_a, in_b) if from_a else (in_b, in_a)
    before = [index for index in before if index < after[0]][-_CHAINED_FRAMES:]
    after = after[:_CHAINED_FRAMES]
    if not before:
        problem = f"shows both rooms in fewer than {_LEAST_FRAMES} frames, and begins in both"
        raise DataError(name, problem, _RECORD)
    there, here, sds = [], [], []
    for first, last in itertools.product(before, after):
        moved = passage.moved(first, last)
        if moved is None or moved[1][0] > _MOST_SD_M:
            problem = f"shows both rooms in fewer than {_LEAST_FRAMES} frames, and odometry does not join them"
            raise DataError(name, problem, _RECORD)
        T_first_last, sd = moved
        pairs = [(first, last)] if from_a else [(last, first)]
        poses_a, poses_b = _poses(passage, pairs)
        there.append(poses_a[0] @ T_first_last if from_a else poses_a[0])
        here.append(poses_b[0] if from_a else poses_b[0] @ T_first_last)
        sds.append(sd)
    return np.stack(there), np.stack(here), (max(sd[0] for sd in sds), max(sd[1] for sd in sds))


def _sds(T_a_b: FloatArray, there: FloatArray, here: FloatArray) -> tuple[float, float]:
    """Standard deviations an axis, metres and radians, of the same cameras' poses in a (P, 4, 4) and in b.

    They are those of half of the pairs, so that wrong ones do not count.
    """
    twists = se3_log(invert(T_a_b @ here) @ there)
    squares = np.stack([(twists[:, :3] ** 2).mean(axis=1), (twists[:, 3:] ** 2).mean(axis=1)])
    position, rotation = np.sqrt(np.median(squares, axis=1))
    return max(_LEAST_SD_M, float(position)), max(_LEAST_SD_RAD, float(rotation))


def _centre(passage: Passage, T_a_b: FloatArray, name: str, names: tuple[str, str]) -> tuple[FloatArray, float]:
    """Where in a one room begins to explain the views better than the other: the middle, (3,), and the radius.

    The radius reaches all places where both rooms explain the view, because the belief may go over at any of them.

    Raises:
        DataError: that never happens, so that the recording does not go from one room to the other.
    """
    positions, is_b, is_both = [], [], []
    for in_a, in_b in zip(passage.a, passage.b, strict=True):
        in_a_count, in_b_count = (0 if pose is None else len(pose.points) for pose in (in_a, in_b))
        pose = in_a.pose if in_a is not None else T_a_b @ in_b.pose if in_b is not None else None
        if pose is not None:
            positions.append(pose[:3, 3])
            is_b.append(in_b_count > in_a_count)
            is_both.append(min(in_a_count, in_b_count) > 0)
    changes = np.flatnonzero(np.diff(np.array(is_b, dtype=np.int64)))
    if not len(changes):
        raise DataError(name, f"does not go from room {names[0]} to room {names[1]}", _RECORD)
    places = np.stack(positions)
    around = 0.5 * (places[changes] + places[changes + 1])
    centre_m = around.mean(axis=0)
    reached = np.concatenate([around, places[np.array(is_both)]])
    reach_m = float(np.linalg.norm(reached - centre_m, axis=1).max())
    return centre_m, min(_MOST_RADIUS_M, reach_m + _REACH_M)
