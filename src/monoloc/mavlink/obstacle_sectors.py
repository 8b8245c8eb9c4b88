"""Distances to obstacles as OBSTACLE_DISTANCE takes them: 72 sectors of five degrees, in centimetres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.mavlink.messages import UNKNOWN_CM
from monoloc.obstacles.sectors import LEAST_M, MOST_M


def sector_distances_cm(distances_m: FloatArray) -> NDArray[np.uint16]:
    """Distances of the nearest obstacles for :func:`monoloc.mavlink.messages.obstacle_distance`.

    Args:
        distances_m: (72,) as :func:`monoloc.obstacles.sectors.sector_distances_m` gives them.

    Returns:
        (72,) uint16, centimetres, at least ``LEAST_M``: ``MOST_M`` plus a centimetre where a sector is free, 65535
        where nothing is known.
    """
    free_cm = round(100.0 * MOST_M) + 1
    within = np.clip(np.where(np.isfinite(distances_m), distances_m, 0.0), LEAST_M, MOST_M)
    known = np.where(np.isinf(distances_m), free_cm, np.rint(100.0 * within))
    return np.where(np.isnan(distances_m), UNKNOWN_CM, known).astype(np.uint16)
