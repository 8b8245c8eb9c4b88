"""Metrics of trajectories against evo, and properties of any metric."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc.evaluation.consistency import consistency
from monoloc.evaluation.trajectory import (
    PoseErrors,
    axis_sd,
    pose_errors,
    relative_pose_errors,
    summarise,
)
from monoloc.geometry import FloatArray, se3_exp

seeds = st.integers(0, 2**32 - 1)


def random_trajectory(rng: np.random.Generator, frames: int) -> FloatArray:
    poses = [se3_exp(rng.normal(size=6))]
    for _ in range(frames - 1):
        poses.append(poses[-1] @ se3_exp(0.1 * rng.normal(size=6)))
    return np.stack(poses)


def disturbed(rng: np.random.Generator, poses: FloatArray) -> FloatArray:
    return poses @ se3_exp(0.1 * rng.normal(size=(len(poses), 6)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


class TestPoseErrors:
    @pytest.mark.parametrize("frames", [1, 2, 50])
    def test_absolute_errors_are_those_of_evo(self, rng: np.random.Generator, frames: int) -> None:
        truth = random_trajectory(rng, frames)
        estimated = disturbed(rng, truth)
        errors = pose_errors(estimated, truth)
        for ours, relation in (
            (errors.position_m, evo_metrics.PoseRelation.translation_part),
            (errors.rotation_rad, evo_metrics.PoseRelation.rotation_angle_rad),
        ):
            ape = evo_metrics.APE(relation)
            ape.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimated))))
            np.testing.assert_allclose(ours, ape.error, atol=1e-7)

    @pytest.mark.parametrize("step", [1, 5, 39])
    def test_relative_errors_are_those_of_evo(self, rng: np.random.Generator, step: int) -> None:
        truth = random_trajectory(rng, 40)
        estimated = disturbed(rng, truth)
        errors = relative_pose_errors(estimated, truth, step)
        for ours, relation in (
            (errors.position_m, evo_metrics.PoseRelation.translation_part),
            (errors.rotation_rad, evo_metrics.PoseRelation.rotation_angle_rad),
        ):
            rpe = evo_metrics.RPE(relation, delta=step, delta_unit=evo_metrics.Unit.frames, all_pairs=True)
            rpe.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimated))))
            np.testing.assert_allclose(ours, rpe.error, atol=1e-7)

    def test_summary_is_that_of_evo(self, rng: np.random.Generator) -> None:
        truth = random_trajectory(rng, 60)
        estimated = disturbed(rng, truth)
        ours = summarise(estimated, truth)
        ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
        ape.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimated))))
        evo = ape.get_all_statistics()
        assert ours.ate_rmse_m == pytest.approx(evo["rmse"])
        assert ours.ate_median_m == pytest.approx(evo["median"])
        assert ours.ate_max_m == pytest.approx(evo["max"])
        ape = evo_metrics.APE(evo_metrics.PoseRelation.rotation_angle_deg)
        ape.process_data((PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimated))))
        assert ours.rot_rmse_deg == pytest.approx(ape.get_all_statistics()["rmse"])
        assert ours.rot_median_deg == pytest.approx(ape.get_all_statistics()["median"])

    def test_shares_count_frames_with_both_errors_within_their_bounds(self) -> None:
        twists = np.zeros((4, 6))
        twists[1, 0] = 0.04  # 4 cm: within both bounds
        twists[2, 1], twists[2, 3] = 0.04, math.radians(6.0)  # turned too far for the narrow bound
        twists[3, 2] = 0.2  # outside both
        summary = summarise(se3_exp(twists), np.tile(np.eye(4), (4, 1, 1)))
        assert (summary.within_5cm_5deg, summary.within_10cm_10deg) == (0.5, 0.75)
        assert summary.ate_max_m == pytest.approx(0.2)

    def test_offset_of_the_whole_trajectory_is_an_error(self, rng: np.random.Generator) -> None:
        truth = random_trajectory(rng, 20)
        shifted = truth.copy()
        shifted[:, 0, 3] += 1.0
        assert summarise(shifted, truth).ate_rmse_m == pytest.approx(1.0)

    @given(seed=seeds)
    @settings(max_examples=15, deadline=None)
    def test_identical_trajectories_have_no_error(self, seed: int) -> None:
        truth = random_trajectory(np.random.default_rng(seed), 5)
        summary = summarise(truth, truth)
        assert summary.ate_max_m == 0.0
        assert summary.rot_rmse_deg < 1e-6
        assert summary.within_5cm_5deg == 1.0

    @given(seed=seeds)
    @settings(max_examples=15, deadline=None)
    def test_errors_do_not_depend_on_the_world_frame(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        truth = random_trajectory(rng, 6)
        estimated = disturbed(rng, truth)
        T_other_world = se3_exp(rng.normal(size=6))
        errors, moved = (
            pose_errors(estimated, truth),
            pose_errors(T_other_world @ estimated, T_other_world @ truth),
        )
        np.testing.assert_allclose(errors.position_m, moved.position_m, atol=1e-9)
        np.testing.assert_allclose(errors.rotation_rad, moved.rotation_rad, atol=1e-7)
        relative = relative_pose_errors(T_other_world @ estimated, truth, 2)
        np.testing.assert_allclose(
            relative.position_m, relative_pose_errors(estimated, truth, 2).position_m, atol=1e-9
        )

    @pytest.mark.parametrize(
        ("estimated", "truth", "message"),
        [
            (np.eye(4), np.eye(4), r"truth must have shape \(N >= 1, 4, 4\), got \(4, 4\)"),
            (np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), r"truth must have shape .*got \(0, 4, 4\)"),
            (
                np.zeros((2, 4, 4)),
                np.zeros((3, 4, 4)),
                r"estimated must have shape \(3, 4, 4\), got \(2, 4, 4\)",
            ),
            (np.full((2, 4, 4), np.nan), np.zeros((2, 4, 4)), "estimated must be finite.* frame 0"),
        ],
    )
    def test_invalid_poses_are_refused(self, estimated: FloatArray, truth: FloatArray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            pose_errors(estimated, truth)

    @pytest.mark.parametrize("step", [0, 3])
    def test_step_outside_the_trajectory_is_refused(self, step: int) -> None:
        poses = np.tile(np.eye(4), (3, 1, 1))
        with pytest.raises(ValueError, match=r"step must lie in 1 \.\. 2"):
            relative_pose_errors(poses, poses, step)


class TestAxisSd:
    """Errors drawn from known covariances."""

    def test_standard_deviation_is_recovered_from_the_median(self, rng: np.random.Generator) -> None:
        # The standard error of the median of 4,000 lengths is under 2 % of it.
        twists = rng.standard_normal((4000, 6)) * np.repeat([0.04, 0.02], 3)
        truth = np.repeat(np.eye(4)[None], 4000, axis=0)
        sd_m, sd_rad = axis_sd(pose_errors(se3_exp(twists), truth))
        assert sd_m == pytest.approx(0.04, rel=0.04)
        assert sd_rad == pytest.approx(0.02, rel=0.04)
        covariances = np.repeat(np.diag([sd_m**2] * 3 + [sd_rad**2] * 3)[None], 4000, axis=0)
        assert consistency(se3_exp(twists), truth, covariances).coverage_95 == pytest.approx(0.95, abs=0.015)

    def test_a_tenth_of_outliers_has_little_influence(self, rng: np.random.Generator) -> None:
        twists = rng.standard_normal((1000, 6)) * 0.03
        twists[:100, :3] += 5.0
        truth = np.repeat(np.eye(4)[None], 1000, axis=0)
        assert axis_sd(pose_errors(se3_exp(twists), truth))[0] < 0.035

    def test_zero_errors_give_zero(self) -> None:
        assert axis_sd(PoseErrors(np.zeros(3), np.zeros(3))) == (0.0, 0.0)
