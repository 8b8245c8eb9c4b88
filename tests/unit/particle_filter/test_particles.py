"""Particles, and how they are scattered."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from monoloc.geometry import FloatArray, invert, make_pose, se3_log, so3_exp
from monoloc.particle_filter.particles import normalised, scatter
from particle_helpers import particles_at, weight_vectors

POSE = make_pose(so3_exp([0.4, -1.1, 0.3]), [1.0, -2.0, 0.5])


def test_scatter_has_the_given_spread() -> None:
    particles = scatter(POSE, 20000, 0.2, 0.1, 0.07, np.random.default_rng(0))
    twists = se3_log(invert(POSE) @ particles.poses)
    # The standard error of a standard deviation is sd / sqrt(2 N), here 0.5 %.
    assert np.allclose(twists.std(axis=0), [0.2] * 3 + [0.1] * 3, rtol=0.025)
    assert np.all(np.abs(twists.mean(axis=0)) < 5 * twists.std(axis=0) / np.sqrt(20000))
    correlation = np.corrcoef(np.column_stack([twists, particles.log_scale]).T) - np.eye(7)
    assert np.abs(correlation).max() < 0.04
    assert particles.log_scale.std() == pytest.approx(0.07, rel=0.025)
    assert np.allclose(particles.weights, 1.0 / 20000)


def test_scatter_without_spread_is_the_pose() -> None:
    particles = scatter(POSE, 5, 0.0, 0.0, 0.0, np.random.default_rng(0))
    assert np.allclose(particles.poses, POSE)
    assert np.all(particles.log_scale == 0.0)


@given(arrays(np.float64, st.integers(1, 50), elements=st.floats(-1e5, 1e5)))
def test_normalised_weights_sum_to_one_with_the_same_ratios(log_weights: FloatArray) -> None:
    result = normalised(log_weights)
    assert np.exp(result).sum() == pytest.approx(1.0)
    assert np.allclose(result - result[0], log_weights - log_weights[0], atol=1e-9)


def test_normalised_accepts_impossible_particles() -> None:
    assert np.allclose(np.exp(normalised(np.array([-np.inf, 0.0, np.log(3.0)]))), [0.0, 0.25, 0.75])


@given(weight_vectors)
def test_effective_sample_size_lies_between_one_and_the_count(weights: FloatArray) -> None:
    particles = particles_at(np.tile(np.eye(4), (len(weights), 1, 1)), weights=weights)
    assert 1.0 - 1e-9 <= particles.effective_sample_size <= len(weights) * (1.0 + 1e-9)


@pytest.mark.parametrize("equal", [1, 4, 10])
def test_effective_sample_size_counts_equal_weights(equal: int) -> None:
    weights = np.where(np.arange(10) < equal, 1.0 / equal, 1e-300)
    particles = particles_at(np.tile(np.eye(4), (10, 1, 1)), weights=weights)
    assert particles.effective_sample_size == pytest.approx(equal)
