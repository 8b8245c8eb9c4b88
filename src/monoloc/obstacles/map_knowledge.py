"""Map and live depth joined: what the map knows, what is new, what is gone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, invert, transform
from monoloc.map.occupancy import OCCUPIED, fitting_voxel_m, surface_voxels
from monoloc.obstacles.local_occupancy import Surroundings
from monoloc.obstacles.sectors import HALF_HEIGHT_M, MOST_M, SECTORS, sector_of

_VOXEL_M = 0.05  # of the map; more in one of more than 4000 m^3
_FAR_M = 1.5 * MOST_M  # up to which a direction with mapped surface beyond the reach is known as free
_SURE_SD = 2.0  # standard deviations by which live depth and map differ


@dataclass(frozen=True)
class Knowledge(Surroundings):
    """Surroundings of map and live depth together: ``distances_m`` is the nearest of both.

    Attributes:
        live_m: nearest of live depth alone, (72,).
        mapped_m: nearest of the map alone, (72,).
        is_new: (72,) whether live depth sees something nearer than the map, beyond two standard deviations.
        is_gone: (72,) whether live depth sees farther than the map, beyond the same. ``distances_m`` is the map's
            there all the same: depth that misses something looks so too.
    """

    live_m: FloatArray
    mapped_m: FloatArray
    is_new: NDArray[np.bool_]
    is_gone: NDArray[np.bool_]


class MapKnowledge:
    """A bundle's map as obstacles around a vehicle, in all directions, also where the camera does not look.

    Args:
        bundle: of the room. The map in metres is used, not the one that is bent to the depth network.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._voxel_m = fitting_voxel_m(bundle.original, _VOXEL_M)
        self._points = surface_voxels(bundle.original, self._voxel_m).centres(OCCUPIED)

    def distances_m(self, T_world_level: FloatArray) -> FloatArray:
        """Nearest mapped obstacle in each sector, (72,), of a vehicle whose level frame is at the pose (4, 4).

        It is infinite where the map ends between 5 m and half as much again, and NaN where it has nothing.
        """
        points = transform(invert(T_world_level), self._points)
        ranges_m = np.hypot(points[:, 0], points[:, 1])
        is_near = (np.abs(points[:, 2]) < HALF_HEIGHT_M) & (ranges_m < _FAR_M)
        points, ranges_m = points[is_near], ranges_m[is_near]
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        half_rad = np.arctan2(0.5 * self._voxel_m, ranges_m)  # a near voxel fills more than its sector
        nearest_m = np.full(SECTORS, np.inf)
        for turned in (azimuth - half_rad, azimuth, azimuth + half_rad):
            np.minimum.at(nearest_m, sector_of(turned), np.maximum(0.0, ranges_m - 0.5 * self._voxel_m))
        return np.where(np.isinf(nearest_m), np.nan, np.where(nearest_m > MOST_M, np.inf, nearest_m))

    def joined(self, live: Surroundings, T_world_level: FloatArray) -> Knowledge:
        """Map and live depth together.

        Args:
            live: surroundings of the vehicle.
            T_world_level: pose of its level frame, (4, 4): ``estimate.pose @ invert(T_level_camera)``.
        """
        mapped_m = self.distances_m(T_world_level)
        # Where one sees nothing within reach, the comparison is with the end of the reach.
        ours, theirs = np.minimum(live.distances_m, MOST_M), np.minimum(mapped_m, MOST_M)
        margin_m = _SURE_SD * live.error.sd_m(np.fmin(ours, theirs)) + self._voxel_m
        return Knowledge(
            distances_m=np.fmin(live.distances_m, mapped_m),
            log_odds=live.log_odds,
            error=live.error,
            live_m=live.distances_m,
            mapped_m=mapped_m,
            is_new=np.asarray(ours < theirs - margin_m),
            is_gone=np.asarray(ours > theirs + margin_m),
        )
