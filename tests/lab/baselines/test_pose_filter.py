"""The filter of measured poses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_helpers import python
from monoloc.depth.predictor import DepthPredictor
from monoloc.evaluation.trajectory import pose_errors
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, make_pose, se3_exp, so3_exp
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.visual import VisualOdometry
from monoloc.particle_filter.motion_model import MotionConfig
from monoloc.particle_filter.particles import scatter
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.baselines.pose_filter import PoseFilter
from synthetic_room import CAMERA, FRAME_RATE_HZ, Room, RoomRecording, depth_from_blue, make_path

NO_NOISE = MotionConfig(translation_sd_m=1e-9, translation_sd_ratio=0.0, rotation_sd_rad=1e-9, rotation_sd_ratio=0.0)
UNINFORMATIVE = PoseError(position_sd_m=1e6, rotation_sd_rad=1e6)
ELAPSED_S = 1.0 / FRAME_RATE_HZ


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(20))


def poses_of(recording: RoomRecording) -> FloatArray:
    assert recording.poses is not None
    return recording.poses


def filtered(
    recording: RoomRecording,
    measured: FloatArray | None,
    error: PoseError,
    start: FloatArray,
    spread_m: float,
    noise: MotionConfig,
) -> FloatArray:
    """Estimates of all frames; ``measured`` has the measured poses, None for no measurement."""
    config = LocalizerConfig(particles=400, log_scale_sd=0.0, motion_noise=noise)
    rng = np.random.default_rng(0)
    rows = iter(measured if measured is not None else [])

    def measure(_: NDArray[np.uint8]) -> FloatArray | None:
        return next(rows, None)

    particles = scatter(start, config.particles, spread_m, 0.5 * spread_m, 0.0, rng)
    depth = DepthPredictor(depth_from_blue(), CAMERA)
    references = ReferencePoses.without_bias(poses_of(recording))
    pose_filter = PoseFilter(measure, error, depth, CAMERA, particles, config, references, rng)
    return np.stack([pose_filter.step(recording.color(i), ELAPSED_S).pose for i in range(len(recording))])


def dead_reckoning(recording: RoomRecording, start: FloatArray) -> FloatArray:
    depth, odometry = DepthPredictor(depth_from_blue(), CAMERA), VisualOdometry(CAMERA)
    pose, poses = start, []
    for index in range(len(recording)):
        predicted = depth(recording.color(index))
        motion = odometry.step(recording.color(index), predicted.depth_m, predicted.camera)
        pose = pose if motion is None else pose @ motion.T_previous_current
        poses.append(pose)
    return np.stack(poses)


def test_uninformative_poses_leave_the_odometry(recording: RoomRecording) -> None:
    nonsense = np.repeat(make_pose(so3_exp([1.0, 2.0, 0.5]), [9.0, -9.0, 9.0])[None], len(recording), axis=0)
    start = poses_of(recording)[0]
    expected = dead_reckoning(recording, start)
    for measured in (nonsense, None):
        found = filtered(recording, measured, UNINFORMATIVE, start, 0.0, NO_NOISE)
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_accurate_poses_correct_a_wrong_start(recording: RoomRecording) -> None:
    truth = poses_of(recording)
    start = truth[0] @ se3_exp(np.array([0.2, 0.0, 0.0, 0.0, 0.1, 0.0]))
    found = filtered(recording, truth, PoseError(0.02, 0.01), start, 0.15, MotionConfig())
    errors, odometry = pose_errors(found, truth), pose_errors(dead_reckoning(recording, start), truth)
    assert errors.position_m[-1] < 0.03 and errors.rotation_rad[-1] < 0.02
    assert odometry.position_m[-1] > 0.15 and odometry.rotation_rad[-1] > 0.08


def test_filter_smooths_noisy_poses(recording: RoomRecording) -> None:
    """Poses with 20 cm of noise, and accurate odometry."""
    truth = poses_of(recording)
    rng = np.random.default_rng(1)
    measured = truth @ se3_exp(rng.standard_normal((len(truth), 6)) * np.repeat([0.2, 0.1], 3))
    found = filtered(recording, measured, PoseError(0.2, 0.1), truth[0], 0.2, MotionConfig())
    raw, smooth = pose_errors(measured, truth), pose_errors(found, truth)
    assert np.median(smooth.position_m[10:]) < 0.4 * np.median(raw.position_m[10:])
    assert np.median(smooth.rotation_rad[10:]) < 0.4 * np.median(raw.rotation_rad[10:])


def test_baselines_without_network_need_no_torch() -> None:
    modules = "monoloc_lab.baselines.keypoints, monoloc_lab.baselines.pose_filter, monoloc_lab.baselines.pose_run"
    assert python(f"import sys, {modules}; sys.exit('torch' in sys.modules)").returncode == 0
