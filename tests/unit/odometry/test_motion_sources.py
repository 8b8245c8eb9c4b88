"""Motion between two times of capture by sensors with clock rates of their own: frames, delays and dropouts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from monoloc.geometry import FloatArray, invert, is_rigid, se3_exp, se3_log, so3_exp, so3_log
from monoloc.odometry.attitude import AttitudeHistory
from monoloc.odometry.external import ExternalNoise, ExternalOdometry
from monoloc.odometry.gyroscope import Gyroscope
from monoloc.odometry.motion import Motion, MotionSource, chained, motions_between
from monoloc.odometry.pose_history import PoseHistory

RATE = np.array([0.4, -1.1, 0.7])  # rad/s
R_BODY_CAMERA = so3_exp([0.3, -1.2, 2.0])
START = so3_exp([0.5, 0.1, -0.9])


def attitude_at(time_s: float) -> FloatArray:
    """Of a body that turns at :data:`RATE`, in its own axes."""
    return np.asarray(START @ so3_exp(RATE * time_s))


def gyroscope(times_s: FloatArray) -> Gyroscope:
    made = Gyroscope(R_BODY_CAMERA.T)
    for time_s in times_s:
        made.add(time_s, RATE)
    return made


def attitudes(times_s: FloatArray) -> AttitudeHistory:
    made = AttitudeHistory(R_BODY_CAMERA)
    for time_s in times_s:
        made.add(time_s, attitude_at(time_s))
    return made


@pytest.mark.parametrize(("make", "rate_hz"), [(gyroscope, 100.0), (attitudes, 20.0)])
@pytest.mark.parametrize("start_s", [5.003, 5.0, 5.9])
def test_constant_turn_is_exact_at_any_times_and_seen_from_the_camera(
    make: Callable[[FloatArray], MotionSource], rate_hz: float, start_s: float
) -> None:
    source = make(5.0 + np.arange(int(2.0 * rate_hz)) / rate_hz)
    motion = source.between(start_s, start_s + 0.333)
    assert motion is not None and motion.translation == "unknown"
    rotation = motion.T_previous_current[:3, :3]
    np.testing.assert_allclose(so3_log(rotation), 0.333 * R_BODY_CAMERA.T @ RATE, atol=1e-9)
    assert np.all(motion.T_previous_current[:3, 3] == 0.0)
    assert source.between(start_s + 0.333, start_s) is None  # time does not run backwards


def test_gyroscope_whose_rate_changes_is_integrated_to_the_second_order() -> None:
    """A turn about an axis that sways: at 200 Hz the error of half a second is far below the stated noise."""
    made = Gyroscope()
    times_s = np.arange(0.0, 2.0, 1.0 / 200.0)
    for time_s in times_s:
        made.add(time_s, [np.sin(6.0 * time_s), 0.0, 0.0])
    motion = made.between(0.3, 0.8)
    assert motion is not None and motion.rotation_sd_rad is not None
    expected = (np.cos(6.0 * 0.3) - np.cos(6.0 * 0.8)) / 6.0
    assert so3_log(motion.T_previous_current[:3, :3])[0] == pytest.approx(expected, abs=1e-4)
    assert motion.rotation_sd_rad == pytest.approx(np.hypot(0.01 * 0.5, 0.02 * abs(expected)), rel=1e-2)


def test_noise_of_a_gyroscope_grows_with_time_and_turn() -> None:
    still, turning = Gyroscope(sd_rad_s=0.02), Gyroscope(sd_rad_s=0.02)
    for index in range(101):
        still.add(0.01 * index, np.zeros(3))
        turning.add(0.01 * index, [0.0, 2.0, 0.0])
    sds = [source.between(0.2, 0.7) for source in (still, turning)]
    assert [motion.rotation_sd_rad for motion in sds if motion] == pytest.approx([0.01, np.hypot(0.01, 0.02)])


def pose_at(time_s: float) -> FloatArray:
    """Of a body on a screw: constant twist."""
    return se3_exp([0.1, 0.2, -0.3, 0.2, 0.1, 0.4]) @ se3_exp(time_s * np.array([0.5, 0.1, -0.2, 0.3, -0.2, 0.6]))


def test_external_odometry_is_of_the_camera_and_of_the_time_before_the_delay() -> None:
    T_body_camera = se3_exp([0.1, -0.05, 0.02, 0.4, -1.0, 0.3])
    source = ExternalOdometry(T_body_camera, delay_s=0.08)
    for time_s in np.arange(0.0, 2.0, 0.05):
        source.add(time_s + 0.08, pose_at(time_s))
    motion = source.between(0.512, 0.634)
    expected = invert(pose_at(0.512) @ T_body_camera) @ pose_at(0.634) @ T_body_camera
    assert motion is not None and motion.translation == "metric"
    np.testing.assert_allclose(motion.T_previous_current, expected, atol=1e-9)
    assert source.between(-0.05, 0.1) is None  # stamps begin at 0.08, samples at 0


def test_noise_of_external_odometry_is_a_share_of_the_motion_and_a_floor() -> None:
    noise = ExternalNoise(0.003, 0.1, 0.004, 0.05)
    source = ExternalOdometry(noise=noise, max_gap_s=1.0)
    source.add(0.0, np.eye(4))
    source.add(1.0, se3_exp([0.0, 0.0, 0.4, 0.0, 0.0, 0.0]))
    motion = source.between(0.0, 0.5)
    assert motion is not None
    assert motion.translation_sd_m == pytest.approx(np.hypot(0.003, 0.02))
    assert motion.rotation_sd_rad == pytest.approx(0.004)


def test_dropout_before_between_or_after_two_times_leaves_the_motion_unknown() -> None:
    history = PoseHistory(max_gap_s=0.1)
    assert history.newest is None and history.between(0.0, 0.1) is None
    for time_s in (0.0, 0.1, 0.2, 0.5, 0.6):
        history.add(time_s, pose_at(time_s))
    assert history.between(0.0, 0.2) is not None and history.between(0.5, 0.6) is not None
    for start_s, end_s in ((0.1, 0.3), (0.3, 0.4), (0.15, 0.55), (0.4, 0.6), (-0.01, 0.1)):
        assert history.between(start_s, end_s) is None, (start_s, end_s)
    # The newest velocity lasts for half a gap.
    ahead = history.between(0.5, 0.645)
    assert ahead is not None and history.between(0.5, 0.66) is None
    np.testing.assert_allclose(ahead, invert(pose_at(0.5)) @ pose_at(0.645), atol=1e-9)


def test_velocity_that_lasts_beyond_the_samples_is_not_that_of_two_stamps_that_nearly_coincide() -> None:
    """A clock that is followed by the quickest message steps back, by up to the time between two."""

    def history(*times_s: float) -> PoseHistory:
        made = PoseHistory(0.25)
        for index, time_s in enumerate(times_s):
            made.add(time_s, se3_exp([0.01 * index, 0.0, 0.0, 0.0, 0.0, 0.0]))
        return made

    moved = history(0.0, 0.02, 0.04, 0.06, 0.0601).between(0.0, 0.16)
    assert moved is not None and 0.06 < moved[0, 3] < 0.16  # in truth 0.09; by the last two stamps ten metres
    assert history(0.0, 1.0, 1.0001).between(1.0, 1.1) is None  # no velocity since the dropout


def test_attitude_that_comes_seldom_or_jumps_tells_nothing() -> None:
    assert attitudes(np.arange(0.0, 2.0, 0.11)).between(0.5, 0.6) is not None
    assert attitudes(np.arange(0.0, 2.0, 0.13)).between(0.5, 0.6) is None
    jumping = AttitudeHistory()
    for index in range(20):
        jumping.add(0.05 * index, so3_exp([0.0, 0.0, 0.0 if index < 10 else 1.0]))
    assert jumping.between(0.42, 0.52) is None and jumping.between(0.52, 0.62) is not None


def test_old_samples_are_forgotten() -> None:
    history = PoseHistory(max_gap_s=1.5, memory_s=10.0)
    for index in range(100):
        history.add(float(index), np.eye(4))
    assert history.between(89.0, 90.0) is not None and history.between(78.0, 79.0) is None


def test_bad_samples_are_refused_and_change_nothing() -> None:
    source, history = Gyroscope(), PoseHistory(1.0)
    source.add(1.0, RATE)
    history.add(1.0, np.eye(4))
    for refused, problem in (
        (lambda: source.add(1.0, RATE), "a sample of 1.000000 s came after one of 1.000000 s"),
        (lambda: source.add(0.5, RATE), "a sample of 0.500000 s came after one of 1.000000 s"),
        (lambda: source.add(1.1, [0.0, np.nan, 0.0]), "three finite numbers"),
        (lambda: history.add(np.nan, np.eye(4)), "must be finite"),
        (lambda: history.add(1.1, 2.0 * np.eye(4)), r"the pose at 1.100000 s must be rigid"),
    ):
        with pytest.raises(ValueError, match=problem):
            refused()
    source.add(1.01, RATE)
    motion = source.between(1.0, 1.01)
    assert motion is not None
    np.testing.assert_allclose(so3_log(motion.T_previous_current[:3, :3]), 0.01 * RATE, atol=1e-9)


def test_arguments_that_are_none_are_refused() -> None:
    for refused, problem in (
        (lambda: Gyroscope(2.0 * np.eye(3)), "R_camera_sensor"),
        (lambda: Gyroscope(sd_rad_s=0.0), "sd_rad_s"),
        (lambda: AttitudeHistory(np.zeros((3, 3))), "R_body_camera"),
        (lambda: ExternalOdometry(np.zeros((4, 4))), "T_body_camera"),
        (lambda: ExternalOdometry(delay_s=np.inf), "delay_s"),
        (lambda: PoseHistory(0.0), "max_gap_s"),
        (lambda: Motion.metric(np.eye(3), 0.1, 0.1), "rigid pose"),
        (lambda: Motion.metric(np.eye(4), 0.0, 0.1), "standard deviations"),
        (lambda: Motion.rotation(np.eye(4), 0.1), "rotation matrix"),
        (lambda: Motion.rotation(np.eye(3), np.inf), "rotation_sd_rad"),
    ):
        with pytest.raises(ValueError, match=problem):
            refused()


def test_motions_one_after_another_are_one_with_their_noise() -> None:
    first, second = se3_exp([0.1, 0.0, 0.2, 0.0, 0.3, 0.0]), se3_exp([0.0, 0.1, 0.1, 0.2, 0.0, 0.1])
    both = chained([Motion.metric(first, 0.03, 0.003), Motion.metric(second, 0.04, 0.004)])
    assert both is not None and both.translation == "metric"
    np.testing.assert_allclose(both.T_previous_current, first @ second)
    assert both.translation_sd_m == pytest.approx(0.05) and both.rotation_sd_rad == pytest.approx(0.005)
    mixed = chained([Motion.metric(first, 0.03, 0.003), Motion.rotation(second[:3, :3], 0.004)])
    assert mixed is not None and mixed.translation == "unknown" and mixed.rotation_sd_rad == pytest.approx(0.005)
    np.testing.assert_allclose(se3_log(mixed.T_previous_current)[:3], 0.0)
    assert chained([]) is None and chained([None, both]) is None and chained([both]) is both


def test_motion_from_rounded_rotations_is_exactly_rigid_and_does_not_change_with_the_callers_array() -> None:
    """A sensor's matrices have few digits; a belief is moved by thousands of motions, one after another."""
    given = se3_exp([0.1, 0.0, 0.2, 0.0, 0.3, 0.0])
    given[:3, :3] *= 1.00045  # as imprecise as is accepted
    source = ExternalOdometry()
    for index in range(3):
        source.add(0.1 * index, given)
    motions = [Motion.metric(given, 0.01, 0.01), Motion.rotation(given[:3, :3], 0.01), source.between(0.02, 0.15)]
    given[:] = 0.0
    assert all(motion is not None and is_rigid(motion.T_previous_current, 1e-12) for motion in motions)
    exact = se3_exp([0.1, 0.0, 0.2, 0.0, 0.3, 0.0])
    np.testing.assert_array_equal(Motion.metric(exact, 0.01, 0.01).T_previous_current, exact)  # as in a recording


def test_motions_between_frames_are_of_the_first_source_that_tells_them() -> None:
    poses, rates = ExternalOdometry(max_gap_s=0.2), Gyroscope()
    for index in range(5):
        poses.add(0.1 * index, np.eye(4))
    for index in range(100):
        rates.add(0.01 * index, RATE)
    motions = motions_between(np.array([0.0, 0.2, 0.4, 0.8, 1.6]), [poses, rates])
    kinds = [None if motion is None else motion.translation for motion in motions]
    assert kinds == [None, "metric", "metric", "unknown", None]
    assert motions_between(np.zeros(0), [poses]) == []
