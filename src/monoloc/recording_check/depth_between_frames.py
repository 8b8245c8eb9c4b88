"""Whether depth images agree with each other where the poses let two of them see the same surfaces.

Corners of neighbouring frames tell little of it: their motion is mostly that of the camera's rotation.
"""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray, invert, pose_distance_m, rotation_angle, transform
from monoloc.io.recording import Recording, evenly_spaced, scale_sd_of

_PAIRS, _LEAST_PAIRS = 16, 6
# At most, so that the second frame sees most of what the first one sees.
_TURNED_RAD, _MOVED_M = np.deg2rad(10.0), 0.25
_STRIDE, _LEAST_POINTS = 8, 100
# Median over pairs of the relative difference of depth; noise has no sign, and cancels in a pair. Right recordings
# gave 0.001 to 0.008 (RedKitchen, the desk, parts of both), depth of one frame for all or of one value 0.02 to 0.12,
# images that are each stretched to the same range 0.03 to 0.13, inverse depth 0.06 to 0.12, and poses that drift by
# 60 cm 0.002 to 0.05.
_DIFFERENT = 0.03

CHECK_DEPTH = (
    "check that each depth image is of its own frame, that all are in one unit, and that the poses do not drift"
)


def find_disagreement(recording: Recording) -> str | None:
    """What is found of depth that disagrees between frames, for a message; None if it agrees, or too little is seen.

    Raises:
        DataError: a frame cannot be read.
    """
    if recording.poses is None or not recording.has_depth or scale_sd_of(recording) is not None:
        return None
    differences = []
    for first in evenly_spaced(len(recording), _PAIRS).tolist():
        second = _partner(recording.poses, first)
        difference = None if second == first else _difference(recording, recording.poses, first, second)
        if difference is not None:
            differences.append(abs(difference))
    if len(differences) < _LEAST_PAIRS or np.median(differences) < _DIFFERENT:
        return None
    by = f"{np.median(differences):.0%} nearer or farther"
    return (
        f"by the poses, what two frames see is {by} in the depth of one than of the other ({len(differences)} pairs)"
    )


def _partner(poses: FloatArray, first: int) -> int:
    """The frame that is farthest from another one and sees most of the same, before the camera looks elsewhere.

    Poses drift between one visit and the next: by 2 cm, which is 4 % of the depth of a desk.
    """
    angles = rotation_angle(poses[:, :3, :3].transpose(0, 2, 1) @ poses[first, :3, :3])
    distances = np.linalg.norm(poses[:, :3, 3] - poses[first, :3, 3], axis=1)
    elsewhere = np.flatnonzero((angles >= _TURNED_RAD) | (distances >= _MOVED_M))
    begin = elsewhere[elsewhere < first].max(initial=-1) + 1
    end = elsewhere[elsewhere > first].min(initial=len(poses))
    return int(begin + np.argmax(pose_distance_m(poses[first], poses[begin:end])))


def _difference(recording: Recording, poses: FloatArray, first: int, second: int) -> float | None:
    """Median of the logarithm of depth measured in the second frame over that predicted from the first one."""
    camera = recording.camera
    depth = recording.depth(first)[::_STRIDE, ::_STRIDE].reshape(-1)
    rays = camera.pixel_rays()[::_STRIDE, ::_STRIDE].reshape(-1, 3)
    points = transform(invert(poses[second]) @ poses[first], rays[depth > 0.0] * depth[depth > 0.0, None])
    seen, pixels = camera.in_view(points)
    columns, rows = np.clip(np.round(pixels), 0, [camera.width - 1, camera.height - 1]).astype(np.int64).T
    measured = recording.depth(second)[rows, columns]
    known = measured > 0.0
    if known.sum() < _LEAST_POINTS:
        return None
    return float(np.median(np.log(measured[known] / points[seen[known], 2])))
