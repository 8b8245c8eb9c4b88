"""Width of the landmarks' bias model."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.builder.landmark_evidence import fit_common_error_growth, widened
from monoloc.evaluation.trajectory import PoseErrors
from monoloc.fusion.bias_model import MOST_SD, BiasModel, LandmarkBiasModel
from monoloc.landmarks.pnp import LandmarkPose

NARROW = BiasModel(sd_at_reference_m=1e-4, sd_at_reference_rad=1e-4, sd_growth_m=1e-4, sd_growth_rad=1e-4)


def drawn(rng: np.random.Generator, sd_m: np.ndarray, sd_rad: np.ndarray) -> PoseErrors:
    sizes = (np.linalg.norm(rng.normal(size=(len(sd), 3)), axis=1) * sd for sd in (sd_m, sd_rad))
    return PoseErrors(*sizes)


def test_a_narrow_model_becomes_as_wide_as_errors_at_and_away_from_the_reference_poses() -> None:
    rng = np.random.default_rng(0)
    distances_m = rng.uniform(0.2, 0.6, 2000)
    at_reference = drawn(rng, np.full(2000, 0.005), np.full(2000, 0.004))
    away = drawn(rng, np.hypot(0.005, 0.06 * distances_m), np.hypot(0.004, 0.03 * distances_m))
    model = widened(NARROW, at_reference, away, distances_m)
    found = (model.sd_at_reference_m, model.sd_at_reference_rad, model.sd_growth_m, model.sd_growth_rad)
    assert found == pytest.approx((0.005, 0.004, 0.06, 0.03), rel=0.1)


def test_tails_at_the_reference_poses_do_not_widen_the_growth() -> None:
    rng = np.random.default_rng(1)
    far_off = drawn(rng, np.full(500, 0.02), np.full(500, 0.02))
    none = PoseErrors(np.zeros(0), np.zeros(0))
    model = widened(NARROW, far_off, none, np.zeros(0))
    assert model.sd_growth_m == NARROW.sd_growth_m and model.sd_growth_rad == NARROW.sd_growth_rad
    assert model.sd_at_reference_m == pytest.approx(0.02, rel=0.1)


def test_errors_of_any_size_give_a_model_that_a_bundle_may_state() -> None:
    near, far_off = PoseErrors(np.full(9, 0.01), np.full(9, 0.01)), PoseErrors(np.full(9, 20.0), np.full(9, 0.01))
    model = widened(NARROW, near, far_off, np.full(9, 0.05))
    assert BiasModel.model_validate(model.model_dump()).sd_growth_m == MOST_SD


@pytest.mark.parametrize("growth", [0.15, 1.0, 5.0])
def test_growth_of_the_common_error_is_found(growth: float) -> None:
    rng = np.random.default_rng(2)
    model = LandmarkBiasModel(common_error=0.03, common_error_growth=growth)
    shape = np.diag([0.2, 0.05, 0.03, 0.01, 0.1, 0.02]) ** 2
    distances_m = rng.uniform(0.0, 0.4, 400)
    poses = [LandmarkPose(np.eye(4), shape / 100, np.zeros((100, 3)))] * 400
    twists = np.stack([rng.multivariate_normal(np.zeros(6), model.covariance(poses[0], d)) for d in distances_m])
    assert fit_common_error_growth(twists, poses, distances_m, (1e-3, 1e-3)) == pytest.approx(growth, rel=0.5)


def test_without_errors_away_the_growth_of_other_rooms_is_taken() -> None:
    pose = LandmarkPose(np.eye(4), 1e-4 * np.eye(6), np.zeros((50, 3)))
    assert fit_common_error_growth(np.zeros((1, 6)), [pose], np.zeros(1), (0.01, 0.01)) == pytest.approx(1.0)
