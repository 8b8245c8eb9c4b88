"""Systematic resampling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.geometry import FloatArray, se3_exp
from monoloc.particle_filter.resampling import resample, systematic_indices
from particle_helpers import particles_at, weight_vectors


@given(weight_vectors, st.integers(0, 2**32 - 1))
def test_every_particle_is_drawn_floor_or_ceil_times(weights: FloatArray, seed: int) -> None:
    indices = systematic_indices(weights, np.random.default_rng(seed))
    drawn = np.bincount(indices, minlength=len(weights))
    expected = len(weights) * weights
    assert len(indices) == len(weights) == len(drawn)
    assert np.all(drawn >= np.floor(expected - 1e-9))
    assert np.all(drawn <= np.ceil(expected + 1e-9) * (weights > 0.0))


class _Largest(np.random.Generator):
    """A generator whose uniform number is the largest below 1."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def uniform(self, *_: object, **__: object) -> float:
        return np.nextafter(1.0, 0.0)


@pytest.mark.parametrize("weights", [np.full(10, 0.1), np.array([0.5, 0.5, 0.0]), np.full(500, 1 / 500)])
def test_last_position_that_rounds_up_draws_a_particle_with_weight(weights: FloatArray) -> None:
    # (u + N - 1) / N rounds to 1 here, beyond the sum of all weights.
    indices = systematic_indices(weights, _Largest())
    assert indices.max() < len(weights)
    assert np.all(weights[indices] > 0.0)


def test_systematic_resampling_is_unbiased() -> None:
    weights = np.array([0.35, 0.02, 0.0, 0.11, 0.3, 0.07, 0.15])
    rng = np.random.default_rng(0)
    drawn = np.mean([np.bincount(systematic_indices(weights, rng), minlength=7) for _ in range(4000)], axis=0)
    # A count is one of two neighbours, so its standard deviation is at most 1/2: five standard errors are 0.04.
    assert np.allclose(drawn, 7 * weights, atol=0.04)


def test_resampling_waits_until_weights_are_uneven() -> None:
    poses = se3_exp(np.random.default_rng(0).normal(size=(4, 6)))
    even = particles_at(poses, weights=[0.3, 0.2, 0.3, 0.2])
    assert resample(even, 0.5, np.random.default_rng(0)) is even
    uneven = particles_at(poses, log_scale=[0.0, 0.1, 0.2, 0.3], weights=[0.01, 0.01, 0.97, 0.01])
    result = resample(uneven, 0.5, np.random.default_rng(0))
    assert np.allclose(result.weights, 0.25)
    # Pose and scale stay together: nearly all are copies of the third.
    chosen = np.round(10 * result.log_scale).astype(int)
    assert np.all(result.poses == poses[chosen])
    assert np.count_nonzero(chosen == 2) >= 3


@pytest.mark.parametrize("count", [30, 90])
def test_resampling_to_another_number_keeps_the_mean(count: int) -> None:
    rng = np.random.default_rng(0)
    log_scale = rng.normal(size=60)
    weights = rng.dirichlet(np.ones(60))
    given = particles_at(se3_exp(rng.normal(size=(60, 6))), log_scale=log_scale, weights=weights)
    result = resample(given, 0.0, np.random.default_rng(1), count)
    assert len(result) == count and np.allclose(result.weights, 1.0 / count)
    drawn = np.bincount([int(np.argmin(abs(log_scale - value))) for value in result.log_scale], minlength=60)
    assert np.all(np.abs(drawn - count * weights) <= 1.0)
