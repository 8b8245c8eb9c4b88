"""Standard deviations of a bias at the reference poses and away from them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.landmarks.pnp import LandmarkPose

sizes = st.floats(0.0, 1.0)


@given(at_m=sizes, at_rad=sizes, growth_m=sizes, growth_rad=sizes, distance=st.floats(0.0, 5.0))
def test_variances_at_and_away_from_reference_poses_add(
    at_m: float, at_rad: float, growth_m: float, growth_rad: float, distance: float
) -> None:
    model = BiasModel(
        sd_at_reference_m=at_m, sd_at_reference_rad=at_rad, sd_growth_m=growth_m, sd_growth_rad=growth_rad
    )
    expected = [np.hypot(at_m, growth_m * distance)] * 3 + [np.hypot(at_rad, growth_rad * distance)] * 3
    np.testing.assert_allclose(model.sds(distance), expected, rtol=1e-12, atol=1e-15)


@given(first=sizes, second=sizes)
def test_correlations_over_two_steps_multiply(first: float, second: float) -> None:
    model = BiasModel()
    assert model.correlation(0.0) == 1.0 and model.correlation(first) <= 1.0
    assert model.correlation(first + second) == pytest.approx(model.correlation(first) * model.correlation(second))


def test_correlation_falls_to_one_over_e_in_70_centimetres() -> None:
    assert BiasModel().correlation(0.7) == pytest.approx(np.exp(-1.0))


@given(at=st.floats(0.01, 0.2), growth=sizes, distance=st.floats(0.0, 3.0))
def test_share_of_the_variance_at_reference_poses(at: float, growth: float, distance: float) -> None:
    model = BiasModel(sd_at_reference_m=at, sd_at_reference_rad=0.01, sd_growth_m=growth)
    expected = at**2 / (at**2 + (growth * distance) ** 2)
    np.testing.assert_allclose(model.reference_variance_share(distance), [expected] * 3 + [1.0] * 3, atol=1e-12)


def test_share_without_any_variance_is_one() -> None:
    np.testing.assert_array_equal(BiasModel().reference_variance_share(1.0), np.ones(6))
    assert BiasModel(sd_growth_m=0.1).reference_variance_share(1.0)[0] == 0.0


def test_relocalization_widens_and_never_narrows() -> None:
    model = BiasModel(
        sd_at_reference_m=0.1,
        sd_at_reference_rad=0.1,
        sd_growth_m=0.5,
        relocalization_sd_m=0.3,
        relocalization_sd_rad=0.05,
    )
    np.testing.assert_array_equal(model.relocalization_sds(0.0), [0.3] * 3 + [0.1] * 3)
    np.testing.assert_array_equal(model.relocalization_sds(4.0), model.sds(4.0))


def test_errors_that_landmarks_have_in_common_do_not_average_out_and_keep_the_shape_of_the_view() -> None:
    shape = np.diag([4.0, 1.0, 1.0, 0.1, 2.0, 0.1])
    model = LandmarkBiasModel(common_error=0.03, common_error_growth=1.0)

    def stated(count: int, distance_m: float) -> np.ndarray:
        measured = LandmarkPose(np.eye(4), shape / count, np.zeros((count, 3)))  # as the corners' error alone
        return model.covariance(measured, distance_m)

    np.testing.assert_allclose(stated(20, 0.0), shape / 20)
    np.testing.assert_allclose(stated(500, 0.0), 0.03 * shape)
    np.testing.assert_allclose(stated(500, 0.3), (0.03 + 0.09) * shape)
    np.testing.assert_allclose(stated(100, 4.0), stated(100, 0.5))  # farther, growth was not measured


def test_other_poses_that_landmarks_allow_widen_the_covariance_by_their_likelihood() -> None:
    rivals = np.array([[0.1, 0.0, 0.0, 0.0, 0.2, 0.0], [0.0, 0.3, 0.0, 0.0, 0.0, 0.0]])
    measured = LandmarkPose(
        np.eye(4), 1e-6 * np.eye(6), np.zeros((100, 3)), rivals=rivals, rival_nats=np.array([0.0, 1e3])
    )
    stated = LandmarkBiasModel(common_error=0.01).covariance(measured, 0.0)
    # One other pose is as likely: half of its squared distance, as of a mixture about the first. The second is not.
    np.testing.assert_allclose(stated, 1e-6 * np.eye(6) + 0.5 * np.outer(rivals[0], rivals[0]), atol=1e-12)


def test_errors_in_common_make_other_poses_more_likely() -> None:
    """A hundred landmarks that err alike count as 25: 4 nats of theirs are one."""
    rivals = np.array([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]])
    measured = LandmarkPose(
        np.eye(4), np.zeros((6, 6)), np.zeros((100, 3)), rivals=rivals, rival_nats=np.array([4.0])
    )
    stated = LandmarkBiasModel(common_error=0.04).covariance(measured, 0.0)
    assert stated[0, 0] == pytest.approx(0.01 * np.exp(-1.0) / (1.0 + np.exp(-1.0)))


def test_landmarks_of_bundles_without_a_measured_noise_count_as_twenty() -> None:
    measured = LandmarkPose(np.eye(4), np.eye(6), np.zeros((100, 3)))
    np.testing.assert_allclose(LandmarkBiasModel().covariance(measured, 1.0), 5.0 * np.eye(6))
