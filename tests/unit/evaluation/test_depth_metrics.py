"""Metrics of depth images, with SSIM against scikit-image."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from monoloc.evaluation.depth_metrics import DepthAccumulator, depth_metrics, depth_ssim
from monoloc.geometry import FloatArray


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def depth_pair(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    coarse = rng.uniform(1.0, 5.0, size=(6, 8))
    truth = np.kron(coarse, np.ones((10, 10))) + rng.uniform(0.0, 0.2, size=(60, 80))
    return truth * np.exp(0.2 * rng.normal(size=truth.shape)), truth


class TestDepthMetrics:
    def test_metrics_of_a_worked_example(self) -> None:
        truth = np.array([[1.0, 2.0, 4.0, 0.0, np.nan]])
        predicted = np.array([[1.1, 1.0, 4.0, 7.0, 7.0]])  # the last two pixels have no truth
        metrics = depth_metrics(predicted, truth)
        assert metrics.absrel == pytest.approx((0.1 + 0.5 + 0.0) / 3)
        assert (metrics.delta1, metrics.delta2, metrics.delta3) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
        assert metrics.rmse_m == pytest.approx(math.sqrt((0.01 + 1.0) / 3))
        assert metrics.log10 == pytest.approx((math.log10(1.1) + math.log10(2.0)) / 3)
        assert metrics.ssim is None

    def test_metrics_of_a_perfect_prediction(self, rng: np.random.Generator) -> None:
        _, truth = depth_pair(rng)
        metrics = depth_metrics(truth, truth)
        assert (metrics.absrel, metrics.rmse_m, metrics.log10) == (0.0, 0.0, 0.0)
        assert (metrics.delta1, metrics.delta2, metrics.delta3) == (1.0, 1.0, 1.0)
        assert metrics.ssim == pytest.approx(1.0)

    @pytest.mark.parametrize(
        ("predicted", "truth", "message"),
        [
            (np.ones((2, 3)), np.ones((3, 2)), r"predicted must have shape \(3, 2\), got \(2, 3\)"),
            (np.ones(3), np.ones(3), r"truth must have shape \(H, W\), got \(3,\)"),
            (np.ones((2, 2)), np.zeros((2, 2)), "truth must have a pixel"),
            (np.zeros((2, 2)), np.ones((2, 2)), "predicted must be finite and positive"),
            (np.full((2, 2), np.nan), np.ones((2, 2)), "predicted must be finite and positive"),
        ],
    )
    def test_invalid_images_are_refused(self, predicted: FloatArray, truth: FloatArray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            depth_metrics(predicted, truth)


class TestSsim:
    @pytest.mark.parametrize("data_range_m", [1.0, 10.0])
    @pytest.mark.parametrize("shape", [(60, 80), (11, 11), (37, 23)])
    def test_ssim_without_holes_is_that_of_scikit_image(
        self, rng: np.random.Generator, shape: tuple[int, int], data_range_m: float
    ) -> None:
        predicted, truth = (image[: shape[0], : shape[1]] for image in depth_pair(rng))
        expected = structural_similarity(
            predicted,
            truth,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=data_range_m,
        )
        ours = depth_ssim(predicted, truth, np.ones(shape, dtype=bool), data_range_m)
        assert ours == pytest.approx(expected, abs=1e-9)

    def test_values_in_holes_are_ignored(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        valid = np.ones(truth.shape, dtype=bool)
        valid[20:30, 30:50] = False
        with_nans = np.where(valid, predicted, np.nan)
        expected = depth_ssim(predicted, truth, valid, 10.0)
        assert depth_ssim(with_nans, np.where(valid, truth, -1e6), valid, 10.0) == expected

    def test_ssim_with_holes_is_the_mean_over_whole_windows(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        valid = np.zeros(truth.shape, dtype=bool)
        valid[5:35, 7:60] = True
        block = (slice(5, 35), slice(7, 60))
        expected = depth_ssim(predicted[block], truth[block], valid[block], 10.0)
        assert depth_ssim(predicted, truth, valid, 10.0) == pytest.approx(expected)

    def test_ssim_without_a_whole_window_is_undefined(self) -> None:
        assert depth_ssim(np.ones((10, 40)), np.ones((10, 40)), np.ones((10, 40), dtype=bool), 10.0) is None

    def test_invalid_arguments_are_refused(self) -> None:
        image = np.ones((20, 20))
        with pytest.raises(ValueError, match=r"valid must have shape \(20, 20\), got \(3, 3\)"):
            depth_ssim(image, image, np.ones((3, 3), dtype=bool), 10.0)
        with pytest.raises(ValueError, match="data_range_m must be positive"):
            depth_ssim(image, image, image > 0.0, 0.0)


class TestDepthAccumulator:
    def test_mean_is_over_images_with_truth(self, rng: np.random.Generator) -> None:
        pairs = [depth_pair(rng) for _ in range(3)]
        accumulator = DepthAccumulator()
        for predicted, truth in pairs:
            accumulator.add(predicted, truth)
        accumulator.add(pairs[0][0], np.zeros_like(pairs[0][1]))
        assert len(accumulator) == 3
        mean = accumulator.mean()
        each = [depth_metrics(predicted, truth) for predicted, truth in pairs]
        assert mean.absrel == pytest.approx(np.mean([m.absrel for m in each]))
        assert mean.ssim == pytest.approx(np.mean([m.ssim for m in each if m.ssim is not None]))

    def test_ssim_is_averaged_over_the_images_that_have_one(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        speckled = truth.copy()
        speckled[::5, ::5] = 0.0
        accumulator = DepthAccumulator()
        accumulator.add(predicted, speckled)
        assert accumulator.mean().ssim is None
        accumulator.add(predicted, truth)
        assert accumulator.mean().ssim == pytest.approx(depth_metrics(predicted, truth).ssim)

    def test_mean_without_images_is_refused(self) -> None:
        with pytest.raises(ValueError, match="no image with true depth"):
            DepthAccumulator().mean()
