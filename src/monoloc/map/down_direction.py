"""Which way is down in a room, by its floor, its tables and its walls."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.map.mixture import GaussianMixture

_WITHIN_RAD = np.deg2rad([30.0, 20.0, 10.0, 5.0, 5.0])  # of level or upright, surfaces that count, turn by turn
_LEAST_SHARE = 0.1  # of the flat surfaces, that must be level, and as many upright


def down_of(mixture: GaussianMixture, roughly: FloatArray) -> FloatArray | None:
    """The direction to which most flat surfaces are level or upright, (3,) unit vector, world frame.

    Of what is within some degrees of either, ``sum w (n . down)^2`` over the upright, less that over the level, is
    least for an eigenvector; a few turns with ever fewer degrees leave out what leans.

    Args:
        mixture: the room's map.
        roughly: (3,) down but for some 25 degrees, of any length.

    Returns:
        None where too little is flat and level, or upright, to tell.
    """
    variances, axes = np.linalg.eigh(mixture.covariances)
    normals = axes[:, :, 0]
    weights = mixture.weights * (1.0 - np.sqrt(variances[:, 0] / variances[:, 1])) ** 2  # flat ones, mostly
    length = float(np.linalg.norm(roughly))
    if length == 0.0:
        return None
    down = np.asarray(roughly, dtype=np.float64) / length
    for within in _WITHIN_RAD:
        cosine = np.abs(normals @ down)
        is_level, is_upright = cosine > np.cos(within), cosine < np.sin(within)
        if min(weights[is_level].sum(), weights[is_upright].sum()) <= _LEAST_SHARE * weights.sum():
            return None
        signed = weights * (is_upright.astype(np.float64) - is_level)
        direction = np.linalg.eigh((normals.T * signed) @ normals)[1][:, 0]
        down = np.copysign(1.0, direction @ down) * direction
    return np.asarray(down)
