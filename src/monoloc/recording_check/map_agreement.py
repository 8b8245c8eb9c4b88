"""How a second recording lies to a bundle's map: one room, one world, one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, rotation_angle
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.io.upright import T_turned_stored
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.recording_check.pose_hypotheses import Reading
from monoloc.recording_check.world_agreement import LEAST_FRAMES, agreeing_reading, common_transform
from monoloc.robust_statistics import robust_sd
from monoloc.supervision.camera_check import tells_aspect, tells_focal

_FRAMES = 24
LEAST_FOUND = LEAST_FRAMES
"""Number of frames in which landmarks must be found."""


@dataclass(frozen=True)
class LensRatio:
    """A true over a stated property of the lens, and the standard deviation of its logarithm."""

    value: float
    log_sd: float

    @classmethod
    def of(cls, logarithms: list[float]) -> LensRatio | None:
        """Their median, as a ratio; None if too few frames determine it."""
        if len(logarithms) < LEAST_FOUND:
            return None
        return cls(float(np.exp(np.median(logarithms))), robust_sd(np.array(logarithms)) / math.sqrt(len(logarithms)))


@dataclass(frozen=True)
class MapAgreement:
    """A recording seen with a bundle's landmarks.

    Attributes:
        frames: number of frames that were looked at.
        found: number in which landmarks give a pose.
        agreeing: number of these that agree with one rigid transform between the two worlds; None without poses.
        T_map_world: that transform, (4, 4), from the recording's world to the map's; None if unknown.
        focal: true over stated focal length by the landmarks, relative to the build's; None if unknown.
        aspect: true over stated aspect, the focal length along y over that along x, by the landmarks.
        reading: by which poses that do not agree as stated do; None if there is none.
    """

    frames: int
    found: int
    agreeing: int | None = None
    T_map_world: FloatArray | None = None
    focal: LensRatio | None = None
    aspect: LensRatio | None = None
    reading: Reading | None = None

    @property
    def offset_m(self) -> float | None:
        """Translation between the two worlds."""
        return None if self.T_map_world is None else float(np.linalg.norm(self.T_map_world[:3, 3]))

    @property
    def offset_rad(self) -> float | None:
        """Rotation between the two worlds."""
        return None if self.T_map_world is None else float(rotation_angle(self.T_map_world[:3, :3]))


def compare_with_map(bundle: Bundle, recording: Recording) -> MapAgreement:
    """Find a bundle's landmarks in frames of a recording, without a prior.

    Raises:
        DataError: a frame cannot be read.
    """
    chosen = evenly_spaced(len(recording), _FRAMES)
    localizer = OrbLandmarkLocalizer(bundle.landmarks, recording.camera)
    places = [localizer.relocalize(localizer.detect(recording.color(index))) for index in chosen.tolist()]
    found = [(index, place) for index, place in zip(chosen.tolist(), places, strict=True) if place is not None]
    usual, seen = bundle.integrity.focal_mean, [place for _, place in found]
    focal = LensRatio.of([place.log_focal - usual for place in seen if tells_focal(place)])
    aspect = LensRatio.of([place.log_aspect for place in seen if tells_aspect(place)])
    if recording.poses is None or len(found) < LEAST_FOUND:
        return MapAgreement(len(chosen), len(found), focal=focal, aspect=aspect)
    T_map_camera = np.stack([place.pose for _, place in found])
    T_world_camera = recording.poses[[index for index, _ in found]]
    agreeing, T_map_world = common_transform(T_map_camera, T_world_camera)
    T = T_turned_stored(recording)  # a reading is of the stored poses
    reading = agreeing_reading(T_map_camera @ T, T_world_camera @ T)
    return MapAgreement(len(chosen), len(found), agreeing, T_map_world, focal, aspect, reading)
