"""How a second recording lies to a bundle's map: one room, one world, one camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, invert, make_pose, nearest_rotation, rotation_angle
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.robust_statistics import robust_sd
from monoloc.supervision.camera_check import tells_aspect, tells_focal

_FRAMES = 24
_SAME_M, _SAME_RAD = 0.15, np.deg2rad(6.0)  # poses of two frames that say the same of the two worlds
LEAST_FOUND = 4
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
    """

    frames: int
    found: int
    agreeing: int | None = None
    T_map_world: FloatArray | None = None
    focal: LensRatio | None = None
    aspect: LensRatio | None = None

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
    agreeing, T_map_world = _common_transform(T_map_camera, recording.poses[[index for index, _ in found]])
    return MapAgreement(len(chosen), len(found), agreeing, T_map_world, focal, aspect)


def _common_transform(T_map_camera: FloatArray, T_world_camera: FloatArray) -> tuple[int, FloatArray]:
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
