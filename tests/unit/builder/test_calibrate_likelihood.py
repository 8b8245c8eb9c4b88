"""Calibration of the likelihood on depth with known errors: error size, spread of the scale, thresholds."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from monoloc.builder.calibrate import calibrate_likelihood, slow_sd
from monoloc.builder.samples import Sample
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, se3_exp
from monoloc.likelihood import make_likelihood
from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood
from monoloc.likelihood.scan import Scan, scan_from_depth
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.mixture import GaussianMixture

LEAST_LOG_SCALE_SD = 0.02

# A corner of three walls, each one component: its scans are known to the millimetre.
CORNER_M = np.array([0.9, 0.7, 2.0])
CORNER = GaussianMixture(
    np.full(3, 1.0 / 3.0),
    np.array([[0.9, 0.0, 1.4], [0.0, 0.7, 1.4], [0.0, 0.0, 2.0]]),
    np.stack([np.diag(np.where(np.arange(3) == axis, 0.002, 0.6) ** 2) for axis in range(3)]),
)
CORNER_CAMERA = Camera(40, 30, 36.0, 36.0, 19.6, 14.4)


def corner_samples(count: int, noise: float, outlier_share: float, scale_sd: float) -> list[Sample]:
    """Exact depth made worse: relative noise; one side of the image too near; a factor that changes slowly.

    The noise is smooth over a few pixels, as a network's is: depth that jumps from pixel to pixel gives no scan.
    """
    rng = np.random.default_rng(0)
    samples = []
    for index in range(count):
        pose = se3_exp(rng.normal(size=6) * np.array([0.1, 0.1, 0.1, 0.05, 0.1, 0.05]))
        rays = CORNER_CAMERA.pixel_rays() @ pose[:3, :3].T
        with np.errstate(divide="ignore"):
            along = (CORNER_M - pose[:3, 3]) / rays
        depth_m = np.where(along > 0.0, along, np.inf).min(axis=-1)
        field = cv2.GaussianBlur(rng.normal(size=depth_m.shape), (0, 0), 2.0)
        depth_m *= np.exp(noise * field / field.std())
        depth_m[:, : round(outlier_share * CORNER_CAMERA.width)] *= 0.5
        depth_m *= np.exp(np.sqrt(2.0) * scale_sd * np.sin(2.0 * np.pi * index / count))
        samples.append(Sample(index, DepthPrediction(depth_m.astype(np.float32), CORNER_CAMERA), pose))
    return samples


def likelihood_for(config: LikelihoodConfig) -> ScanLikelihood:
    return make_likelihood(CORNER, config)


def calibrated(kind: str, *errors: float) -> LocalizerConfig:
    base = LocalizerConfig(likelihood=LikelihoodConfig(kind=kind, outlier_share=0.1))
    return calibrate_likelihood(likelihood_for, corner_samples(10, *errors), base, np.random.default_rng(0))[0]


@pytest.mark.parametrize("noise", [0.03, 0.06, 0.12, 0.2])
def test_error_size_is_that_of_the_depth(noise: float) -> None:
    """Candidates differ by a third to a half; the one found is at most one step from the truth."""
    found = calibrated("ray", noise, 0.0, 0.0).likelihood
    assert noise / 1.5 <= found.log_depth_sd <= 1.5 * noise
    other_settings = found.model_copy(update={"log_depth_sd": LikelihoodConfig().log_depth_sd})
    assert other_settings == LikelihoodConfig(outlier_share=0.1)


@pytest.mark.parametrize("kind", ["ray", "volume"])
def test_noise_outliers_and_scale_are_distinguished(kind: str) -> None:
    exact, noisy, outliers, unsteady = (
        calibrated(kind, *errors) for errors in ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.4, 0.0), (0.0, 0.0, 0.12))
    )

    def error_size(config: LocalizerConfig) -> float:
        return config.likelihood.log_depth_sd if kind == "ray" else config.likelihood.noise_sd_m

    assert error_size(exact) <= 0.05 < error_size(noisy) <= 0.2
    assert exact.likelihood.outlier_share == 0.1
    assert error_size(outliers) <= 0.05
    assert error_size(unsteady) <= 0.05
    assert exact.log_scale_sd == LEAST_LOG_SCALE_SD
    assert 0.07 < unsteady.log_scale_sd < 0.2


def test_only_errors_that_neighbouring_frames_share_widen_the_scale() -> None:
    rng = np.random.default_rng(0)
    drift = np.cumsum(rng.normal(0.0, 0.02, 400))
    frames = np.arange(400)
    assert slow_sd(rng.normal(0.0, 0.05, 400), frames) < 0.025
    assert slow_sd(drift, frames) == pytest.approx(np.sqrt(np.mean(drift**2)), rel=0.05)
    # The filter's prior is about 0, so what is steadily off needs as wide a one.
    assert slow_sd(np.full(20, 0.15), np.arange(20)) == pytest.approx(0.15)
    # Nothing is known of frames that are not consecutive.
    assert slow_sd(drift, 2 * frames) == LEAST_LOG_SCALE_SD
    # Two regions, each steady, of different scales: the difference is slow, and the gap between them is no pair.
    steps = np.repeat([-0.1, 0.1], 4)
    assert slow_sd(steps, np.array([1, 2, 3, 4, 11, 12, 13, 14])) == pytest.approx(0.1)
    # However steady build frames are, the scale is left free to wander.
    for steady in (np.array([0.1]), np.zeros(50), np.tile([0.05, -0.05], 50)):
        assert slow_sd(steady, np.arange(len(steady))) == LEAST_LOG_SCALE_SD


def test_thresholds_separate_right_from_wrong_poses() -> None:
    rng = np.random.default_rng(1)
    samples = corner_samples(20, 0.03, 0.1, 0.02)
    config, thresholds = calibrate_likelihood(likelihood_for, samples[:10], LocalizerConfig(), rng)
    likelihood = likelihood_for(config.likelihood)

    def best_over_scales(sample: Sample, error: FloatArray) -> float:
        scan = scan_from_depth(sample.depth, config.scan_points, rng)
        scales = np.linspace(-0.1, 0.1, 21)
        poses = np.repeat((sample.pose @ se3_exp(error))[None], len(scales), axis=0)
        return float(likelihood.mean_log_likelihood(poses, scales, scan).max())

    right = [best_over_scales(sample, np.zeros(6)) for sample in samples[10:]]
    wrong = [best_over_scales(sample, np.array([0.4, 0.2, 0.4, 0.1, 0.5, 0.0])) for sample in samples[10:]]
    assert thresholds.lost < thresholds.low < np.median(right)
    assert max(wrong) < thresholds.lost < min(right)


def test_network_without_usable_depth_is_refused() -> None:
    sample = corner_samples(1, 0.0, 0.0, 0.0)[0]
    empty = replace(sample, depth=replace(sample.depth, depth_m=np.zeros_like(sample.depth.depth_m)))
    with pytest.raises(DataError, match=r"network: gives no usable depth on any of 1 frames; check output, metric"):
        calibrate_likelihood(likelihood_for, [empty], LocalizerConfig(), np.random.default_rng(0))


def test_likelihood_with_an_error_size_of_its_own_leaves_the_settings() -> None:
    base = LocalizerConfig(likelihood=LikelihoodConfig(log_depth_sd=0.11))

    class Constant:
        def mean_log_likelihood(
            self, poses: FloatArray, log_scale: FloatArray, scan: Scan, log_depth_sd: float | None = None
        ) -> FloatArray:
            return -np.abs(log_scale)

    samples = corner_samples(10, 0.0, 0.0, 0.0)
    found, _ = calibrate_likelihood(lambda _: Constant(), samples, base, np.random.default_rng(0))
    assert found.likelihood == base.likelihood
