"""Expectation maximisation and its start."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.mixture import GaussianMixture as SklearnMixture

from map_helpers import make_mixture
from monoloc.errors import SettingError
from monoloc.map.em import (
    FLOOR_M,
    choose_components,
    clamp_covariances,
    fit_mixture,
    initial_mixture,
    maximise_likelihood,
)
from monoloc.map.mixture import GaussianMixture


def never_decreases(history: list[float]) -> bool:
    return bool(np.all(np.diff(history) >= -1e-9 * np.abs(history[:-1])))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30), st.sampled_from([0.001, 0.01, 0.1]))
def test_likelihood_never_decreases(seed: int, components: int, floor_m: float) -> None:
    rng = np.random.default_rng(seed)
    points = make_mixture(10, seed).sample(300, rng)
    start = initial_mixture(points, components, rng, floor_m)
    result = maximise_likelihood(points, start, floor_m, max_iterations=30, tolerance=1e-9)
    assert never_decreases(result.log_likelihood_history)
    assert result.log_likelihood_history[-1] == pytest.approx(result.mixture.log_density(points).sum())
    assert np.linalg.eigvalsh(result.mixture.covariances).min() >= floor_m**2 * (1.0 - 1e-9)
    assert result.mixture.weights.sum() == pytest.approx(1.0)


def test_same_start_gives_sklearns_likelihood() -> None:
    points = make_mixture(6).sample(1000, np.random.default_rng(0))
    start = initial_mixture(points, 6, np.random.default_rng(1), floor_m=1e-4)
    oracle = SklearnMixture(
        6,
        weights_init=start.weights,
        means_init=start.means,
        precisions_init=np.linalg.inv(start.covariances),
        reg_covar=1e-10,
        tol=1e-7,
        max_iter=500,
    ).fit(points)
    ours = maximise_likelihood(points, start, floor_m=1e-4, max_iterations=500, tolerance=1e-7)
    assert ours.converged
    mean = ours.log_likelihood_history[-1] / len(points)
    assert mean == pytest.approx(oracle.score(points), abs=1e-3)


def test_separated_clusters_are_recovered() -> None:
    rng = np.random.default_rng(0)
    centres = np.array([[0.0, 0, 0], [5.0, 0, 0], [0.0, 5, 0], [0.0, 0, 5]])
    points = np.concatenate([c + 0.1 * rng.normal(size=(200, 3)) for c in centres])
    mixture = fit_mixture(points, 4, rng).mixture
    distances = np.linalg.norm(mixture.means[:, None] - centres, axis=-1)
    assert sorted(distances.argmin(axis=1)) == [0, 1, 2, 3]
    assert distances.min(axis=1).max() < 0.03
    np.testing.assert_allclose(mixture.weights, 0.25, atol=1e-6)


def test_same_seed_gives_same_map() -> None:
    points = make_mixture(10).sample(1000, np.random.default_rng(0))
    first, second = (fit_mixture(points, 8, np.random.default_rng(3)).mixture for _ in range(2))
    np.testing.assert_array_equal(first.means, second.means)


def test_empty_components_are_reused() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(size=(500, 3)) * 0.1, rng.normal(size=(500, 3)) * 0.1 + 3.0])
    far = np.array([[0.0, 0, 0], [1000.0, 0, 0]])  # the second holds no point
    start = GaussianMixture(np.array([0.5, 0.5]), far, np.tile(np.eye(3), (2, 1, 1)))
    result = maximise_likelihood(points, start)
    assert never_decreases(result.log_likelihood_history)
    np.testing.assert_allclose(np.sort(result.mixture.means[:, 0]), [0.0, 3.0], atol=0.05)


def test_moved_component_that_lowers_the_likelihood_is_restored() -> None:
    # One tight Gaussian, and an empty component with nothing to explain.
    points = 0.05 * np.random.default_rng(0).normal(size=(50, 3))
    start = GaussianMixture(
        np.array([0.9, 0.1]), np.array([[0.0, 0, 0], [90.0, 0, 0]]), np.tile(np.eye(3), (2, 1, 1))
    )
    result = maximise_likelihood(points, start)
    assert never_decreases(result.log_likelihood_history)
    assert np.isfinite(result.mixture.means).all()


def test_duplicate_points_and_as_many_components_as_points() -> None:
    rng = np.random.default_rng(0)
    same = fit_mixture(np.ones((20, 3)), 5, rng).mixture
    np.testing.assert_allclose(same.means, 1.0)
    np.testing.assert_allclose(np.linalg.eigvalsh(same.covariances), FLOOR_M**2)
    assert len(fit_mixture(rng.normal(size=(6, 3)), 6, rng).mixture) == 6


def test_bic_finds_the_number_of_clusters() -> None:
    rng = np.random.default_rng(0)
    centres = rng.uniform(-5.0, 5.0, (6, 3))
    points = np.concatenate([c + 0.2 * rng.normal(size=(300, 3)) for c in centres])
    result, scores = choose_components(points, (2, 6, 20, 40), rng)
    assert len(result.mixture) == 6
    assert list(scores) == [2, 6, 20]  # stops once it rises
    assert scores[6] == min(scores.values()) == pytest.approx(result.bic(len(points)))


def test_clamp_raises_only_small_eigenvalues() -> None:
    clamped = clamp_covariances(np.diag([1e-8, 0.01, 1.0])[None], 0.01)
    np.testing.assert_allclose(clamped[0], np.diag([1e-4, 0.01, 1.0]))


def test_progress_reports_every_iteration() -> None:
    calls: list[tuple[int, float]] = []
    points = make_mixture(5).sample(200, np.random.default_rng(0))
    result = fit_mixture(points, 3, np.random.default_rng(0), progress=lambda i, mean: calls.append((i, mean)))
    assert [i for i, _ in calls] == list(range(1, result.iterations + 1))
    assert calls[-1][1] == pytest.approx(result.log_likelihood_history[-1] / 200)


def test_invalid_arguments_are_refused() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(10, 3))
    with pytest.raises(SettingError, match="components: is 11 for a cloud of 10 points"):
        fit_mixture(points, 11, rng)
    with pytest.raises(SettingError, match="components: is 0"):
        fit_mixture(points, 0, rng)
    with pytest.raises(SettingError, match=r"components: candidates \(25, 50\) exceed a cloud of 10 points"):
        choose_components(points, (25, 50), rng)
    with pytest.raises(SettingError, match="floor_m: is 0"):
        maximise_likelihood(points, make_mixture(2), floor_m=0.0)
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(10, 2\)"):
        fit_mixture(points[:, :2], 2, rng)
    with pytest.raises(ValueError, match="points must be finite"):
        fit_mixture(np.full((4, 3), np.nan), 2, rng)
