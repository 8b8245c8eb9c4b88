"""The error distribution of measured poses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_t

from monoloc.geometry import make_pose, so3_exp
from monoloc_lab.baselines.pose_error import PoseError
from synthetic_room import make_path


def test_fit_recovers_the_scales() -> None:
    """They were within 2 % over 20 seeds."""
    rng = np.random.default_rng(0)
    count = 5000
    # A multivariate t is a Gaussian over the root of a chi-squared variable.
    heavy = np.sqrt(4.0 / rng.chisquare(4.0, (count, 1)))
    offset, turn = heavy * rng.standard_normal((2, count, 3))
    truth = np.repeat(np.eye(4)[None], count, axis=0)
    error = PoseError.fit(make_pose(so3_exp(0.02 * turn), 0.05 * offset), truth)
    assert error.position_sd_m == pytest.approx(0.05, rel=0.04)
    assert error.rotation_sd_rad == pytest.approx(0.02, rel=0.04)


def test_one_outlier_hardly_widens_the_scales() -> None:
    rng = np.random.default_rng(0)
    offset, turn = 0.05 * rng.standard_normal((2, 40, 3))
    truth = np.repeat(np.eye(4)[None], 40, axis=0)
    without = PoseError.fit(make_pose(so3_exp(turn), offset), truth)
    offset[7] = 5.0
    assert PoseError.fit(make_pose(so3_exp(turn), offset), truth).position_sd_m < 1.2 * without.position_sd_m


def test_perfect_poses_have_a_positive_error() -> None:
    truth = make_path(5)
    error = PoseError.fit(truth, truth)
    assert error.position_sd_m > 0.0 and error.rotation_sd_rad > 0.0


def test_likelihood_is_a_multivariate_t() -> None:
    """SciPy's over offset and rotation vector, up to its constant."""
    rng = np.random.default_rng(0)
    error = PoseError(0.1, 0.05)
    offsets, turns = 0.2 * rng.standard_normal((6, 3)), 0.2 * rng.standard_normal((6, 3))
    measured = make_pose(so3_exp([0.3, 0.2, -0.5]), [1.0, 2.0, 3.0])
    poses = make_pose(measured[:3, :3] @ so3_exp(turns), measured[:3, 3] + offsets)
    got = error.log_likelihood(measured, poses)
    scale = np.diag(np.repeat([0.1**2, 0.05**2], 3))
    expected = multivariate_t(np.zeros(6), scale, df=4).logpdf(np.concatenate([offsets, turns], axis=1))
    np.testing.assert_allclose(got - got[0], expected - expected[0], atol=1e-9)
