"""What the localizer may believe of its scans, measured on frames that tuned nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import Scan, scan_from_depth
from monoloc.likelihood.scan_likelihood import Measurement, MeasurementConfig
from monoloc.localizer import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.supervision.state import HealthyRange

# Of each likelihood, the setting that says how wide errors are, and its candidates.
_WIDTHS = {
    "ray": ("log_depth_sd", (0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16, 0.24)),
    "volume": ("noise_sd_m", (0.02, 0.03, 0.05, 0.08, 0.12, 0.2)),
}
_LOG_SCALES = np.linspace(-0.4, 0.4, 161)
_LEAST_LOG_SCALE_SD = 0.02  # between build frames it is less, but away from them the scale wanders by as much


@dataclass(frozen=True)
class Sample:
    """A held-out frame: its index, its depth before it is levelled, and the true ``T_world_camera``."""

    index: int
    depth: DepthPrediction
    pose: FloatArray


def scans_of(samples: list[Sample], config: LocalizerConfig, rng: np.random.Generator) -> list[tuple[Scan, Sample]]:
    """The scans that a localizer would take of samples, where there are any points to take."""
    scans = [scan_from_depth(s.depth, config.scan_points, rng, config.measurement.error_power) for s in samples]
    return [(scan, sample) for scan, sample in zip(scans, samples, strict=True) if len(scan)]


def calibrate(
    mixture: GaussianMixture, samples: list[Sample], base: LocalizerConfig, rng: np.random.Generator
) -> tuple[LocalizerConfig, HealthyRange]:
    """The likelihood's width and the depth scale's spread, by maximum likelihood on held-out frames at true poses.

    The width is that under which the held-out points are most likely, each frame at its own best depth scale; the
    slow part of those scales' spread is the prior of the filter's log-scale. The outlier share is not fitted: the
    most likely one is small, and a generous one tracks better, since the errors of one image go together.

    Raises:
        DataError: no frame's depth gives a scan.
    """
    usable = scans_of(samples, base, rng)
    frames = np.array([sample.index for _, sample in usable])
    if not usable:
        problem = f"gives no usable depth on any of {len(samples)} frames"
        fix = "check output, metric and scale in its TOML: depth must come out in metres"
        raise DataError("network", problem, fix)
    best: tuple[float, MeasurementConfig, FloatArray, FloatArray] | None = None
    name, widths = _WIDTHS[base.measurement.likelihood]
    for width in widths:
        config = base.measurement.model_copy(update={name: width})
        fits, scales = _fits(Measurement(mixture, config), usable)
        if best is None or fits.mean() > best[0]:
            best = (float(fits.mean()), config, fits, scales)
    assert best is not None
    _, measurement, fits, scales = best
    settings = base.model_copy(update={"measurement": measurement, "log_scale_sd": slow_sd(scales, frames)})
    return settings, HealthyRange.from_fits(fits)


def _fits(measurement: Measurement, scans: list[tuple[Scan, Sample]]) -> tuple[FloatArray, FloatArray]:
    """Best mean log-likelihood of every scan over the depth's scale, and the log-scale that gives it."""
    fits, scales = [], []
    for scan, sample in scans:
        poses = np.repeat(sample.pose[None], len(_LOG_SCALES), axis=0)
        values = measurement.mean_log_likelihood(poses, _LOG_SCALES, scan)
        fits.append(values.max())
        scales.append(_LOG_SCALES[values.argmax()])
    return np.array(fits), np.array(scales)


def slow_sd(log_scales: FloatArray, frames: NDArray[np.int64]) -> float:
    """Root mean square of what neighbouring frames share, of (N,) scales of frames in order: noise a frame cancels.

    By the product of frames that follow one another, about 0, where the filter's prior is centred. A wider prior lets
    the filter trade the depth's scale against the distance to the walls.
    """
    products = (log_scales[1:] * log_scales[:-1])[np.diff(frames) == 1]
    shared = float(products.mean()) if len(products) else 0.0
    return float(np.sqrt(max(shared, _LEAST_LOG_SCALE_SD**2)))
