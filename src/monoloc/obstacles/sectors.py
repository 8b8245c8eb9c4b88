"""The nearest obstacle in every direction: 72 sectors of five degrees around the vehicle.

Sector 0 is centred on the heading, and the others follow clockwise as seen from above. A distance is horizontal, from
the vehicle's origin. It is infinite where all that is seen is farther than :data:`MOST_M`, and NaN where too little
is seen to tell: outside the image, or where there is only floor and ceiling.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray

SECTORS: Final = 72
LEAST_M: Final = 0.3
MOST_M: Final = 5.0
"""Distances that are reported; beyond, predicted depth is not reliable, and a sector counts as free."""

HALF_HEIGHT_M: Final = 0.25
"""Above and below the vehicle's origin: what a vehicle that flies level can hit."""

SECTOR_RAD: Final = 2.0 * np.pi / SECTORS
_LEAST_POINTS = 6  # in a sector, that say anything of it
_NEAREST_SHARE, _OUTLIERS = 0.05, 2  # share and least number of a sector's points that are nearer: outliers


def depth_points(depth: DepthPrediction, log_scale: float) -> FloatArray:
    """Points of a depth image in the camera's frame, (N, 3) m.

    Args:
        depth: of the image, metres.
        log_scale: logarithm of the factor that the depth still needs, as
            :attr:`monoloc.particle_filter.estimate.Estimate.log_scale`.
    """
    return np.asarray(np.exp(log_scale) * depth.camera.back_project(depth.depth_m)[depth.depth_m > 0.0])


def sector_of(azimuth_rad: FloatArray) -> NDArray[np.int64]:
    """Sector of directions (...), clockwise from the heading as seen from above."""
    return np.rint(azimuth_rad / SECTOR_RAD).astype(np.int64) % SECTORS


def sector_distances_m(points_level: FloatArray) -> FloatArray:
    """Distance of the nearest obstacle in each sector, (72,), see above.

    The nearest twentieth of a sector's points, and at least two, are taken for outliers.

    Args:
        points_level: (N, 3) m from the vehicle's origin, along axes that are forward along its heading, right, and
            down by gravity.
    """
    points = points_level[np.abs(points_level[:, 2]) < HALF_HEIGHT_M]
    distances_m = np.hypot(points[:, 0], points[:, 1])
    sector = sector_of(np.arctan2(points[:, 1], points[:, 0]))
    order = np.lexsort((distances_m, sector))
    counts = np.bincount(sector, minlength=SECTORS)
    first = np.cumsum(counts) - counts
    nearest = first + np.maximum(_OUTLIERS, np.floor(_NEAREST_SHARE * counts)).astype(np.int64)
    known = np.flatnonzero(counts >= _LEAST_POINTS)
    result = np.full(SECTORS, np.nan)
    result[known] = distances_m[order][nearest[known]]
    result[result > MOST_M] = np.inf
    return result
