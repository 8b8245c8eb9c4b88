"""A component of one's own is used after one calibration, and not before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import monoloc
from monoloc.bundle import Bundle
from monoloc.camera import Camera
from monoloc.components import Components, default_components
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import FloatArray, invert, transform
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import Scan
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc.run import Run, localize
from monoloc.start import Start
from synthetic_room import Room, RoomRecording, make_bundle, make_path


class NearestComponentLikelihood:
    """Density of the component whose mean is nearest to a point, and no other; errors grow with depth."""

    def __init__(self, mixture: GaussianMixture, config: LikelihoodConfig) -> None:
        self._config = config
        self._means, self._covariances = mixture.means, mixture.covariances
        self._nearest = cKDTree(mixture.means)
        self._outliers = config.outlier_share / mixture.volume_m3

    def mean_log_likelihood(
        self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
    ) -> FloatArray:
        sd = self._config.log_depth_sd if log_depth_sd is None else log_depth_sd
        points = np.exp(log_scale)[:, None, None] * scan.points.astype(np.float64)
        world = np.einsum("nij,npj->npi", poses[:, :3, :3], points) + poses[:, None, :3, 3]
        chosen = self._nearest.query(world)[1]
        noise_m = np.median(scan.points[:, 2]) * sd
        covariances = self._covariances + noise_m**2 * np.eye(3)
        precisions, log_dets = np.linalg.inv(covariances), np.linalg.slogdet(2.0 * np.pi * covariances)[1]
        apart = world - self._means[chosen]
        squares = np.einsum("npi,npij,npj->np", apart, precisions[chosen], apart)
        density = (1.0 - self._config.outlier_share) * np.exp(-0.5 * (squares + log_dets[chosen]))
        return np.asarray(np.log(density + self._outliers) @ scan.weights / scan.weights.sum())


def nearest_component(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
    likelihood = NearestComponentLikelihood(bundle.adapted, config.likelihood)
    return replace(default_components(bundle, camera, config), likelihood=likelihood)
