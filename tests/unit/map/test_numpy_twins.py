"""The native kernels against their NumPy twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_helpers import make_mixture
from monoloc import _core
from monoloc.map import numpy_twins
from monoloc.map.mixture import GaussianMixture


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), st.integers(0, 70), st.integers(0, 10_000))
def test_log_density_equals_twin(components: int, count: int, seed: int) -> None:
    mixture = make_mixture(components, seed)
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, (count, 3))
    native = _core.log_density(points, mixture.weights, mixture.means, mixture.covariances)
    if count == 0:
        assert native.shape == (0,)
        return
    twin = numpy_twins.log_density(points, mixture.weights, mixture.means, mixture.covariances)
    np.testing.assert_allclose(native, twin, rtol=1e-10, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 40), st.integers(1, 70), st.integers(0, 10_000))
def test_expectation_equals_twin(components: int, count: int, seed: int) -> None:
    mixture = make_mixture(components, seed)
    points = mixture.sample(count, np.random.default_rng(seed))
    arguments = points, mixture.weights, mixture.means, mixture.covariances
    mass, first, second, log_likelihood = _core.expectation(*arguments)
    twin = numpy_twins.expectation(*arguments)
    np.testing.assert_allclose(mass, twin.mass, atol=1e-10)
    np.testing.assert_allclose(first, twin.first, atol=1e-10)
    np.testing.assert_allclose(second, twin.second[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]], atol=1e-10)
    assert log_likelihood == pytest.approx(twin.log_likelihood, rel=1e-12, abs=1e-9)


def test_far_points_and_zero_weights_give_finite_density() -> None:
    mixture = GaussianMixture(
        np.array([1.0, 0.0]), np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.tile(1e-4 * np.eye(3), (2, 1, 1))
    )
    values = mixture.log_density([[0.0, 0, 0], [50.0, 0, 0], [1.0, 0, 0]])
    twin = numpy_twins.log_density(
        np.array([[0.0, 0, 0], [50.0, 0, 0]]), mixture.weights, mixture.means, mixture.covariances
    )
    np.testing.assert_allclose(values[:2], twin, rtol=1e-12)
    assert np.isfinite(values).all()


def test_indefinite_covariance_is_refused() -> None:
    with pytest.raises(ValueError, match="covariance 0 is not positive definite"):
        _core.log_density(np.zeros((1, 3)), np.ones(1), np.zeros((1, 3)), -np.eye(3)[None])


def test_instruction_set_is_named() -> None:
    assert _core.instruction_set() in ("plain", "neon", "avx2", "avx512")
