"""Where a recording's poses jump although its images do not: its tracking was lost there, and began in another world.

Between all other frames such poses agree with the images, so a median over pairs of frames does not show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import invert, rotation_angle, steps_m
from monoloc.io.recording import Recording, Selection
from monoloc.recording_check.correspondences import match_neighbours
from monoloc.recording_check.evidence import Evidence, posed_source

_MOST = 10  # steps that are compared with the images, the largest first
_LEAST_STEP = 0.12  # metres plus radians, from one frame to the next
# Error of the corners by the poses, share of the image's width, where their own motion explains them. In RedKitchen
# and at the desk, steps gave up to 0.025; a jump by 20 cm 0.06 to 0.36, one by 1 m and 40 degrees 0.3 and more.
_CONTRADICTED, _EXPLAINED_PX = 0.05, 2.0


@dataclass(frozen=True)
class PoseJump:
    """A step from one frame to the next that images contradict.

    Attributes:
        before, after: names of the two frames.
        position: of the second one in the recording, as ``--frames`` counts.
        distance_m, angle_rad: of the step by the poses.
    """

    before: str
    after: str
    position: int
    distance_m: float
    angle_rad: float


def find_jumps(evidence: Evidence) -> list[PoseJump]:
    """Steps of a recording's poses that its images contradict, in order of time.

    Raises:
        DataError: a frame cannot be read.
    """
    recording, positions = posed_source(evidence.recording)
    steps = _largest_steps(recording, positions)
    if len(steps) == 0:
        return []
    some = Selection(recording, np.stack([steps, steps + 1], axis=1).ravel())
    pairs = evidence.of(some, match_neighbours(some, range(0, len(some), 2)))
    depth_m = pairs.depth_m(pairs.poses)
    stated_px = pairs.reproject(pairs.relative(pairs.poses), depth_m).shares
    free_px = pairs.reproject(pairs.reproject.free_motion(depth_m), depth_m).shares
    jumps = (stated_px > _CONTRADICTED * pairs.matches.camera.width) & (free_px < _EXPLAINED_PX)
    return [_jump(some, before) for before in pairs.matches.frames[jumps, 0].tolist()]


def _largest_steps(recording: Recording, positions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Frames from which the poses step far, each between two selected frames that are as far from each other."""
    assert recording.poses is not None
    sizes = steps_m(recording.poses)
    far = np.flatnonzero(steps_m(recording.poses[positions]) > _LEAST_STEP)
    spans = [(int(positions[index]), int(positions[index + 1])) for index in far]
    steps = np.array([first + int(np.argmax(sizes[first:last])) for first, last in spans], dtype=np.int64)
    steps = steps[sizes[steps] > _LEAST_STEP]
    return np.sort(steps[np.argsort(-sizes[steps], kind="stable")[:_MOST]])


def _jump(recording: Selection, before: int) -> PoseJump:
    assert recording.poses is not None
    step = invert(recording.poses[before]) @ recording.poses[before + 1]
    return PoseJump(
        recording.frame_names[before],
        recording.frame_names[before + 1],
        int(recording.positions[before + 1]),
        float(np.linalg.norm(step[:3, 3])),
        float(rotation_angle(step[:3, :3])),
    )
