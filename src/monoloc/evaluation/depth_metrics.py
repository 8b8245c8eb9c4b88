"""Metrics of predicted depth images.

A pixel counts where the truth is known: finite and greater than zero. Averages over a data set are averages of
per-image values, so an image with many holes weighs as much as one without.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc.geometry import FloatArray

SSIM_RANGE_M = 10.0  # indoor depth sensors and NYU Depth v2 end at 10 m

_SSIM_WINDOW = 11
_SSIM_SIGMA = 1.5
_SSIM_K1, _SSIM_K2 = 0.01, 0.03


@dataclass(frozen=True)
class DepthMetrics:
    """Metrics of one depth image, or their means over several.

    Attributes:
        absrel: mean of ``|predicted - truth| / truth``.
        delta1, delta2, delta3: share of pixels, 0..1, with ``max(predicted / truth, truth / predicted)``
            below 1.25, 1.25^2, 1.25^3.
        rmse_m: root of the mean squared error, metres.
        log10: mean of ``|log10(predicted) - log10(truth)|``.
        ssim: structural similarity over a range of 10 m, see :func:`depth_ssim`; None where it is undefined.
    """

    absrel: float
    delta1: float
    delta2: float
    delta3: float
    rmse_m: float
    log10: float
    ssim: float | None


def depth_metrics(predicted_m: ArrayLike, truth_m: ArrayLike) -> DepthMetrics:
    """Compute the metrics of one predicted depth image.

    Args:
        predicted_m: (H, W) depth along z, metres, finite and positive wherever the truth is known.
        truth_m: (H, W) depth along z, metres; 0 or NaN where unknown.

    Raises:
        ValueError: shapes that differ or are not (H, W), no pixel with truth, or a prediction that is not finite and
            positive at a pixel with truth.
    """
    predicted, truth, valid = _checked_pair(predicted_m, truth_m)
    p, t = predicted[valid], truth[valid]
    ratio = np.maximum(p / t, t / p)
    return DepthMetrics(
        absrel=float(np.mean(np.abs(p - t) / t)),
        delta1=float(np.mean(ratio < 1.25)),
        delta2=float(np.mean(ratio < 1.25**2)),
        delta3=float(np.mean(ratio < 1.25**3)),
        rmse_m=float(np.sqrt(np.mean((p - t) ** 2))),
        log10=float(np.mean(np.abs(np.log10(p) - np.log10(t)))),
        ssim=depth_ssim(predicted, truth, valid, SSIM_RANGE_M),
    )


def truth_where_predicted(predicted_m: ArrayLike, truth_m: ArrayLike) -> NDArray[Any]:
    """True depth (H, W) metres; 0 where the truth is unknown or there is no prediction (0 or NaN)."""
    truth = np.asarray(truth_m)
    return np.where(_has_truth(truth) & (np.asarray(predicted_m) > 0.0), truth, 0.0)


def depth_ssim(predicted_m: ArrayLike, truth_m: ArrayLike, valid: ArrayLike, data_range_m: float) -> float | None:
    """Structural similarity (Wang et al. 2004) of two depth images, with a Gaussian window of 11 pixels, sigma 1.5.

    It is the mean of the SSIM map over the pixels whose whole window is valid, so holes and the image border have no
    effect. Without holes it equals scikit-image's ``structural_similarity`` with
    ``gaussian_weights=True, sigma=1.5, use_sample_covariance=False``.

    Args:
        predicted_m: (H, W) metres.
        truth_m: (H, W) metres.
        valid: (H, W) bool, pixels at which both images have depth.
        data_range_m: range of depths that sets SSIM's two stabilising constants, metres.

    Returns:
        A number in [-1, 1], or None if no window is entirely valid.

    Raises:
        ValueError: shapes that differ or are not (H, W), or a range that is not positive.
    """
    predicted = np.asarray(predicted_m, dtype=np.float64)
    truth = np.asarray(truth_m, dtype=np.float64)
    mask = np.asarray(valid, dtype=np.bool_)
    _check_same_image_shape(predicted, truth)
    if mask.shape != truth.shape:
        raise ValueError(f"valid must have shape {truth.shape}, got {mask.shape}")
    if not data_range_m > 0.0:
        raise ValueError(f"data_range_m must be positive, got {data_range_m}")

    window = np.ones((_SSIM_WINDOW, _SSIM_WINDOW), np.uint8)
    whole = cv2.erode(mask.astype(np.uint8), window, borderType=cv2.BORDER_CONSTANT, borderValue=0) > 0
    if not whole.any():
        return None
    # Values in holes never reach a valid window; zero keeps NaN out of the filter.
    x, y = np.where(mask, predicted, 0.0), np.where(mask, truth, 0.0)
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    variance_x = _window_mean(x * x) - mean_x**2
    variance_y = _window_mean(y * y) - mean_y**2
    covariance = _window_mean(x * y) - mean_x * mean_y
    c1, c2 = (_SSIM_K1 * data_range_m) ** 2, (_SSIM_K2 * data_range_m) ** 2
    luminance = (2.0 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    structure = (2.0 * covariance + c2) / (variance_x + variance_y + c2)
    return float(np.mean((luminance * structure)[whole]))


class DepthAccumulator:
    """Mean of :class:`DepthMetrics` over the images of a data set."""

    def __init__(self) -> None:
        self._metrics: list[DepthMetrics] = []

    def __len__(self) -> int:
        """Number of images that counted."""
        return len(self._metrics)

    def add(self, predicted_m: ArrayLike, truth_m: ArrayLike) -> None:
        """Add one image; an image without any truth (a sensor's empty frame) is skipped.

        Args and Raises: as :func:`depth_metrics`, except that an image without truth is no error.
        """
        truth = np.asarray(truth_m, dtype=np.float64)
        if _has_truth(truth).any():
            self._metrics.append(depth_metrics(predicted_m, truth))

    def mean(self) -> DepthMetrics:
        """Mean of each metric over the images at which it is defined.

        Raises:
            ValueError: no image counted.
        """
        if not self._metrics:
            raise ValueError("no image with true depth was added")
        means = {}
        for field in fields(DepthMetrics):
            values = [v for m in self._metrics if (v := getattr(m, field.name)) is not None]
            means[field.name] = float(np.mean(values)) if values else None
        return DepthMetrics(**means)  # type: ignore[arg-type]  # only ssim is ever None


def _window_mean(image: FloatArray) -> FloatArray:
    size = (_SSIM_WINDOW, _SSIM_WINDOW)
    return np.asarray(cv2.GaussianBlur(image, size, sigmaX=_SSIM_SIGMA, borderType=cv2.BORDER_REFLECT))


def _has_truth(truth: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(truth) & (truth > 0.0))


def _check_same_image_shape(predicted: FloatArray, truth: FloatArray) -> None:
    if truth.ndim != 2:
        raise ValueError(f"truth must have shape (H, W), got {truth.shape}")
    if predicted.shape != truth.shape:
        raise ValueError(f"predicted must have shape {truth.shape}, got {predicted.shape}")


def _checked_pair(predicted_m: ArrayLike, truth_m: ArrayLike) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Both images as float64, and the mask of known truth."""
    predicted = np.asarray(predicted_m, dtype=np.float64)
    truth = np.asarray(truth_m, dtype=np.float64)
    _check_same_image_shape(predicted, truth)
    valid = _has_truth(truth)
    if not valid.any():
        raise ValueError("truth must have a pixel that is finite and positive, got none")
    if not np.all(np.isfinite(predicted[valid]) & (predicted[valid] > 0.0)):
        raise ValueError("predicted must be finite and positive wherever the truth is known")
    return predicted, truth, valid
