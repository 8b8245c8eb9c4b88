"""Cloud-to-cloud distances, and the clouds of two maps that correspond."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from sklearn.neighbors import NearestNeighbors

from map_helpers import make_mixture
from monoloc.errors import MissingExtraError
from monoloc.evaluation.cloud_metrics import cloud_distances, matched_clouds, summarise_distances
from monoloc.geometry import FloatArray, so3_exp
from monoloc.map.mixture import GaussianMixture


def transformed(mixture: GaussianMixture, A: FloatArray, shift_m: FloatArray) -> GaussianMixture:
    covariances = A @ mixture.covariances @ A.T
    means = mixture.means @ A.T + shift_m
    return replace(mixture, means=means, covariances=0.5 * (covariances + covariances.swapaxes(-1, -2)))


@pytest.mark.parametrize("seed", range(2))
def test_distances_are_those_of_exhaustive_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, reference = rng.normal(size=(400, 3)), rng.normal(size=(300, 3)) * rng.uniform(0.1, 3.0, 3)
    ours = cloud_distances(points, reference)
    np.testing.assert_allclose(ours, np.linalg.norm(points[:, None] - reference, axis=2).min(axis=1), atol=1e-12)
    by_sklearn = NearestNeighbors(n_neighbors=1, algorithm="brute").fit(reference).kneighbors(points)[0][:, 0]
    np.testing.assert_allclose(ours, by_sklearn, atol=1e-6)


def test_grid_shifted_by_less_than_half_its_spacing_is_at_that_distance() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(0.0, 1.0, 0.1)] * 3), axis=-1).reshape(-1, 3)
    shift = np.array([0.02, -0.03, 0.01])
    np.testing.assert_allclose(cloud_distances(grid + shift, grid), np.linalg.norm(shift))


def test_only_the_shift_normal_to_a_plane_counts() -> None:
    plane = np.stack(np.meshgrid(np.arange(0.0, 2.0, 0.02), np.arange(0.0, 2.0, 0.02), [0.0]), axis=-1).reshape(-1, 3)
    inside = plane[(np.abs(plane[:, :2] - 1.0) < 0.5).all(axis=1)]
    np.testing.assert_allclose(cloud_distances(inside + np.array([0.0, 0.0, 0.25]), plane), 0.25)
    assert cloud_distances(inside + np.array([0.25, 0.0, 0.0]), plane).max() <= 0.01 + 1e-9


def test_distance_is_not_symmetric() -> None:
    """From the compared cloud to the reference, as in CloudCompare: missing points do not count."""
    whole = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    assert cloud_distances(whole[:1], whole).tolist() == [0.0]
    assert cloud_distances(whole, whole[:1]).tolist() == [0.0, 3.0]


def test_summary_is_median_95th_percentile_and_maximum() -> None:
    summary = summarise_distances(np.linspace(0.0, 1.0, 101))
    assert (summary.c2c_median_m, summary.c2c_p95_m, summary.c2c_max_m) == pytest.approx((0.5, 0.95, 1.0))


@pytest.mark.parametrize(
    ("points", "reference", "message"),
    [
        (np.zeros((2, 2)), np.zeros((2, 3)), r"points must have shape \(N, 3\)"),
        (np.zeros((2, 3)), np.full((2, 3), np.nan), "reference must be finite"),
        (np.zeros((2, 3)), np.zeros((0, 3)), "reference must have at least one point"),
    ],
)
def test_invalid_cloud_is_refused(points: FloatArray, reference: FloatArray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cloud_distances(points, reference)


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.spatial", None)
    with pytest.raises(MissingExtraError, match=r'comparing clouds needs the extra "report"'):
        cloud_distances(np.zeros((1, 3)), np.zeros((1, 3)))


def test_unchanged_map_gives_equal_clouds() -> None:
    original, adapted = matched_clouds(make_mixture(20), make_mixture(20), 500, np.random.default_rng(0))
    np.testing.assert_allclose(adapted, original, atol=1e-12)


def test_shifted_map_gives_a_shifted_cloud() -> None:
    mixture, shift = make_mixture(20), np.array([0.3, -0.1, 0.2])
    original, adapted = matched_clouds(mixture, transformed(mixture, np.eye(3), shift), 500, np.random.default_rng(0))
    np.testing.assert_allclose(adapted, original + shift, atol=1e-9)


def test_stretched_map_gives_a_stretched_cloud() -> None:
    """A symmetric positive definite map is its own optimal transport."""
    mixture = make_mixture(20)
    R = so3_exp([0.3, -0.2, 0.5])
    A = R @ np.diag([0.7, 1.1, 1.6]) @ R.T
    original, adapted = matched_clouds(mixture, transformed(mixture, A, np.zeros(3)), 500, np.random.default_rng(0))
    np.testing.assert_allclose(adapted, original @ A.T, atol=1e-9)


def test_clouds_have_the_moments_of_their_maps() -> None:
    """Whatever happened to the components; the tolerance is five standard errors."""
    mixture = make_mixture(3)
    other = replace(make_mixture(3, seed=7), weights=mixture.weights)
    for cloud, map_ in zip(
        matched_clouds(mixture, other, 200_000, np.random.default_rng(0)), (mixture, other), strict=True
    ):
        mean = map_.weights @ map_.means
        offsets = map_.means - mean
        covariance = np.einsum(
            "k,kij->ij", map_.weights, map_.covariances + offsets[:, :, None] * offsets[:, None, :]
        )
        scale = np.trace(covariance)
        np.testing.assert_allclose(cloud.mean(axis=0), mean, atol=5.0 * np.sqrt(scale / 200_000))
        np.testing.assert_allclose(np.cov(cloud.T), covariance, atol=5.0 * np.sqrt(2.0 / 200_000) * scale)


def test_maps_must_correspond() -> None:
    with pytest.raises(ValueError, match="maps must have the same components, got 3 and 4"):
        matched_clouds(make_mixture(3), make_mixture(4), 10, np.random.default_rng(0))
