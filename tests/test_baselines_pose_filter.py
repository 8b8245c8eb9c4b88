"""Measured poses and their errors, and the filter that smooths them."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_t

from monoloc.depth.predictor import DepthPredictor
from monoloc.evaluation.trajectory import pose_errors
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose, se3_exp, so3_exp
from monoloc.localizer import LocalizerConfig
from monoloc.odometry.visual import VisualOdometry
from monoloc.particle_filter.motion_model import MotionConfig
from monoloc.particle_filter.particles import scatter
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.baselines.pose_filter import PoseFilter
from synthetic_room import CAMERA, FRAME_RATE_HZ, Room, RoomRecording, depth_from_blue, make_path

QUIET = MotionConfig(translation_sd_m=1e-9, translation_sd_ratio=0.0, rotation_sd_rad=1e-9, rotation_sd_ratio=0.0)
KNOWS_NOTHING = PoseError(position_sd_m=1e6, rotation_sd_rad=1e6)
ELAPSED_S = 1.0 / FRAME_RATE_HZ


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(25))


def poses_of(recording: RoomRecording) -> FloatArray:
    assert recording.poses is not None
    return recording.poses


def follow(
    recording: RoomRecording,
    measured: FloatArray | None,
    error: PoseError,
    start: FloatArray,
    spread_m: float,
    noise: MotionConfig,
) -> FloatArray:
    """Estimates of all frames, with the poses given as what is measured, or nothing."""
    config = LocalizerConfig(particles=400, log_scale_sd=0.0, motion_noise=noise)
    rng = np.random.default_rng(0)
    rows = iter(measured if measured is not None else [])

    def measure(_: NDArray[np.uint8]) -> FloatArray | None:
        return next(rows, None)

    particles = scatter(start, config.particles, spread_m, 0.5 * spread_m, 0.0, rng)
    depth = DepthPredictor(depth_from_blue(), CAMERA)
    follower = PoseFilter(
        measure, error, depth, CAMERA, particles, config, ReferencePoses.of(poses_of(recording)), rng
    )
    return np.stack([follower.step(recording.color(i), ELAPSED_S).pose for i in range(len(recording))])


def dead_reckoning(recording: RoomRecording, start: FloatArray) -> FloatArray:
    depth, odometry = DepthPredictor(depth_from_blue(), CAMERA), VisualOdometry(CAMERA)
    pose, poses = start, []
    for index in range(len(recording)):
        predicted = depth(recording.color(index))
        motion = odometry.step(recording.color(index), predicted.depth_m, predicted.camera)
        pose = pose if motion is None else pose @ motion.T_previous_current
        poses.append(pose)
    return np.stack(poses)


# --- The filter ---


def test_poses_that_say_nothing_leave_the_odometry(recording: RoomRecording) -> None:
    nonsense = np.repeat(make_pose(so3_exp([1.0, 2.0, 0.5]), [9.0, -9.0, 9.0])[None], len(recording), axis=0)
    start = poses_of(recording)[0]
    expected = dead_reckoning(recording, start)
    np.testing.assert_allclose(follow(recording, nonsense, KNOWS_NOTHING, start, 0.0, QUIET), expected, atol=1e-6)
    np.testing.assert_allclose(follow(recording, None, KNOWS_NOTHING, start, 0.0, QUIET), expected, atol=1e-6)


def test_poses_that_are_right_bring_a_wrong_start_back(recording: RoomRecording) -> None:
    truth = poses_of(recording)
    start = truth[0] @ se3_exp(np.array([0.2, 0.0, 0.0, 0.0, 0.1, 0.0]))
    found = follow(recording, truth, PoseError(0.02, 0.01), start, 0.15, MotionConfig())
    errors, alone = pose_errors(found, truth), pose_errors(dead_reckoning(recording, start), truth)
    assert errors.position_m[-1] < 0.03 and errors.rotation_rad[-1] < 0.02
    assert alone.position_m[-1] > 0.15 and alone.rotation_rad[-1] > 0.08


def test_filter_smooths_what_jumps(recording: RoomRecording) -> None:
    """Of poses with 20 cm of noise and good odometry, the filter makes some centimetres."""
    truth = poses_of(recording)
    rng = np.random.default_rng(1)
    measured = truth @ se3_exp(rng.standard_normal((len(truth), 6)) * np.repeat([0.2, 0.1], 3))
    found = follow(recording, measured, PoseError(0.2, 0.1), truth[0], 0.2, MotionConfig())
    raw, smooth = pose_errors(measured, truth), pose_errors(found, truth)
    assert np.median(smooth.position_m[10:]) < 0.4 * np.median(raw.position_m[10:])
    assert np.median(smooth.rotation_rad[10:]) < 0.4 * np.median(raw.rotation_rad[10:])


# --- The error ---


def poses_off_by(offset: FloatArray, turn: FloatArray) -> FloatArray:
    return make_pose(so3_exp(turn), offset)


def test_fit_finds_the_scales() -> None:
    """Over 20 seeds they were within 2 %."""
    rng = np.random.default_rng(0)
    count = 5000
    # A multivariate t is a Gaussian over the root of a chi-squared variable.
    heavy = np.sqrt(4.0 / rng.chisquare(4.0, (count, 1)))
    offset, turn = heavy * rng.standard_normal((2, count, 3))
    truth = np.repeat(np.eye(4)[None], count, axis=0)
    error = PoseError.fit(poses_off_by(0.05 * offset, 0.02 * turn), truth)
    assert error.position_sd_m == pytest.approx(0.05, rel=0.04)
    assert error.rotation_sd_rad == pytest.approx(0.02, rel=0.04)


def test_one_pose_that_is_far_off_hardly_widens_the_scales() -> None:
    rng = np.random.default_rng(0)
    offset, turn = 0.05 * rng.standard_normal((2, 40, 3))
    truth = np.repeat(np.eye(4)[None], 40, axis=0)
    without = PoseError.fit(poses_off_by(offset, turn), truth)
    offset[7] = 5.0
    assert PoseError.fit(poses_off_by(offset, turn), truth).position_sd_m < 1.2 * without.position_sd_m


def test_perfect_poses_have_an_error_still() -> None:
    truth = make_path(5)
    error = PoseError.fit(truth, truth)
    assert error.position_sd_m > 0.0 and error.rotation_sd_rad > 0.0


def test_likelihood_is_student_s() -> None:
    """SciPy's multivariate t over (offset, rotation vector), but for its constant."""
    rng = np.random.default_rng(0)
    error = PoseError(0.1, 0.05)
    offsets, turns = 0.2 * rng.standard_normal((6, 3)), 0.2 * rng.standard_normal((6, 3))
    measured = make_pose(so3_exp([0.3, 0.2, -0.5]), [1.0, 2.0, 3.0])
    poses = make_pose(measured[:3, :3] @ so3_exp(turns), measured[:3, 3] + offsets)
    got = error.log_likelihood(measured, poses)
    scale = np.diag(np.repeat([0.1**2, 0.05**2], 3))
    expected = multivariate_t(np.zeros(6), scale, df=4).logpdf(np.concatenate([offsets, turns], axis=1))
    np.testing.assert_allclose(got - got[0], expected - expected[0], atol=1e-9)


def test_what_needs_no_network_needs_no_torch() -> None:
    modules = "monoloc_lab.baselines.keypoints, monoloc_lab.baselines.pose_filter, monoloc_lab.baselines.pose_run"
    code = f"import sys, {modules}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
