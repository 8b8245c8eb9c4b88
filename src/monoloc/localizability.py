"""From which places of a room, and in which directions, one image would be enough to find a lost camera.

Landmarks are recognised near the viewpoints from which the build saw them. How many an image would show is predicted
from the bundle alone, so a pilot can see before a flight where monoloc will know its pose, and what to record better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.bundle import Bundle
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray, invert, make_pose
from monoloc.landmarks.expected_landmarks import ExpectedLandmarks
from monoloc.level_map import T_map_world, level_cells
from monoloc.map.occupancy import FREE
from monoloc.progress import Progress

HEADINGS = 12
"""Directions in which the camera looks from each place, evenly around the vertical."""

_LIKELY = 0.5  # probability from which a view is counted as one that finds the camera
# One image finds a lost camera with a probability that is logistic in the logarithm of the expected number of
# landmarks: half at this number, and growing with this power of it.
_HALF_FOUND, _POWER = 40.0, 2.5


@dataclass(frozen=True)
class Localizability:
    """Views of a level flight through the free space of a room at one height.

    Attributes:
        positions: of the N places, (N, 3), metres, in ROS's frame ``map``.
        headings_rad: (H,), from the x axis of ``map`` counterclockwise.
        landmarks: expected number of landmarks in each view, (N, H).
        cell_m: distance between neighbouring places.
        height_m: of all places, along z of ``map``.
        pitch_rad: of the camera's optical axis above the horizon.
    """

    positions: FloatArray
    headings_rad: FloatArray
    landmarks: FloatArray
    cell_m: float
    height_m: float
    pitch_rad: float

    @property
    def probability(self) -> FloatArray:
        """That one image finds a lost camera, (N, H)."""
        return found_probability(self.landmarks)

    def figures(self) -> dict[str, object]:
        """What the views have in common: see the command-line reference."""
        probability = self.probability
        return {
            "height_m": self.height_m,
            "pitch_deg": float(np.degrees(self.pitch_rad)),
            "cell_m": self.cell_m,
            "places": len(self.positions),
            "directions": len(self.headings_rad),
            "found_share": float(probability.mean()),
            "places_found_share": float(np.mean(probability.max(axis=1) >= _LIKELY)),
            "places_found_all_around_share": float(np.mean(probability.min(axis=1) >= _LIKELY)),
            "landmarks_median": float(np.median(self.landmarks)),
            "frame": "map",
        }


def found_probability(landmarks: FloatArray) -> FloatArray:
    """That one image finds a lost camera, by the expected number of landmarks in it, any shape."""
    odds = (landmarks / _HALF_FOUND) ** _POWER
    return np.asarray(odds / (1.0 + odds))


def localizability(
    bundle: Bundle, name: str, cell_m: float, height_m: float | None, pitch_rad: float | None, progress: Progress
) -> Localizability:
    """Predict the landmarks in views from the free space of a room.

    Args:
        bundle: the room.
        name: of the bundle, for messages.
        cell_m: distance between neighbouring places.
        height_m: z in the frame ``map``; None for the median of the build's cameras.
        pitch_rad: of the optical axis above the horizon; None for the median of the build's cameras.

    Raises:
        SettingError: as :func:`monoloc.level_map.level_cells`, or the cameras saw no free space at that height.
        DataError: the bundle has no landmarks, or does not keep which views found them.
    """
    views = bundle.landmarks.views
    if views is None or len(views.poses) == 0:
        problem = "keeps no landmarks, or not where they were seen from"
        raise DataError(name, problem, "build it again, with landmarks")
    cells = level_cells(bundle, cell_m, height_m)
    positions = cells.centres(FREE)
    if len(positions) == 0:
        problem = f"is {cells.height_m:.2f}, where the build's cameras saw no free space"
        raise SettingError("height_m", problem, "give another height")
    T = T_map_world(bundle)
    if pitch_rad is None:
        pitch_rad = float(np.median(np.arcsin(np.clip((T @ views.poses)[:, 2, 2], -1.0, 1.0))))
    headings_rad = 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
    rotations = level_rotations(headings_rad, pitch_rad)
    expected = ExpectedLandmarks(bundle.landmarks.points, views, bundle.camera)
    T_world_map, landmarks = invert(T), np.empty((len(positions), HEADINGS))
    with progress.task("places", len(positions)) as step:
        for index, position in enumerate(positions):
            poses = [T_world_map @ make_pose(rotation, position) for rotation in rotations]
            rates = expected.rates(poses[0][:3, 3])
            landmarks[index] = [expected.count(pose, bundle.camera, rates) for pose in poses]
            step(index + 1)
    return Localizability(positions, headings_rad, landmarks, cell_m, cells.height_m, pitch_rad)


def level_rotations(headings_rad: FloatArray, pitch_rad: float) -> FloatArray:
    """``R_map_camera`` (H, 3, 3) of cameras without roll, whose z axis is up by a pitch from each heading (H,)."""
    cos, sin, level = np.cos(headings_rad), np.sin(headings_rad), np.zeros_like(headings_rad)
    forward = np.stack(
        [cos * np.cos(pitch_rad), sin * np.cos(pitch_rad), np.full_like(cos, np.sin(pitch_rad))], axis=1
    )
    right = np.stack([sin, -cos, level], axis=1)
    return np.stack([right, np.cross(forward, right), forward], axis=2)
