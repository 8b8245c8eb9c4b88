"""Growth of the error that landmarks have in common."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.builder.landmark_evidence import fit_common_error_growth
from monoloc.fusion.bias_model import LandmarkBiasModel
from monoloc.landmarks.pnp import LandmarkPose


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
