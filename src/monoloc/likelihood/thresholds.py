"""Thresholds on the scan's likelihood, measured on held-out frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict

# Distance from the median to the first percentile. Of fifteen frames of a real room it is 0.4 to 0.6; of fewer, the
# lowest value is near the median by chance.
_FEW_FRAMES, _LEAST_RANGE = 10, 0.4


class LikelihoodThresholds(BaseModel):
    """Thresholds on a scan's mean log-likelihood, nats a point.

    Attributes:
        low: first percentile at true poses of held-out frames, and well below the median if there are few frames;
            a place that a search finds is confirmed only above it.
        lost: as far below ``low`` as ``low`` is below the median; below it a scan does not count.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    low: float
    lost: float

    @classmethod
    def from_log_likelihoods(cls, values: ArrayLike) -> LikelihoodThresholds:
        """From mean log-likelihoods (N,) at true poses, nats."""
        values = np.asarray(values, dtype=np.float64)
        low, median = np.percentile(values, [1.0, 50.0])
        if len(values) < _FEW_FRAMES:
            low = min(low, median - _LEAST_RANGE)
        return cls(low=float(low), lost=float(2.0 * low - median))

    @classmethod
    def none(cls) -> LikelihoodThresholds:
        """Thresholds that no scan falls below."""
        return cls.model_construct(low=-np.inf, lost=-np.inf)  # no bundle has these
