"""Statistics that a few outliers do not change."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import FloatArray

_SD_PER_DEVIATION = 1.4826  # of a normal distribution


def robust_sd(values: FloatArray) -> float:
    """Standard deviation of normal values (N,), from the median of their deviations from the median."""
    return _SD_PER_DEVIATION * float(np.median(np.abs(values - np.median(values))))
