"""The mixture: density, sampling, storage."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.mixture import GaussianMixture as SklearnMixture

from map_helpers import make_mixture
from monoloc.errors import DataError
from monoloc.geometry import so3_exp
from monoloc.map.mixture import GaussianMixture
from monoloc.map.numpy_twins import log_sum_exp, log_terms


def as_sklearn(mixture: GaussianMixture) -> SklearnMixture:
    """The same mixture in scikit-learn, not fitted."""
    oracle = SklearnMixture(len(mixture), covariance_type="full")
    oracle.weights_, oracle.means_, oracle.covariances_ = mixture.weights, mixture.means, mixture.covariances
    oracle.precisions_cholesky_ = np.linalg.cholesky(np.linalg.inv(mixture.covariances))
    return oracle


def test_density_and_responsibilities_equal_sklearn() -> None:
    mixture = make_mixture(30)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (500, 3))
    oracle = as_sklearn(mixture)
    np.testing.assert_allclose(mixture.log_density(points), oracle.score_samples(points), rtol=1e-9)
    np.testing.assert_allclose(mixture.responsibilities(points), oracle.predict_proba(points), atol=1e-10)


@pytest.mark.parametrize("count", [1, 4097, 40_001])
def test_responsibilities_in_blocks_equal_the_formula_and_need_little_memory(count: int) -> None:
    """To the last bit; all at once they take three times their own memory."""
    mixture = make_mixture(50)
    points = mixture.sample(count, np.random.default_rng(0))
    terms = log_terms(points, mixture.weights, mixture.means, mixture.covariances)
    expected = np.exp(terms - log_sum_exp(terms)[:, None])
    tracemalloc.start()
    found = mixture.responsibilities(points)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(found, expected)
    if count > 40_000:
        assert peak < 2 * found.nbytes


def test_density_integrates_to_one() -> None:
    mixture = make_mixture(8, extent_m=0.5)
    lower, upper = mixture.bounds_m(6.0)
    points = np.random.default_rng(0).uniform(lower, upper, (200_000, 3))
    values = np.exp(mixture.log_density(points)) * np.prod(upper - lower)
    assert values.mean() == pytest.approx(1.0, abs=4.0 * values.std() / np.sqrt(len(values)))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12))
def test_density_does_not_depend_on_the_frame(seed: int, components: int) -> None:
    rng = np.random.default_rng(seed)
    mixture = make_mixture(components, seed)
    R, t = so3_exp(rng.normal(size=3)), rng.normal(size=3)
    turned = R @ mixture.covariances @ R.T
    moved = GaussianMixture(mixture.weights, mixture.means @ R.T + t, 0.5 * (turned + turned.swapaxes(-1, -2)))
    points = mixture.sample(20, rng)
    np.testing.assert_allclose(moved.log_density(points @ R.T + t), mixture.log_density(points), atol=1e-7)


def test_samples_have_the_mixtures_moments() -> None:
    mixture = make_mixture(5)
    points = mixture.sample(200_000, np.random.default_rng(0))
    mean = mixture.weights @ mixture.means
    offsets = mixture.means - mean
    covariance = (
        np.einsum("k,kij->ij", mixture.weights, mixture.covariances)
        + (mixture.weights[:, None] * offsets).T @ offsets
    )
    np.testing.assert_allclose(points.mean(axis=0), mean, atol=0.02)
    np.testing.assert_allclose(np.cov(points.T), covariance, atol=0.02)


def test_bounds_and_volume_of_one_component() -> None:
    mixture = GaussianMixture(np.ones(1), np.array([[1.0, 2.0, 3.0]]), np.diag([0.01, 0.04, 0.09])[None])
    lower, upper = mixture.bounds_m(2.0)
    np.testing.assert_allclose(lower, [0.8, 1.6, 2.4])
    np.testing.assert_allclose(upper, [1.2, 2.4, 3.6])
    assert mixture.volume_m3 == pytest.approx(0.6 * 1.2 * 1.8)


def test_save_and_load(tmp_path: Path) -> None:
    mixture = make_mixture(200)
    path = tmp_path / "map.npz"
    mixture.save(path)
    loaded = GaussianMixture.load(path)
    np.testing.assert_allclose(loaded.weights, mixture.weights, rtol=1e-6)
    np.testing.assert_allclose(loaded.means, mixture.means, atol=1e-6)
    np.testing.assert_allclose(loaded.covariances, mixture.covariances, rtol=1e-4, atol=1e-8)
    assert mixture.nbytes_stored == 8000
    assert path.stat().st_size < mixture.nbytes_stored + 1000


def test_two_mixtures_share_a_file() -> None:
    first, second = make_mixture(3, 1), make_mixture(4, 2)
    arrays = {**first.to_arrays("original_"), **second.to_arrays("adapted_")}
    assert {array.dtype for array in arrays.values()} == {np.dtype(np.float32)}
    np.testing.assert_allclose(GaussianMixture.from_arrays(arrays, "adapted_").means, second.means, atol=1e-6)
    np.testing.assert_allclose(GaussianMixture.from_arrays(arrays, "original_").means, first.means, atol=1e-6)


def test_stored_covariances_of_needles_stay_positive_definite() -> None:
    # Condition number 1e10: stored as a float32 covariance it would not survive.
    R = so3_exp([0.3, -0.7, 0.4])
    covariance = R @ np.diag([1e-8, 1.0, 1e2]) @ R.T
    needle = GaussianMixture(np.ones(1), np.zeros((1, 3)), 0.5 * (covariance + covariance.T)[None])
    again = GaussianMixture.from_arrays(needle.to_arrays())
    assert np.linalg.eigvalsh(again.covariances[0])[0] > 0.0


ONE = {"weights": np.ones(1), "means": np.zeros((1, 3)), "covariances": np.eye(3)[None]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weights": np.ones((1, 1))}, r"weights must have shape \(N,\), got \(1, 1\)"),
        ({"weights": np.empty(0)}, "weights must have at least one component"),
        ({"weights": np.array([0.5])}, "weights must be >= 0 and sum to 1"),
        ({"means": np.zeros((2, 3))}, r"means must have shape \(1, 3\), got \(2, 3\)"),
        ({"means": np.full((1, 3), np.nan)}, "means must be finite, got 3 values that are not"),
        ({"covariances": np.eye(3)}, r"covariances must have shape \(1, 3, 3\), got \(3, 3\)"),
        ({"covariances": np.triu(np.ones((3, 3)))[None]}, "covariances must be symmetric"),
        ({"covariances": -np.eye(3)[None]}, "covariances must be positive definite, got component 0"),
    ],
)
def test_invalid_mixture_is_refused(changes: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GaussianMixture(**{**ONE, **changes})


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"absent\.npz: there is no such file"):
        GaussianMixture.load(tmp_path / "absent.npz")


def cut(path: Path) -> None:
    make_mixture(10).save(path)
    path.write_bytes(path.read_bytes()[:300])


def text(path: Path) -> None:
    path.write_text("not a map")


def pickled(path: Path) -> None:
    np.savez(path, weights=np.array([{}], dtype=object))


def bare_array(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


@pytest.mark.parametrize("write", [cut, text, pickled, bare_array])
def test_file_without_a_mixture_is_named(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = tmp_path / "map.npz"
    write(path)
    with pytest.raises(DataError, match=r"map\.npz: is no mixture map"):
        GaussianMixture.load(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"means": None}, "key 'means' is missing"),
        ({"weights": np.ones(2)}, "component counts differ: 2, 1, 1"),
        ({"weights": np.array([7.0])}, "weights must be >= 0 and sum to 1"),
        ({"cholesky": np.zeros((1, 6))}, "covariances must be positive definite"),
        ({"cholesky": np.zeros((1, 5))}, r"cholesky must have shape \(N, 6\), got \(1, 5\)"),
    ],
)
def test_invalid_stored_arrays_are_refused(changes: dict[str, np.ndarray | None], message: str) -> None:
    arrays = {**GaussianMixture(**ONE).to_arrays(), **changes}
    with pytest.raises(ValueError, match=message):
        GaussianMixture.from_arrays({name: array for name, array in arrays.items() if array is not None})
