"""Distances to obstacles around the vehicle, from one depth image: 72 sectors of five degrees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray, transform
from monoloc.mavlink.messages import UNKNOWN_CM

SECTORS = 72
LEAST_M, MOST_M = 0.3, 5.0
"""Distances that are reported; beyond, predicted depth is not reliable, and a sector counts as free."""

_HALF_HEIGHT_M = 0.25  # above and below the vehicle's origin: what a vehicle that flies level can hit
_LEAST_POINTS = 6  # in a sector, that say anything of it
_NEAREST_SHARE, _OUTLIERS = 0.05, 2  # share and least number of a sector's points that are nearer: outliers


def sector_distances_cm(depth: DepthPrediction, log_scale: float, T_level_camera: FloatArray) -> NDArray[np.uint16]:
    """Distances of the nearest obstacles, as OBSTACLE_DISTANCE takes them.

    Sector 0 is centred on the heading, and the others follow clockwise as seen from above. A sector holds the
    horizontal distance from the vehicle's origin to its nearest points at that height, ``MOST_M`` plus a centimetre
    where these are all farther, and 65535 where there are too few: outside the image, or where only floor and ceiling
    are seen.

    Args:
        depth: of the image, metres.
        log_scale: logarithm of the factor that the depth still needs, as
            :attr:`monoloc.particle_filter.estimate.Estimate.log_scale`.
        T_level_camera: pose of the camera, (4, 4), from the vehicle's origin along axes that are forward along its
            heading, right, and down by gravity.

    Returns:
        (72,) uint16, centimetres.
    """
    seen = depth.camera.back_project(depth.depth_m).reshape(-1, 3)[np.ravel(depth.depth_m) > 0.0]
    points = transform(T_level_camera, np.exp(log_scale) * seen)
    points = points[np.abs(points[:, 2]) < _HALF_HEIGHT_M]
    distances_m = np.hypot(points[:, 0], points[:, 1])
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    sector = np.rint(azimuth / (2.0 * np.pi / SECTORS)).astype(np.int64) % SECTORS
    order = np.lexsort((distances_m, sector))
    counts = np.bincount(sector, minlength=SECTORS)
    first = np.cumsum(counts) - counts
    nearest = first + np.maximum(_OUTLIERS, np.floor(_NEAREST_SHARE * counts)).astype(np.int64)
    result = np.full(SECTORS, UNKNOWN_CM, dtype=np.uint16)
    known = np.flatnonzero(counts >= _LEAST_POINTS)
    found_m = distances_m[order][nearest[known]]
    free_cm = round(100.0 * MOST_M) + 1
    result[known] = np.where(found_m > MOST_M, free_cm, np.rint(100.0 * np.maximum(found_m, LEAST_M))).astype(
        np.uint16
    )
    return result
