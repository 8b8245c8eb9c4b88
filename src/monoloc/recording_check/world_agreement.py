"""By which reading a recording's poses agree with those of the same frames in another world, such as a map's."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray, invert, make_pose, nearest_rotation, rotation_angle
from monoloc.recording_check.pose_hypotheses import Reading, readings

LEAST_FRAMES = 4
"""Number of frames, with fewer of which nothing is compared."""

AGREEING_SHARE = 0.7
"""Of the frames, that must agree with one rigid transform."""

_LEFT_SHARE = 0.6  # of frames that agree as stated, at most, with another reading
_SAME_M, _SAME_RAD = 0.15, np.deg2rad(6.0)  # poses of two frames that say the same of the two worlds


def common_transform(T_map_camera: FloatArray, T_world_camera: FloatArray) -> tuple[int, FloatArray]:
    """Number of frames (of N) that agree with the most common ``T_map_world``, and that transform, (4, 4).

    Frames agree if their poses in the map do: a transform's translation depends on how far off the origins are.
    """
    candidates = T_map_camera @ invert(T_world_camera)
    difference = invert(T_map_camera)[None] @ candidates[:, None] @ T_world_camera[None]
    is_near = np.linalg.norm(difference[..., :3, 3], axis=-1) < _SAME_M
    agree = is_near & (rotation_angle(difference[..., :3, :3]) < _SAME_RAD)
    best = agree[int(np.argmax(agree.sum(axis=1)))]
    rotation = nearest_rotation(candidates[best, :3, :3].sum(axis=0))
    shifts = T_map_camera[best, :3, 3] - T_world_camera[best, :3, 3] @ rotation.T
    return int(best.sum()), make_pose(rotation, np.median(shifts, axis=0))


def agreeing_reading(T_map_camera: FloatArray, T_world_camera: FloatArray) -> Reading | None:
    """The first reading of poses (N, 4, 4) that agrees with those in a map; None if they do as stated, or none does.

    Simpler readings come first. Poses that hardly differ from each other agree by any reading, and so as stated.
    """
    count = len(T_map_camera)
    least = AGREEING_SHARE * count
    # Where most frames agree as stated, a few more may agree by another reading by chance.
    if count < LEAST_FRAMES or common_transform(T_map_camera, T_world_camera)[0] > _LEFT_SHARE * count:
        return None
    for reading in sorted(readings(), key=lambda each: len(each.names)):
        converted = reading.convert(T_world_camera)
        # Positions in one place, as metres read as millimetres are, agree with any camera that stands.
        moves = np.ptp(converted[:, :3, 3], axis=0).max() > _SAME_M
        if moves and common_transform(T_map_camera, converted)[0] >= least:
            return reading
    return None
