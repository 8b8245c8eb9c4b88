"""Evaluation of a depth network on a recording with depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from monoloc.depth.predictor import DepthPredictor
from monoloc.errors import DataError
from monoloc.evaluation.depth_metrics import DepthAccumulator, DepthMetrics, truth_where_predicted
from monoloc.evaluation.uncertainty import LEAST_PIXELS, ErrorCalibration, error_calibration
from monoloc.io.recording import Recording
from monoloc.progress import Step


@dataclass(frozen=True)
class NetworkEvaluation:
    """Evaluation results of a network.

    Attributes:
        metrics: means over frames, at pixels with true and predicted depth, at the resolution of the truth.
        evaluated: indices of the frames with at least one such pixel.
        predicted_share: share of the pixels with true depth that have a prediction.
        calibration: calibration of the network's own error estimate; None if it has none, or at too few pixels.
    """

    metrics: DepthMetrics
    evaluated: list[int]
    predicted_share: float
    calibration: ErrorCalibration | None


def evaluate_network(
    predictor: DepthPredictor, recording: Recording, progress: Step | None = None
) -> NetworkEvaluation:
    """Compare predicted with measured depth over all frames.

    Raises:
        DataError: the frames have no depth, or no pixel has both.
    """
    accumulator = DepthAccumulator()
    known = predicted = 0
    evaluated, errors, scales = [], [], []
    for index in range(len(recording)):
        prediction, truth = predictor(recording.color(index)), recording.depth(index)
        depth = prediction.resized(recording.camera.width, recording.camera.height)
        compared = truth_where_predicted(depth, truth)
        known, predicted = known + int(np.sum(truth > 0.0)), predicted + int(np.sum(compared > 0.0))
        accumulator.add(depth, compared)
        if compared.any():
            evaluated.append(index)
        if prediction.log_error is not None:
            # At the network's own pixels, because interpolation correlates neighbours.
            size = prediction.depth_m.shape[::-1]
            small = cv2.resize(truth, size, interpolation=cv2.INTER_NEAREST_EXACT)
            has_both = (small > 0.0) & (prediction.depth_m > 0.0)
            errors.append(np.log(prediction.depth_m[has_both] / small[has_both]))
            scales.append(prediction.log_error[has_both])
        if progress is not None:
            progress(index + 1)
    if not known:
        raise DataError(recording.name, "has no depth at any pixel of these frames", "check its depth images")
    if not evaluated:
        raise DataError(predictor.name, "gives no depth at any pixel of known depth", "check its TOML, or --frames")
    # Sparse depth may have hardly a pixel of the network's.
    has_enough = sum(map(len, errors)) >= LEAST_PIXELS
    calibration = error_calibration(np.concatenate(errors), np.concatenate(scales)) if has_enough else None
    return NetworkEvaluation(accumulator.mean(), evaluated, predicted / known, calibration)
