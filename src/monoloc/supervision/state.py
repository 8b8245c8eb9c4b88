"""Whether the pose can be believed."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

from monoloc.particle_filter.estimate import Estimate

State = Literal["tracking", "uncertain", "lost"]

WIDE_SD_M = 0.5  # of a belief that says nothing about where in a room the camera is
# From the median to the first percentile. Of fifteen frames of a real room it is 0.4 to 0.6; of a few, the least is
# near the median by chance.
_FEW, _LEAST_RANGE = 10, 0.4


class HealthyRange(BaseModel):
    """Range of a scan's mean log-likelihood at the true pose, measured on frames that tuned nothing.

    Attributes:
        low: its first percentile, of few frames well below their median; below it the pose is doubted.
        lost: as far below ``low`` as ``low`` is below the median; below it the pose is not believed.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    low: float
    lost: float

    @classmethod
    def from_fits(cls, fits: ArrayLike) -> HealthyRange:
        """Measure the range on fits (N,) at true poses, nats."""
        values = np.asarray(fits, dtype=np.float64)
        low, median = np.percentile(values, [1.0, 50.0])
        if len(values) < _FEW:
            low = min(low, median - _LEAST_RANGE)
        return cls(low=float(low), lost=float(2.0 * low - median))


def is_wide(belief: Estimate) -> bool:
    """Whether a belief says nothing about where in a room the camera is."""
    return math.sqrt(float(np.linalg.eigvalsh(belief.covariance[:3, :3])[-1])) > WIDE_SD_M


def judge(fit: float, belief: Estimate, healthy: HealthyRange, is_followed: bool) -> State:
    """State of the localizer: an empty scan (fit NaN), a wide belief or a camera lost sight of is not ``tracking``.

    Args:
        is_followed: whether odometry, if there is one, has followed the camera: a network's depth fits somewhere even
            where it is invented.
    """
    if is_wide(belief) or fit < healthy.lost:
        return "lost"
    if math.isnan(fit) or fit < healthy.low or not is_followed:
        return "uncertain"
    return "tracking"
