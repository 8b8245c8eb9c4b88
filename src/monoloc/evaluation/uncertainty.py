"""Calibration of a depth network's error estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray

_BINS = 10
LEAST_PIXELS = _BINS
"""Number of values that a calibration needs: one a bin."""


@dataclass(frozen=True)
class ErrorCalibration:
    """Estimated against actual error of log-depth, in bins of equally many pixels, most certain first.

    Attributes:
        stated: (bins,) mean of the estimated Laplace scale, which is also the expected absolute error.
        actual: (bins,) mean absolute error of log-depth.
        confidence: (levels,) probabilities, 0..1.
        coverage: (levels,) share of pixels whose error lies within the estimated interval of that probability.
        nll: mean negative log-likelihood of the errors under the estimated scales, nats per pixel.
        nll_constant: the same under the best single scale for all pixels; the difference is the gain from the
            estimate.
    """

    stated: FloatArray
    actual: FloatArray
    confidence: FloatArray
    coverage: FloatArray
    nll: float
    nll_constant: float


def error_calibration(log_error: ArrayLike, log_scale: ArrayLike) -> ErrorCalibration:
    """Measure how well estimated Laplace scales describe errors.

    Args:
        log_error: (N,) predicted minus true log-depth.
        log_scale: (N,) natural logarithm of the estimated scale b, density ``exp(-|e| / b) / 2b``.

    Raises:
        ValueError: shapes that differ, too few values, or values that are not finite.
    """
    error = np.abs(np.asarray(log_error, dtype=np.float64))
    log_b = np.asarray(log_scale, dtype=np.float64)
    if error.shape != log_b.shape or error.ndim != 1 or len(error) < LEAST_PIXELS:
        raise ValueError(f"need two arrays (N,), N >= {LEAST_PIXELS}, got {error.shape} and {log_b.shape}")
    if not (np.isfinite(error).all() and np.isfinite(log_b).all()):
        raise ValueError("errors and scales must be finite")
    scale = np.exp(log_b)
    bins = np.array_split(np.argsort(scale), _BINS)
    confidence = np.linspace(0.05, 0.95, 19)
    # A Laplace error is within b log(1 / (1 - p)) with probability p.
    coverage = np.array([np.mean(error <= -scale * np.log1p(-p)) for p in confidence])
    return ErrorCalibration(
        stated=np.array([scale[b].mean() for b in bins]),
        actual=np.array([error[b].mean() for b in bins]),
        confidence=confidence,
        coverage=coverage,
        nll=float(np.mean(error / scale + log_b)) + float(np.log(2.0)),
        nll_constant=1.0 + float(np.log(2.0 * max(error.mean(), 1e-12))),
    )
