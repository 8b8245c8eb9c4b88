"""Map and live depth joined: what the map knows, what is new, what is gone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.geometry import FloatArray, invert, transform
from monoloc.map.occupancy import OCCUPIED, surface_voxels
from monoloc.obstacles.local_occupancy import Surroundings
from monoloc.obstacles.sectors import HALF_HEIGHT_M, MOST_M, sector_distances_m

_VOXEL_M = 0.05  # of the map; a sector at half a metre still holds enough of them
_SURE_SD = 2.0  # standard deviations by which live depth and map differ


@dataclass(frozen=True)
class Knowledge:
    """Obstacles of map and live depth in each sector.

    Attributes:
        distances_m: nearest of both, (72,), as :func:`~monoloc.obstacles.sectors.sector_distances_m` gives them.
        mapped_m: nearest of the map alone, (72,).
        is_new: (72,) whether live depth sees something nearer than the map, beyond two standard deviations.
        is_gone: (72,) whether live depth sees farther than the map, beyond the same. ``distances_m`` is the map's
            there all the same: depth that missed something looks so too.
    """

    distances_m: FloatArray
    mapped_m: FloatArray
    is_new: NDArray[np.bool_]
    is_gone: NDArray[np.bool_]


class MapKnowledge:
    """A bundle's map as obstacles around a vehicle, in all directions, also where the camera does not look.

    Args:
        bundle: of the room. The map in metres is used, not the one that is bent to the depth network.
    """

    def __init__(self, bundle: Bundle) -> None:
        self._points = surface_voxels(bundle.original, _VOXEL_M).centres(OCCUPIED)

    def distances_m(self, T_world_level: FloatArray) -> FloatArray:
        """Nearest mapped obstacle in each sector, (72,), of a vehicle whose level frame is at the pose (4, 4)."""
        points = transform(invert(T_world_level), self._points)
        near = points[np.hypot(points[:, 0], points[:, 1]) < 1.5 * MOST_M]
        return sector_distances_m(near[np.abs(near[:, 2]) < HALF_HEIGHT_M])

    def joined(self, live: Surroundings, T_world_level: FloatArray) -> Knowledge:
        """Map and live depth together.

        Args:
            live: surroundings of the vehicle.
            T_world_level: pose of its level frame, (4, 4): ``estimate.pose @ invert(T_level_camera)``.
        """
        mapped_m = self.distances_m(T_world_level)
        # Where one sees nothing within reach, the comparison is with the end of the reach.
        ours, theirs = np.minimum(live.distances_m, MOST_M), np.minimum(mapped_m, MOST_M)
        margin_m = _SURE_SD * live.error.sd_m(np.fmin(ours, theirs)) + _VOXEL_M
        return Knowledge(
            distances_m=np.fmin(live.distances_m, mapped_m),
            mapped_m=mapped_m,
            is_new=np.asarray(ours < theirs - margin_m),
            is_gone=np.asarray(ours > theirs + margin_m),
        )
