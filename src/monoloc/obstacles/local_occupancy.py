"""Local occupancy: the space around the vehicle, at its height, by the depth of the last second.

The space is a polar grid of sectors and rings around the vehicle. For each frame of the last second a cell is free if
the frame's nearest obstacle in that direction is farther, and occupied if it is there. The log-odds of the frames add
up (Moravec and Elfes 1985), by as much as in OctoMap (Hornung et al. 2013). So one frame that misses an obstacle does
not open the way, and what has left the image is remembered. An obstacle in the newest frame counts at once, whatever
earlier frames showed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, invert, transform
from monoloc.obstacles.depth_error import DepthError
from monoloc.obstacles.sectors import MOST_M, SECTOR_RAD, SECTORS, depth_points, sector_distances_m, sector_of
from monoloc.particle_filter.estimate import Estimate

WINDOW_S = 1.0
"""For which a frame is remembered."""

RING_M = 0.1
"""Width of a ring of the grid."""

_HIT, _FREE = 0.85, -0.4  # log-odds that a frame adds
_BEHIND_M = 1.5 * RING_M  # behind a frame's obstacle, which it occupies
_BESIDE_M = 1.0  # a sector that a straight way leaves within this distance is beside the vehicle: no camera sees it
_SURE_SD = 2.0  # standard deviations between a distance and its lower bound


@dataclass(frozen=True)
class FreeSpace:
    """How far a vehicle can go in a direction.

    Attributes:
        distance_m: of its origin to where an obstacle, or what is unknown, begins; at most :data:`MOST_M`.
        sd_m: standard deviation of the distance.
    """

    distance_m: float
    sd_m: float

    @property
    def least_m(self) -> float:
        """The distance less two standard deviations: that much is free with 98 % if the stated error holds."""
        return max(0.0, self.distance_m - _SURE_SD * self.sd_m)


@dataclass(frozen=True)
class Surroundings:
    """The space around a vehicle at one time, in its level frame: forward along its heading, right, down.

    Attributes:
        distances_m: of the nearest obstacle in each sector, (72,), as
            :func:`~monoloc.obstacles.sectors.sector_distances_m` gives them.
        log_odds: of each cell that it is occupied, (72, 50) for sectors and rings; 0 where nothing is known.
        error: of the distances.
    """

    distances_m: FloatArray
    log_odds: FloatArray
    error: DepthError

    @property
    def sd_m(self) -> FloatArray:
        """Standard deviation of each distance, (72,); NaN where there is none, infinite where it is free."""
        return self.error.sd_m(self.distances_m)

    def free_ahead(self, half_width_m: float, azimuth_rad: float = 0.0) -> FreeSpace:
        """Free space in a direction.

        None is free if a sector that the way crosses is unknown. Only sectors that it leaves within 1 m may be: a
        camera that looks ahead does not see beside the vehicle.

        Args:
            half_width_m: of the vehicle and what it keeps clear beside it.
            azimuth_rad: direction, clockwise from the heading as seen from above.

        Raises:
            ValueError: either is no number, or the half-width is negative.
        """
        if not (np.isfinite(azimuth_rad) and np.isfinite(half_width_m) and half_width_m >= 0.0):
            got = f"{half_width_m} and {azimuth_rad}"
            raise ValueError(f"half_width_m must be 0 or more and azimuth_rad a number, got {got}")
        sectors = np.flatnonzero(np.isfinite(self.distances_m))
        known_m, turned = self.distances_m[sectors], SECTOR_RAD * sectors - azimuth_rad
        along_m = known_m * np.cos(turned)
        aside_m = known_m * (np.abs(np.sin(turned)) - 0.5 * SECTOR_RAD)  # it is somewhere within its sector
        blocks = (along_m > 0.0) & (aside_m < half_width_m)
        distance_m = float(np.min(along_m[blocks], initial=MOST_M))
        if np.any(np.isnan(self.distances_m) & self._is_crossed(half_width_m, azimuth_rad)):
            distance_m = 0.0
        return FreeSpace(distance_m, float(self.error.sd_m(np.array(distance_m))))

    @staticmethod
    def _is_crossed(half_width_m: float, azimuth_rad: float) -> NDArray[np.bool_]:
        """Sectors, (72,), that a way of this half-width still crosses farther away than beside the vehicle."""
        turned = np.remainder(SECTOR_RAD * np.arange(SECTORS) - azimuth_rad + np.pi, 2.0 * np.pi) - np.pi
        return np.asarray(np.abs(turned) - 0.5 * SECTOR_RAD <= np.arctan2(half_width_m, _BESIDE_M))


@dataclass(frozen=True)
class _Frame:
    captured_s: float
    distances_m: FloatArray
    T_world_level: FloatArray


class LocalOccupancy:
    """Follows the space around a vehicle; call :meth:`update` with every frame, or ten a second.

    Args:
        error: of the distances.
    """

    def __init__(self, error: DepthError) -> None:
        self._error = error
        self._frames: deque[_Frame] = deque()
        azimuth, ranges_m = np.meshgrid(
            SECTOR_RAD * np.arange(SECTORS), RING_M * (np.arange(round(MOST_M / RING_M)) + 0.5), indexing="ij"
        )
        self._ranges_m = ranges_m
        self._cells = np.stack([ranges_m * np.cos(azimuth), ranges_m * np.sin(azimuth), 0.0 * azimuth], axis=-1)

    def clear(self) -> None:
        """Forget all frames: the pose has jumped, so that they are no longer where they were."""
        self._frames.clear()

    def update(
        self, captured_s: float, depth: DepthPrediction, estimate: Estimate, T_level_camera: FloatArray
    ) -> Surroundings:
        """The surroundings after a frame.

        Args:
            captured_s: time of its image; an earlier one than before forgets all.
            depth: of the frame, as :attr:`monoloc.step.Step.depth`.
            estimate: the belief.
            T_level_camera: pose of the camera in the vehicle's level frame, (4, 4), as
                :meth:`monoloc.mavlink.autopilot_frames.AutopilotFrames.T_level_camera` gives it.
        """
        if self._frames and captured_s < self._frames[-1].captured_s:
            self.clear()
        points = transform(T_level_camera, depth_points(depth, estimate.log_scale))
        now = _Frame(captured_s, sector_distances_m(points), estimate.pose @ invert(T_level_camera))
        self._frames.append(now)
        while captured_s - self._frames[0].captured_s > WINDOW_S:
            self._frames.popleft()
        log_odds = np.sum([self._log_odds(frame, now) for frame in self._frames], axis=0)
        is_occupied = log_odds > 0.0
        remembered = np.where(is_occupied.any(axis=1), self._ranges_m[0][is_occupied.argmax(axis=1)], np.nan)
        # A ring's width apart, both are the same obstacle, and the newest distance is the finer one.
        is_nearer = ~(remembered >= now.distances_m - RING_M) & np.isfinite(remembered)
        return Surroundings(np.where(is_nearer, remembered, now.distances_m), log_odds, self._error)

    def _log_odds(self, frame: _Frame, now: _Frame) -> FloatArray:
        """Log-odds that a frame adds to the cells around the newest one, (72, 50)."""
        there = transform(invert(frame.T_world_level) @ now.T_world_level, self._cells.reshape(-1, 3))
        ranges_m = np.hypot(there[:, 0], there[:, 1]).reshape(self._ranges_m.shape)
        nearest_m = frame.distances_m[sector_of(np.arctan2(there[:, 1], there[:, 0]))].reshape(ranges_m.shape)
        # Comparisons with NaN, where the frame saw nothing, are false.
        is_free = ranges_m < np.minimum(nearest_m, MOST_M) - 0.5 * RING_M
        is_hit = ~is_free & (ranges_m < nearest_m + _BEHIND_M) & np.isfinite(nearest_m)
        return _FREE * is_free + _HIT * is_hit
