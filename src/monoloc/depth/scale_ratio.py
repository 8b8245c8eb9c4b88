"""Ratio of known depth to a network's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.depth.predictor import DepthPrediction

_SMOOTH = 0.1  # largest relative step of depth that is compared with a network's
_LEAST_PIXELS = 50


def scale_ratio(depth_m: NDArray[np.float32], camera: Camera, predicted: DepthPrediction) -> float | None:
    """Median ratio of depth (H, W) of a camera to predicted depth; None if they share too few pixels."""
    at = predicted.camera
    u, v = np.meshgrid(np.arange(at.width), np.arange(at.height))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
    given = sample_depth(pixels, at, depth_m, camera, _SMOOTH).reshape(at.height, at.width)
    known = (given > 0.0) & (predicted.depth_m > 0.0)
    if known.sum() < _LEAST_PIXELS:
        return None
    return float(np.median(given[known] / predicted.depth_m[known]))
