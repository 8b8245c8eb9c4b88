"""Direction of gravity in a room, from its floor, tables and walls."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.map.mixture import GaussianMixture

_WITHIN_RAD = np.deg2rad([30.0, 20.0, 10.0, 5.0, 5.0])  # tolerance of horizontal and vertical, per iteration
_MIN_SHARE = 0.1  # of the flat surfaces; required both of horizontal and of vertical ones


def down_of(mixture: GaussianMixture, roughly: FloatArray, within_rad: FloatArray = _WITHIN_RAD) -> FloatArray | None:
    """Estimate the down direction from horizontal and vertical flat surfaces: (3,) unit vector, world frame.

    The estimate minimises ``sum w (n . down)^2`` over vertical surfaces minus the same sum over horizontal ones,
    which is an eigenvector problem. Iterations with a decreasing angular tolerance exclude tilted surfaces.

    Args:
        mixture: the room's map.
        roughly: (3,) approximate down direction of any length, within about 25 degrees.
        within_rad: tolerance of each iteration, (I,); wider ones for surfaces that are known less exactly.

    Returns:
        None if too few surfaces are horizontal or too few are vertical.
    """
    variances, axes = np.linalg.eigh(mixture.covariances)
    normals = axes[:, :, 0]
    weights = mixture.weights * (1.0 - np.sqrt(variances[:, 0] / variances[:, 1])) ** 2  # favours flat components
    length = float(np.linalg.norm(roughly))
    if length == 0.0:
        return None
    down = np.asarray(roughly, dtype=np.float64) / length
    for within in within_rad:
        cosine = np.abs(normals @ down)
        is_horizontal, is_vertical = cosine > np.cos(within), cosine < np.sin(within)
        if min(weights[is_horizontal].sum(), weights[is_vertical].sum()) <= _MIN_SHARE * weights.sum():
            return None
        signed = weights * (is_vertical.astype(np.float64) - is_horizontal)
        direction = np.linalg.eigh((normals.T * signed) @ normals)[1][:, 0]
        down = np.copysign(1.0, direction @ down) * direction
    return np.asarray(down)
