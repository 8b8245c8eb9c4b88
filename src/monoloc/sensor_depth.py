"""Depth of a sensor in place of the network's: its settings, and what is known of its scans."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer_config import LocalizerConfig

# A depth sensor's errors are centimetres and independent from frame to frame.
_SETTINGS = {
    "log_scale_sd": 0.01,
    "scale_tilt": None,
    "particle_bias": BiasModel(sd_at_reference_m=0.015, sd_at_reference_rad=0.01),
    "likelihood": LikelihoodConfig(
        kind="volume", outlier_share=0.2, noise_sd_m=0.02, effective_points=60.0, effective_corners=0.0
    ),
}
_STRIDE = 4  # of the pixels that are used


def sensor_settings(config: LocalizerConfig) -> LocalizerConfig:
    """Settings with the likelihood and the biases of a depth sensor."""
    return config.model_copy(update=_SETTINGS)


def sensor_bundle(bundle: Bundle) -> Bundle:
    """The bundle with a sensor's settings, and what the build measured of its scans, in place of the network's.

    Where the build recording had no depth, a sensor's scans never fit too badly and say nothing of the belief.
    """
    reference_poses = ReferencePoses.without_bias(bundle.reference_poses.poses)
    integrity = bundle.integrity.model_copy(
        update={"scan": bundle.sensor.scan, "scan_search_precision": bundle.sensor.search_precision}
    )
    thresholds = bundle.sensor.thresholds or LikelihoodThresholds.none()
    settings = sensor_settings(bundle.settings)
    return replace(
        bundle, settings=settings, thresholds=thresholds, reference_poses=reference_poses, integrity=integrity
    )


def sparse_depth(depth_m: NDArray[np.float32], camera: Camera) -> DepthPrediction:
    """Every fourth pixel of a sensor's image, (H, W) metres, not averaged, which would mix surfaces.

    Raises:
        ValueError: as :class:`monoloc.depth.predictor.DepthPrediction`, such as for millimetres as whole numbers.
    """
    offset = _STRIDE // 2
    sparse = np.ascontiguousarray(depth_m[offset::_STRIDE, offset::_STRIDE])
    return DepthPrediction(sparse, camera.sampled(offset, _STRIDE))
