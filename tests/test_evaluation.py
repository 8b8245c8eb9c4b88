"""Metrics against evo and scikit-image, and what must hold of any metric."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PosePath3D
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import structural_similarity

from monoloc.evaluation.depth_metrics import DepthAccumulator, depth_metrics, depth_ssim, fit_scale
from monoloc.evaluation.trajectory import (
    PoseErrors,
    axis_sd,
    coverage_95,
    pose_errors,
    relative_pose_errors,
    summarise,
)
from monoloc.geometry import FloatArray, se3_exp
from monoloc.viz.run_drawing import norm_bound_95

seeds = st.integers(0, 2**32 - 1)


def random_walk(rng: np.random.Generator, frames: int) -> FloatArray:
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
        truth = random_walk(rng, frames)
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
        truth = random_walk(rng, 40)
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
        truth = random_walk(rng, 60)
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

    def test_shares_need_both_errors_within_their_bounds(self) -> None:
        twists = np.zeros((4, 6))
        twists[1, 0] = 0.04  # 4 cm: within both bounds
        twists[2, 1], twists[2, 3] = 0.04, math.radians(6.0)  # turned too far for the narrow bound
        twists[3, 2] = 0.2  # outside both
        summary = summarise(se3_exp(twists), np.tile(np.eye(4), (4, 1, 1)))
        assert (summary.within_5cm_5deg, summary.within_10cm_10deg) == (0.5, 0.75)
        assert summary.ate_max_m == pytest.approx(0.2)

    def test_an_offset_of_the_whole_trajectory_is_an_error(self, rng: np.random.Generator) -> None:
        truth = random_walk(rng, 20)
        shifted = truth.copy()
        shifted[:, 0, 3] += 1.0
        assert summarise(shifted, truth).ate_rmse_m == pytest.approx(1.0)

    @given(seed=seeds)
    @settings(max_examples=30, deadline=None)
    def test_identical_trajectories_have_no_error(self, seed: int) -> None:
        truth = random_walk(np.random.default_rng(seed), 5)
        summary = summarise(truth, truth)
        assert summary.ate_max_m == 0.0
        assert summary.rot_rmse_deg < 1e-6
        assert summary.within_5cm_5deg == 1.0

    @given(seed=seeds)
    @settings(max_examples=30, deadline=None)
    def test_errors_do_not_depend_on_the_choice_of_world(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        truth = random_walk(rng, 6)
        estimated = disturbed(rng, truth)
        T_other_world = se3_exp(rng.normal(size=6))
        here, there = (
            pose_errors(estimated, truth),
            pose_errors(T_other_world @ estimated, T_other_world @ truth),
        )
        np.testing.assert_allclose(here.position_m, there.position_m, atol=1e-9)
        np.testing.assert_allclose(here.rotation_rad, there.rotation_rad, atol=1e-7)
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
    def test_unusable_poses_are_refused(self, estimated: FloatArray, truth: FloatArray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            pose_errors(estimated, truth)

    @pytest.mark.parametrize("step", [0, 3])
    def test_a_step_outside_the_trajectory_is_refused(self, step: int) -> None:
        poses = np.tile(np.eye(4), (3, 1, 1))
        with pytest.raises(ValueError, match=r"step must lie in 1 \.\. 2"):
            relative_pose_errors(poses, poses, step)


class TestCoverage:
    def sample(self, rng: np.random.Generator, frames: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Estimates, truths drawn from the covariances around them, and the covariances."""
        estimated = random_walk(rng, frames)
        root = rng.normal(size=(6, 6)) * np.array([0.05, 0.05, 0.05, 0.02, 0.02, 0.02])[:, None]
        twists = rng.normal(size=(frames, 6)) @ root.T
        return estimated, estimated @ se3_exp(twists), np.tile(root @ root.T, (frames, 1, 1))

    def test_an_honest_covariance_covers_95_percent(self, rng: np.random.Generator) -> None:
        estimated, truth, covariances = self.sample(rng, 4000)
        assert coverage_95(estimated, truth, covariances) == pytest.approx(0.95, abs=0.012)
        assert coverage_95(estimated, truth, 0.25 * covariances) < 0.6
        assert coverage_95(estimated, truth, 4.0 * covariances) > 0.999

    def test_coverage_does_not_depend_on_the_choice_of_world(self, rng: np.random.Generator) -> None:
        estimated, truth, covariances = self.sample(rng, 200)
        T_other_world = se3_exp(rng.normal(size=6))
        there = coverage_95(T_other_world @ estimated, T_other_world @ truth, covariances)
        assert there == coverage_95(estimated, truth, covariances)

    def test_the_order_is_translation_then_rotation(self) -> None:
        eye, moved = np.eye(4)[None], se3_exp([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]])
        wide_translation = np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6])[None]
        assert coverage_95(eye, moved, wide_translation) == 1.0
        assert coverage_95(eye, moved, wide_translation[:, ::-1, ::-1]) == 0.0

    def test_a_flat_covariance_covers_only_errors_in_its_plane(self) -> None:
        flat = np.diag([0.01, 0.01, 0.0, 0.01, 0.01, 0.01])[None]
        eye = np.eye(4)[None]
        assert coverage_95(eye, se3_exp([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]]), flat) == 1.0
        assert coverage_95(eye, se3_exp([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0]]), flat) == 0.0

    @pytest.mark.parametrize(
        ("covariances", "message"),
        [
            (np.eye(6), r"covariances must have shape \(1, 6, 6\), got \(6, 6\)"),
            (np.full((1, 6, 6), np.inf), "covariances must be finite"),
            (-np.eye(6)[None], "symmetric and positive semidefinite, got frame 0"),
            (np.triu(np.ones((6, 6)))[None], "symmetric and positive semidefinite, got frame 0"),
        ],
    )
    def test_unusable_covariances_are_refused(self, covariances: FloatArray, message: str) -> None:
        with pytest.raises(ValueError, match=message):
            coverage_95(np.eye(4)[None], np.eye(4)[None], covariances)

    @pytest.mark.parametrize("spreads", [(1.0, 1.0, 1.0), (3.0, 1.0, 0.2), (1.0, 0.0, 0.0)])
    def test_the_bound_of_a_length_is_its_95_percent_quantile(
        self, rng: np.random.Generator, spreads: tuple[float, float, float]
    ) -> None:
        lengths = np.linalg.norm(rng.normal(size=(200_000, 3)) * spreads, axis=1)
        (bound,) = norm_bound_95(np.diag(spreads)[None] ** 2)
        assert bound == pytest.approx(np.quantile(lengths, 0.95), rel=0.03)

    def test_no_spread_means_a_bound_of_zero(self) -> None:
        assert norm_bound_95(np.zeros((1, 3, 3))) == [0.0]


class TestAxisSd:
    """Errors drawn from known covariances: what explains their medians is known too."""

    def test_it_explains_the_median(self, rng: np.random.Generator) -> None:
        # The standard error of the median of 4,000 lengths is under 2 % of it.
        twists = rng.standard_normal((4000, 6)) * np.repeat([0.04, 0.02], 3)
        truth = np.repeat(np.eye(4)[None], 4000, axis=0)
        sd_m, sd_rad = axis_sd(pose_errors(se3_exp(twists), truth))
        assert sd_m == pytest.approx(0.04, rel=0.04)
        assert sd_rad == pytest.approx(0.02, rel=0.04)
        honest = np.repeat(np.diag([sd_m**2] * 3 + [sd_rad**2] * 3)[None], 4000, axis=0)
        assert coverage_95(se3_exp(twists), truth, honest) == pytest.approx(0.95, abs=0.015)

    def test_a_few_frames_that_went_astray_do_not_decide(self, rng: np.random.Generator) -> None:
        twists = rng.standard_normal((1000, 6)) * 0.03
        twists[:100, :3] += 5.0
        truth = np.repeat(np.eye(4)[None], 1000, axis=0)
        assert axis_sd(pose_errors(se3_exp(twists), truth))[0] < 0.035

    def test_no_error_is_zero(self) -> None:
        assert axis_sd(PoseErrors(np.zeros(3), np.zeros(3))) == (0.0, 0.0)


def depth_pair(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    coarse = rng.uniform(1.0, 5.0, size=(6, 8))
    truth = np.kron(coarse, np.ones((10, 10))) + rng.uniform(0.0, 0.2, size=(60, 80))
    return truth * np.exp(0.2 * rng.normal(size=truth.shape)), truth


class TestDepthMetrics:
    def test_a_worked_example(self) -> None:
        truth = np.array([[1.0, 2.0, 4.0, 0.0, np.nan]])
        predicted = np.array([[1.1, 1.0, 4.0, 7.0, 7.0]])  # the last two pixels have no truth
        metrics = depth_metrics(predicted, truth)
        assert metrics.absrel == pytest.approx((0.1 + 0.5 + 0.0) / 3)
        assert (metrics.delta1, metrics.delta2, metrics.delta3) == pytest.approx((2 / 3, 2 / 3, 2 / 3))
        assert metrics.rmse_m == pytest.approx(math.sqrt((0.01 + 1.0) / 3))
        assert metrics.log10 == pytest.approx((math.log10(1.1) + math.log10(2.0)) / 3)
        assert metrics.ssim is None

    def test_a_perfect_prediction(self, rng: np.random.Generator) -> None:
        _, truth = depth_pair(rng)
        metrics = depth_metrics(truth, truth)
        assert (metrics.absrel, metrics.rmse_m, metrics.log10) == (0.0, 0.0, 0.0)
        assert (metrics.delta1, metrics.delta2, metrics.delta3) == (1.0, 1.0, 1.0)
        assert metrics.ssim == pytest.approx(1.0)

    @given(seed=seeds, scale=st.floats(0.1, 10.0))
    @settings(max_examples=20, deadline=None)
    def test_the_fitted_scale_undoes_a_scale(self, seed: int, scale: float) -> None:
        predicted, truth = depth_pair(np.random.default_rng(seed))
        assert fit_scale(scale * truth, truth) == pytest.approx(1.0 / scale)
        fitted = fit_scale(scale * predicted, truth) * scale * predicted
        assert depth_metrics(fitted, truth).absrel == pytest.approx(
            depth_metrics(fit_scale(predicted, truth) * predicted, truth).absrel
        )

    @pytest.mark.parametrize("measure", [depth_metrics, fit_scale])
    @pytest.mark.parametrize(
        ("predicted", "truth", "message"),
        [
            (np.ones((2, 3)), np.ones((3, 2)), r"predicted must have shape \(3, 2\), got \(2, 3\)"),
            (np.ones(3), np.ones(3), r"truth must have shape \(H, W\), got \(3,\)"),
            (np.ones((2, 2)), np.zeros((2, 2)), "truth must have a pixel"),
            (np.zeros((2, 2)), np.ones((2, 2)), "predicted must be finite and positive"),
            (np.full((2, 2), np.nan), np.ones((2, 2)), "predicted must be finite and positive"),
        ],
    )
    def test_unusable_images_are_refused(
        self, measure: Callable[..., object], predicted: FloatArray, truth: FloatArray, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            measure(predicted, truth)


class TestSsim:
    @pytest.mark.parametrize("data_range_m", [1.0, 10.0])
    @pytest.mark.parametrize("shape", [(60, 80), (11, 11), (37, 23)])
    def test_without_holes_it_is_scikit_images(
        self, rng: np.random.Generator, shape: tuple[int, int], data_range_m: float
    ) -> None:
        predicted, truth = (image[: shape[0], : shape[1]] for image in depth_pair(rng))
        expected = structural_similarity(
            predicted,
            truth,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=data_range_m,
        )
        ours = depth_ssim(predicted, truth, np.ones(shape, dtype=bool), data_range_m)
        assert ours == pytest.approx(expected, abs=1e-9)

    def test_what_stands_in_a_hole_does_not_matter(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        valid = np.ones(truth.shape, dtype=bool)
        valid[20:30, 30:50] = False
        without_numbers = np.where(valid, predicted, np.nan)
        expected = depth_ssim(predicted, truth, valid, 10.0)
        assert depth_ssim(without_numbers, np.where(valid, truth, -1e6), valid, 10.0) == expected

    def test_holes_leave_the_mean_over_whole_windows(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        valid = np.zeros(truth.shape, dtype=bool)
        valid[5:35, 7:60] = True
        block = (slice(5, 35), slice(7, 60))
        alone = depth_ssim(predicted[block], truth[block], valid[block], 10.0)
        assert depth_ssim(predicted, truth, valid, 10.0) == pytest.approx(alone)

    def test_it_is_undefined_where_no_window_is_whole(self) -> None:
        assert depth_ssim(np.ones((10, 40)), np.ones((10, 40)), np.ones((10, 40), dtype=bool), 10.0) is None

    def test_unusable_arguments_are_refused(self) -> None:
        image = np.ones((20, 20))
        with pytest.raises(ValueError, match=r"valid must have shape \(20, 20\), got \(3, 3\)"):
            depth_ssim(image, image, np.ones((3, 3), dtype=bool), 10.0)
        with pytest.raises(ValueError, match="data_range_m must be positive"):
            depth_ssim(image, image, image > 0.0, 0.0)


class TestDepthAccumulator:
    def test_it_averages_images_and_passes_over_those_without_truth(self, rng: np.random.Generator) -> None:
        pairs = [depth_pair(rng) for _ in range(3)]
        accumulator = DepthAccumulator()
        for predicted, truth in pairs:
            accumulator.add(predicted, truth)
        accumulator.add(pairs[0][0], np.zeros_like(pairs[0][1]))
        assert len(accumulator) == 3
        mean = accumulator.mean()
        each = [depth_metrics(predicted, truth) for predicted, truth in pairs]
        assert mean.absrel == pytest.approx(np.mean([m.absrel for m in each]))
        assert mean.ssim == pytest.approx(np.mean([m.ssim for m in each if m.ssim is not None]))

    def test_ssim_is_averaged_over_the_images_that_have_one(self, rng: np.random.Generator) -> None:
        predicted, truth = depth_pair(rng)
        speckled = truth.copy()
        speckled[::5, ::5] = 0.0
        accumulator = DepthAccumulator()
        accumulator.add(predicted, speckled)
        assert accumulator.mean().ssim is None
        accumulator.add(predicted, truth)
        assert accumulator.mean().ssim == pytest.approx(depth_metrics(predicted, truth).ssim)

    def test_nothing_has_no_mean(self) -> None:
        with pytest.raises(ValueError, match="no image with true depth"):
            DepthAccumulator().mean()
