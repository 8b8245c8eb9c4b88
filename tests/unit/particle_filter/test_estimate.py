"""The weighted mean of particles, and its covariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.geometry import FloatArray, invert, make_pose, se3_exp, se3_log, so3_exp
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import scatter
from particle_helpers import particles_at, weight_vectors

POSE = make_pose(so3_exp([0.4, -1.1, 0.3]), [1.0, -2.0, 0.5])


@pytest.mark.parametrize("part", [slice(0, 3), slice(3, 6)])
@pytest.mark.parametrize("seed", range(3))
def test_mean_of_symmetric_perturbations_is_the_centre(part: slice, seed: int) -> None:
    twists = np.zeros((8, 6))
    twists[:, part] = np.random.default_rng(seed).normal(0.0, 0.3, (8, 3))
    belief = estimate(particles_at(POSE @ se3_exp(np.concatenate([twists, -twists]))))
    assert np.allclose(belief.pose, POSE, atol=1e-12)


def test_covariance_is_of_twists_in_the_estimated_cameras_frame() -> None:
    twists = np.zeros((4, 6))
    twists[0, 0], twists[1, 0] = 0.1, -0.1
    twists[2, 4], twists[3, 4] = 0.2, -0.2
    belief = estimate(particles_at(POSE @ se3_exp(twists), weights=[0.4, 0.4, 0.1, 0.1]))
    expected = np.zeros((6, 6))
    expected[0, 0], expected[4, 4] = 0.8 * 0.1**2, 0.2 * 0.2**2
    assert np.allclose(belief.covariance, expected, atol=1e-12)


def test_covariance_of_many_particles_is_that_which_they_were_drawn_from() -> None:
    belief = estimate(scatter(POSE, 20000, 0.1, 0.05, 0.02, np.random.default_rng(0)))
    assert np.allclose(belief.covariance, np.diag([0.01] * 3 + [0.0025] * 3), atol=4e-4)
    offset = se3_log(invert(POSE) @ belief.pose)
    assert np.all(np.abs(offset) < 5 * np.sqrt(np.diag(belief.covariance) / 20000))


def test_weights_count() -> None:
    far = make_pose(np.eye(3), [1.0, 0.0, 0.0])
    half = estimate(particles_at([np.eye(4), far], log_scale=[0.0, 0.4]))
    assert np.allclose(half.pose[:3, 3], [0.5, 0.0, 0.0])
    assert half.covariance[0, 0] == pytest.approx(0.25)
    assert half.log_scale == pytest.approx(0.2)
    quarter = estimate(particles_at([np.eye(4), far], log_scale=[0.0, 0.4], weights=[0.75, 0.25]))
    assert np.allclose(quarter.pose[:3, 3], [0.25, 0.0, 0.0])
    assert quarter.covariance[0, 0] == pytest.approx(0.75 * 0.25**2 + 0.25 * 0.75**2)
    assert quarter.log_scale == pytest.approx(0.1)
    rotated = estimate(particles_at([np.eye(4), se3_exp([0, 0, 0, 0, 0, 1.0])]))
    assert np.allclose(rotated.pose, se3_exp([0, 0, 0, 0, 0, 0.5]))


@given(weight_vectors, st.integers(0, 1000))
def test_pose_is_rigid_and_covariance_symmetric_and_positive(weights: FloatArray, seed: int) -> None:
    poses = se3_exp(np.random.default_rng(seed).normal(0.0, 0.4, (len(weights), 6)))
    belief = estimate(particles_at(poses, weights=weights))
    assert np.allclose(belief.pose[:3, :3].T @ belief.pose[:3, :3], np.eye(3))
    assert np.allclose(belief.covariance, belief.covariance.T)
    assert np.linalg.eigvalsh(belief.covariance)[0] > -1e-12


@pytest.mark.parametrize(("spread_m", "is_unknown"), [(0.49, False), (0.51, True)])
def test_position_is_unknown_by_its_least_certain_direction(spread_m: float, is_unknown: bool) -> None:
    axes = so3_exp([0.5, 0.4, -0.3])  # the least certain direction is no axis
    covariance = 1e-4 * np.eye(6)
    covariance[:3, :3] = axes @ np.diag([1e-4, spread_m**2, 1e-4]) @ axes.T
    belief = Estimate(POSE, covariance, 0.0)
    assert belief.position_sd_m == pytest.approx(spread_m)
    assert belief.position_is_unknown == is_unknown
