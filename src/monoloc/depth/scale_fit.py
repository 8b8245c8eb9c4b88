"""Fit of the scale and shift that convert a network's output to metres, from frames with known depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import DepthModel, ModelSpec
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording

_PIXELS_PER_FRAME = 2000
_LEAST_PIXELS = 100
_LEAST_POSITIVE = 0.5  # share of pixels; below it, a metric output is not depth
_REVERSED = -0.5  # correlation; below it, the output is inverted: even poor networks are not that bad
_ITERATIONS = 50
_LOG_SOFTNESS = 1e-3  # relative error that counts as zero; avoids division by zero


def fit_to_depth(
    model: DepthModel,
    recording: Recording,
    depth_of: Callable[[int], NDArray[np.float32]],
    progress: Callable[[int], None],
) -> DepthModel:
    """Fit the scale, and for a relative network the shift, on all frames of a recording together.

    Args:
        model: the network.
        recording: frames to predict.
        depth_of: returns the true depth of frame i, (H, W) metres, 0 where there is none.
        progress: called with the number of frames done.

    Returns:
        The model with the fitted spec.

    Raises:
        DataError: as :func:`fitted_spec`, or a frame cannot be read.
    """
    predictor = DepthPredictor(model, recording.camera)
    camera, small = recording.camera, predictor.output_camera
    # Centres of the output's pixels in the recording's image.
    columns = _nearest((np.arange(small.width) - small.cx) * (camera.fx / small.fx) + camera.cx, camera.width)
    rows = _nearest((np.arange(small.height) - small.cy) * (camera.fy / small.fy) + camera.cy, camera.height)
    raw, truth = [], []
    for index in range(len(recording)):
        raw.append(predictor.raw(recording.color(index)).ravel())
        truth.append(depth_of(index)[np.ix_(rows, columns)].ravel())
        known = np.flatnonzero(np.isfinite(truth[-1]) & (truth[-1] > 0.0))
        known = known[:: max(1, len(known) // _PIXELS_PER_FRAME)]
        raw[-1], truth[-1] = raw[-1][known], truth[-1][known] / np.float32(predictor.focal_ratio)
        progress(index + 1)
    return replace(model, spec=fitted_spec(model.spec, np.concatenate(raw), np.concatenate(truth), model.name))


def fitted_spec(spec: ModelSpec, raw: NDArray[np.float32], depth_m: NDArray[np.float32], name: str) -> ModelSpec:
    """Fit the scale, and for a relative network the shift, that bring depth closest to the truth.

    A scale alone is the median ratio. Scale and shift minimise the mean of ``|log predicted - log true|``, so that a
    third of outlier pixels moves neither. Both fits penalise depth that is too large or too small equally.

    Args:
        spec: spec of the network.
        raw: (N,) the network's output.
        depth_m: (N,) true depth at the same pixels, metres, positive.
        name: name of the network in error messages.

    Raises:
        DataError: too few pixels, or an output that does not correlate with depth.
    """
    finite = np.isfinite(raw)
    x, depth = raw[finite].astype(np.float64), depth_m[finite].astype(np.float64)
    if len(x) < _LEAST_PIXELS:
        problem = f"has a value at only {len(x)} pixels of known depth, so its scale cannot be fitted"
        raise DataError(name, problem, "give more frames with depth, or a cloud that they see")
    if np.ptp(x) == 0.0:
        raise DataError(name, "gives the same value everywhere", "check mean, std, channels and layout in its TOML")
    if not spec.has_shift:
        return spec.model_copy(update={"scale": _scale(spec, x, depth, name), "shift": 0.0})
    scale, shift = _line(x, 1.0 / depth if spec.output == "disparity" else depth)
    if not scale > 0.0:
        raise _runs_against(spec, name, f"fitted scale {scale:.3g}")
    return spec.model_copy(update={"scale": scale, "shift": shift})


def _scale(spec: ModelSpec, x: FloatArray, depth: FloatArray, name: str) -> float:
    unscaled = spec.model_copy(update={"scale": 1.0, "shift": 0.0}).depth(x.astype(np.float32)).astype(np.float64)
    usable = np.isfinite(unscaled) & (unscaled > 0.0)
    if usable.mean() < _LEAST_POSITIVE:
        problem = f"gives positive depth at only {usable.mean():.0%} of the pixels"
        raise DataError(name, problem, "check output, metric, mean and std in its TOML")
    with np.errstate(invalid="ignore"):  # constant depth has an undefined correlation
        correlation = np.corrcoef(np.log(unscaled[usable]), np.log(depth[usable]))[0, 1]
    if correlation < _REVERSED:
        raise _runs_against(spec, name, f"correlation {correlation:.2f}")
    factor = float(np.exp(np.median(np.log(depth[usable]) - np.log(unscaled[usable]))))
    return 1.0 / factor if spec.output == "disparity" else factor


def _runs_against(spec: ModelSpec, name: str, figure: str) -> DataError:
    other = "depth" if spec.output == "disparity" else "disparity"
    problem = f"gives values that do not grow with {spec.output} ({figure})"
    return DataError(name, problem, f'write output = "{other}" in its TOML, or check mean, std, channels and layout')


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Scale and shift that minimise the mean of ``|log(scale * x + shift) - log y|``; all y are positive.

    Iteratively reweighted least squares, started from least squares of relative errors.
    """
    fitted = y
    for iteration in range(_ITERATIONS):
        # The weights match the derivative of |log p - log y| with respect to p, sign(p - y) / p.
        error = np.abs(fitted - y) if iteration else y
        weights = 1.0 / (fitted * np.maximum(error, _LOG_SOFTNESS * fitted))
        mean_x, mean_y = np.average(x, weights=weights), np.average(y, weights=weights)
        scale = np.sum(weights * (x - mean_x) * (y - mean_y)) / np.sum(weights * (x - mean_x) ** 2)
        shift = mean_y - scale * mean_x
        fitted = np.maximum(scale * x + shift, 0.1 * y)  # bounds the weight of far too small values
    return float(scale), float(shift)


def _nearest(pixels: NDArray[np.floating], count: int) -> NDArray[np.int64]:
    return np.clip(np.round(pixels), 0, count - 1).astype(np.int64)
