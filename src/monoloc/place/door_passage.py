"""A recording through a door, frame by frame: where each of both rooms' landmarks sees the camera, and its motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.landmarks.features import KeypointDetector
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.localizer import Localizer
from monoloc.odometry.motion import tracks_translation
from monoloc.particle_filter.motion_model import motion_sd
from monoloc.progress import Progress
from monoloc.start import Start

_INFLATION = 4.0  # of odometry's standard deviations, whose errors are correlated, as in the belief
_LOG_SCALE_SD = 0.05  # of odometry's metres, which come from predicted depth


@dataclass(frozen=True)
class Passage:
    """A recording through a door.

    Attributes:
        a, b: landmark poses of its frames in both rooms, (N,) each; None where a room's landmarks agree on none.
        motions: since the previous frame; None where odometry has none.
        motion_sds: (N, 2) their standard deviations an axis, metres and radians.
    """

    a: list[LandmarkPose | None]
    b: list[LandmarkPose | None]
    motions: list[FloatArray | None]
    motion_sds: FloatArray

    def moved(self, first: int, last: int) -> tuple[FloatArray, tuple[float, float]] | None:
        """``T_first_last``, (4, 4), by odometry, and its standard deviations, metres and radians.

        None where odometry breaks off.
        """
        T_first_last, translation_m = np.eye(4), 0.0
        for motion in self.motions[first + 1 : last + 1]:
            if motion is None:
                return None
            T_first_last = T_first_last @ motion
            translation_m += float(np.linalg.norm(motion[:3, 3]))
        walked = _INFLATION * np.sqrt(np.sum(self.motion_sds[first + 1 : last + 1] ** 2, axis=0))
        sd_m = math.hypot(float(walked[0]), _LOG_SCALE_SD * translation_m, float(walked[1]) * translation_m)
        return T_first_last, (sd_m, float(walked[1]))


def observe_passage(a: Bundle, b: Bundle, recording: Recording, progress: Progress) -> Passage:
    """Localise every frame of a recording by the landmarks of two rooms, and measure its motion.

    Odometry runs in the room that landmarks saw first, whose scan tells its scale.
    """
    detect = KeypointDetector(recording.camera)
    rooms = [OrbLandmarkLocalizer(room.landmarks, recording.camera) for room in (a, b)]
    in_a: list[LandmarkPose | None] = []
    in_b: list[LandmarkPose | None] = []
    with progress.task("door", 2 * len(recording)) as show:
        for index in range(len(recording)):
            seen = detect(recording.color(index))
            in_a.append(rooms[0].relocalize(seen))
            in_b.append(rooms[1].relocalize(seen))
            show(index + 1)
        room, found = (a, in_a) if _first(in_a) <= _first(in_b) else (b, in_b)
        motions, sds = _motions(room, found, recording, lambda done: show(len(recording) + done))
    return Passage(in_a, in_b, motions, sds)


def _first(found: Sequence[LandmarkPose | None]) -> int:
    return next((index for index, pose in enumerate(found) if pose is not None), len(found))


def _motions(
    room: Bundle, found: Sequence[LandmarkPose | None], recording: Recording, show: Callable[[int], None]
) -> tuple[list[FloatArray | None], FloatArray]:
    """Motion between frames, in metres by the depth scale that held where landmarks of the room last saw the camera.

    Args:
        found: landmark poses of the frames in the room; before the first, there is no motion.

    Returns:
        N motions, (4, 4) or None, and their standard deviations (N, 2), metres and radians.
    """
    motions: list[FloatArray | None] = [None] * len(found)
    sds = np.zeros((len(found), 2))
    elapsed_s = np.diff(recording.timestamps_s, prepend=recording.timestamps_s[:1])
    localizer: Localizer | None = None
    log_scale = 0.0
    for index, pose in enumerate(found):
        if localizer is None and pose is not None:
            localizer = Localizer(room, recording.camera, Start(pose.pose))
        if localizer is not None:
            step = localizer.step(recording.color(index), float(elapsed_s[index]))
            log_scale = log_scale if pose is None else step.estimate.log_scale
            if step.motion is not None:
                motions[index] = step.motion.in_metres(log_scale) if tracks_translation(step.motion) else None
                sds[index] = motion_sd(step.motion, float(elapsed_s[index]), 0.0, room.settings.motion_noise)[[0, 3]]
        show(index + 1)
    return motions, sds
