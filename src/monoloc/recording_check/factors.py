"""Unknown factors of a recording, fitted to its corners: the scale of depth, and the focal length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.reprojection import Reprojection

_FINE_STEP = 0.0025  # of the logarithm
_RESAMPLES = 200
_NOTHING = 0.02  # share of the motion; smaller errors are as good as none
# Standard deviation of the logarithm in 26 parts of two rooms beyond what resampling says: poses drift.
_DRIFT_SD = 0.02
_SCALES, _FOCALS = np.linspace(-9.5, 9.5, 96), np.linspace(-0.7, 0.7, 29)  # logarithms that are tried


@dataclass(frozen=True)
class Factor:
    """A factor under which the corners fit best.

    Attributes:
        value: the factor.
        sampling_log_sd: standard deviation of its logarithm, by resampling of the pairs.
        fit: the errors with it.
    """

    value: float
    sampling_log_sd: float
    fit: Reprojection

    @property
    def log_value(self) -> float:
        return float(np.log(self.value))

    @property
    def log_sd(self) -> float:
        """Standard deviation of the logarithm, drift of right poses included."""
        return float(np.hypot(self.sampling_log_sd, _DRIFT_SD))

    @property
    def error(self) -> float:
        """Geometric mean of the pairs' errors, in which each pair counts alike: that which is least."""
        return float(np.exp(np.nanmean(_log_errors(self.fit.shares))))


def fit_depth_scale(evidence: Evidence, convert: Callable[[FloatArray], FloatArray] | None = None) -> Factor:
    """Factor of stated over true depth, if the poses are right, or of true over stated translation, if the depth is.

    Args:
        evidence: with sensor depth.
        convert: applied to the stored poses first.
    """
    relative = evidence.relative(evidence.poses if convert is None else evidence.converted(convert))
    depth_m = evidence.depth_m(evidence.poses)

    def measure(log_factor: float) -> Reprojection:
        scaled = relative.copy()
        scaled[:, :3, 3] *= np.exp(log_factor)
        return evidence.reproject(scaled, depth_m)

    return _fit(measure, _SCALES)


def fit_focal(evidence: Evidence) -> Factor:
    """Factor of true over stated focal length."""
    relative, depth_m = evidence.relative(evidence.poses), evidence.depth_m(evidence.poses)
    return _fit(lambda log_factor: evidence.reproject(relative, depth_m, float(np.exp(log_factor))), _FOCALS)


def fit_image_size(evidence: Evidence) -> Factor:
    """Factor of true over stated focal length and principal point, as where images were resized after calibration."""
    relative, depth_m = evidence.relative(evidence.poses), evidence.depth_m(evidence.poses)
    camera = evidence.matches.camera
    corner = np.array([-(camera.cx + 0.5) / camera.fx, -(camera.cy + 0.5) / camera.fy])
    return _fit(lambda log_factor: evidence.reproject(relative, depth_m, float(np.exp(log_factor)), corner), _FOCALS)


def _fit(measure: Callable[[float], Reprojection], log_factors: FloatArray) -> Factor:
    coarse = log_factors[np.argmin([measure(value).median for value in log_factors])]
    step = log_factors[1] - log_factors[0]
    fine = coarse + np.arange(-step, step + _FINE_STEP / 2.0, _FINE_STEP)
    fits = [measure(value) for value in fine]
    shares = np.stack([fit.shares for fit in fits], axis=1)
    shares = shares[np.isfinite(shares).all(axis=1)]
    if len(shares) == 0:
        return Factor(1.0, float("inf"), fits[len(fits) // 2])
    # By the median, in place of the geometric mean, results scatter twice as much.
    errors = _log_errors(shares)
    chosen = np.random.default_rng(0).integers(len(errors), size=(_RESAMPLES, len(errors)))
    best = fine[np.argmin(errors[chosen].mean(axis=1), axis=1)]
    at = int(np.argmin(errors.mean(axis=0)))
    return Factor(float(np.exp(fine[at])), float(np.std(best)), fits[at])


def _log_errors(shares: FloatArray) -> FloatArray:
    return np.asarray(np.log(shares + _NOTHING))
