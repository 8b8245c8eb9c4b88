"""Coverage, normalised errors and silent errors of poses drawn from known covariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from monoloc.evaluation.consistency import (
    CHI2_3_BEYOND_3_5_SIGMA,
    CHI2_6_QUANTILE_95,
    CHI2_6_QUANTILE_99,
    FAR_M,
    consistency,
)
from monoloc.geometry import FloatArray, se3_exp

EYE = np.eye(4)[None]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def sample(rng: np.random.Generator, frames: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Estimates, truths drawn from the covariances around them, and the covariances."""
    estimated = se3_exp(rng.normal(size=(frames, 6)))
    root = rng.normal(size=(6, 6)) * np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])[:, None]
    twists = rng.normal(size=(frames, 6)) @ root.T
    return estimated, estimated @ se3_exp(twists), np.tile(root @ root.T, (frames, 1, 1))


def test_limits_are_quantiles() -> None:
    assert pytest.approx(chi2.ppf(0.95, 6)) == CHI2_6_QUANTILE_95
    assert pytest.approx(chi2.ppf(0.99, 6)) == CHI2_6_QUANTILE_99
    assert chi2.sf(CHI2_3_BEYOND_3_5_SIGMA, 3) == pytest.approx(2.0 * norm.sf(3.5), rel=1e-5)


def test_true_covariance_covers_its_share(rng: np.random.Generator) -> None:
    estimated, truth, covariances = sample(rng, 4000)
    errors = consistency(estimated, truth, covariances)
    assert errors.coverage_95 == pytest.approx(0.95, abs=0.012)
    assert errors.coverage_99 == pytest.approx(0.99, abs=0.006)
    assert np.mean(errors.pose_nees) == pytest.approx(6.0, rel=0.05)
    assert np.mean(errors.position_nees) == pytest.approx(3.0, rel=0.05)
    assert np.mean(errors.is_beyond_covariance) < 0.002
    assert consistency(estimated, truth, 0.25 * covariances).coverage_95 < 0.6
    assert consistency(estimated, truth, 4.0 * covariances).coverage_95 > 0.999


def test_normalised_errors_do_not_depend_on_the_world_frame(rng: np.random.Generator) -> None:
    estimated, truth, covariances = sample(rng, 200)
    T_other_world = se3_exp(rng.normal(size=6))
    moved = consistency(T_other_world @ estimated, T_other_world @ truth, covariances)
    errors = consistency(estimated, truth, covariances)
    np.testing.assert_allclose(moved.pose_nees, errors.pose_nees, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(moved.position_nees, errors.position_nees, rtol=1e-6, atol=1e-9)


def test_order_is_translation_then_rotation() -> None:
    moved = se3_exp([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]])
    wide_translation = np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6])[None]
    assert consistency(EYE, moved, wide_translation).coverage_95 == 1.0
    assert consistency(EYE, moved, wide_translation[:, ::-1, ::-1]).coverage_95 == 0.0


def test_singular_covariance_covers_only_errors_in_its_plane() -> None:
    flat = np.diag([0.01, 0.01, 0.0, 0.01, 0.01, 0.01])[None]
    assert consistency(EYE, se3_exp([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]]), flat).coverage_95 == 1.0
    assert consistency(EYE, se3_exp([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]]), flat).coverage_95 == 0.0


def test_position_is_judged_by_its_distance_and_by_its_covariance() -> None:
    offsets = np.zeros((4, 6))
    offsets[:, 0] = 0.1, 0.2, FAR_M + 0.01, 0.0
    offsets[3, 3:] = 2.0  # turned, but in place
    sd_m = np.array([0.1, 0.02, 0.1, 0.1])
    covariances = np.stack([np.diag([sd**2] * 3 + [1e-4] * 3) for sd in sd_m])
    errors = consistency(np.tile(EYE, (4, 1, 1)), se3_exp(offsets), covariances)
    np.testing.assert_array_equal(errors.is_far, [False, False, True, False])
    np.testing.assert_array_equal(errors.is_beyond_covariance, [False, True, False, False])
    np.testing.assert_allclose(errors.position_nees, [1.0, 100.0, 9.61, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("covariances", "message"),
    [
        (np.eye(6), r"covariances must have shape \(1, 6, 6\), got \(6, 6\)"),
        (np.full((1, 6, 6), np.inf), "covariances must be finite"),
        (-np.eye(6)[None], "symmetric and positive semidefinite, got frame 0"),
        (np.triu(np.ones((6, 6)))[None], "symmetric and positive semidefinite, got frame 0"),
    ],
)
def test_invalid_covariances_are_refused(covariances: FloatArray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        consistency(EYE, EYE, covariances)
