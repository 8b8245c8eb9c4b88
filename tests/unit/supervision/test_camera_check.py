"""The stated focal length against the build's and against landmarks'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import se3_exp
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.particle_filter.estimate import Estimate
from monoloc.supervision.camera_check import WELL_OBSERVED_SD, CameraCheck, has_same_focal

FRAME_S = 0.1
CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
BELIEF = Estimate(np.eye(4), 1e-4 * np.eye(6), 0.0)


def by_landmarks(log_focal: float, sd: float = 0.01, count: int = 30) -> LandmarkPose:
    return LandmarkPose(np.eye(4), 1e-6 * np.eye(6), np.zeros((count, 3)), log_focal, sd)


def after(check: CameraCheck, pose: LandmarkPose | None, frames: int, step_m: float = 0.2) -> bool:
    """The check after frames that measure the same, by a camera that moves on by ``step_m`` each."""
    for index in range(frames):
        check.update(pose, se3_exp([step_m * index, 0.0, 0.0, 0.0, 0.0, 0.0]), FRAME_S)
    return check.mismatch


@pytest.mark.parametrize(
    ("log_focal", "is_another"), [(0.01, False), (0.045, False), (-0.025, False), (0.07, True), (-0.05, True)]
)
def test_camera_is_another_where_focal_length_differs_from_the_builds(log_focal: float, is_another: bool) -> None:
    """By more than 4 %, where the build's own frames differ by less than a third of that."""
    assert after(CameraCheck(0.01, 0.005, True), by_landmarks(log_focal), 20) == is_another
    assert not after(CameraCheck(0.01, 0.05, True), by_landmarks(log_focal), 20)


@pytest.mark.parametrize(("log_aspect", "is_another"), [(0.0, False), (0.05, False), (0.08, True), (-0.08, True)])
def test_camera_is_another_where_the_image_is_stretched_along_one_axis(log_aspect: float, is_another: bool) -> None:
    stretched = replace(by_landmarks(0.0), log_aspect=log_aspect, log_aspect_sd=0.005)
    assert after(CameraCheck(0.0, 0.005, True), stretched, 20) == is_another
    assert not after(CameraCheck(0.0, 0.005, True), replace(stretched, log_aspect_sd=0.05), 20)
    assert not after(CameraCheck(0.0, 0.005, True), replace(stretched, log_aspect_sd=np.inf), 20)


def test_nothing_is_said_before_half_a_second_of_measurements() -> None:
    check = CameraCheck(0.0, 0.01, True)
    assert not check.mismatch
    assert not after(check, by_landmarks(0.3), 4)
    assert not after(check, None, 50)  # frames without landmarks do not count
    assert after(check, by_landmarks(0.3), 2)


def test_one_frame_after_a_gap_is_no_second_of_measurements() -> None:
    for log_focal in (0.3, 0.0):
        check = CameraCheck(0.0, 0.01, False)
        check.update(by_landmarks(log_focal), np.eye(4), 5.0)
        assert not check.mismatch and not check.is_confirmed


def test_a_camera_that_hovers_sees_one_view_however_long() -> None:
    """Misplaced landmarks ask for the same wrong focal length all the time, or confirm one."""
    check = CameraCheck(0.0, 0.01, False)
    assert not after(check, by_landmarks(0.3), 300, step_m=0.0003)
    assert after(check, by_landmarks(0.3), 6)
    check = CameraCheck(0.0, 0.01, False)
    assert not after(check, by_landmarks(0.0), 300, step_m=0.0) and not check.is_confirmed
    after(check, by_landmarks(0.0), 20)
    assert check.is_confirmed
    assert not after(check, by_landmarks(0.2), 300, step_m=0.0), "what other views said is not forgotten meanwhile"


def test_flat_views_say_less() -> None:
    """However many: landmarks are misplaced alike in all of them."""
    for log_focal, sd, is_another in ((0.3, 0.08, True), (0.2, 0.08, False), (0.1, 0.02, True), (0.3, np.inf, False)):
        assert after(CameraCheck(0.0, 0.01, True), by_landmarks(log_focal, sd), 100) == is_another


def test_many_landmarks_of_one_surface_do_not_make_a_flat_view_tell_more() -> None:
    """Their common error does not average out: 300 have twice the deviation of 30."""
    assert after(CameraCheck(0.0, 0.01, True), by_landmarks(0.1, 0.02), 100)
    assert not after(CameraCheck(0.0, 0.01, True), by_landmarks(0.1, 0.02, 300), 100)


def test_what_was_measured_is_forgotten_within_seconds() -> None:
    """Single wrong frames do not make another camera, and a second of them is outvoted by ten of right ones."""
    check = CameraCheck(0.0, 0.01, True)
    assert not after(check, by_landmarks(0.0), 30)
    assert not after(check, by_landmarks(0.3), 2)
    assert after(check, by_landmarks(0.3), 10)
    assert not after(check, by_landmarks(0.0), 100)


def test_better_observed_frames_count_more() -> None:
    check = CameraCheck(0.0, 0.01, True)
    for _ in range(30):
        after(check, by_landmarks(0.0, 0.002), 2)
        after(check, by_landmarks(0.2, 0.02), 2)
    assert not check.mismatch


def wall_at(distance_m: float) -> DepthPrediction:
    depth_m = np.full((6, 8), distance_m, dtype=np.float32)
    depth_m[:3] = 0.0  # unknown
    return DepthPrediction(depth_m, CAMERA.resized(8, 6))


def sd_along_axis(check: CameraCheck, depth: DepthPrediction | None) -> float:
    """Added to the belief's, metres."""
    added = check.widened(BELIEF, depth).covariance - BELIEF.covariance
    assert np.count_nonzero(added) <= 1  # along the optical axis alone
    return float(np.sqrt(added[2, 2]))


def test_cameras_of_one_focal_length_differ_in_resolution_and_shape_only() -> None:
    assert has_same_focal(CAMERA, CAMERA)
    assert has_same_focal(CAMERA.resized(160, 120), CAMERA)
    assert has_same_focal(CAMERA.cropped(0, 60, 640, 360), CAMERA)  # a video of the same sensor
    assert has_same_focal(Camera(480, 640, 525.0, 525.0, 239.5, 319.5), CAMERA)  # held upright
    for factor in (0.9, 0.95, 1.05, 1.1):
        assert not has_same_focal(replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy), CAMERA)
    assert not has_same_focal(CAMERA.cropped(64, 48, 512, 384), CAMERA)


def test_focal_length_of_the_build_adds_nothing_to_the_covariance() -> None:
    check = CameraCheck(0.0, 0.01, True)
    assert check.is_confirmed and check.widened(BELIEF, wall_at(2.0)) is BELIEF


def test_an_image_that_is_sure_of_another_focal_length_widens_the_covariance_of_the_builds_camera_too() -> None:
    """As while an autofocus breathes: its mean is the stated one. The build's own deviation adds to the image's."""
    check = CameraCheck(0.0, 0.03, True)
    after(check, by_landmarks(0.05, 0.01), 10)
    after(check, by_landmarks(-0.05, 0.01), 10)
    assert check.widened(BELIEF, wall_at(2.0)) is BELIEF  # it may be chance
    check = CameraCheck(0.0, 1e-6, True)
    after(check, by_landmarks(0.05, 0.01), 10)
    after(check, by_landmarks(-0.05, 0.01), 10)
    assert sd_along_axis(check, wall_at(2.0)) == pytest.approx(2.0 * 0.02, rel=0.01)
    after(check, None, 1)
    assert check.widened(BELIEF, wall_at(2.0)) is BELIEF


def test_a_stretched_image_widens_the_covariance_along_all_axes() -> None:
    """By 0.6 of the log-aspect: in radians, and in distances of the scene."""
    check = CameraCheck(0.0, 0.005, True)
    stretched = replace(by_landmarks(0.0), log_aspect=-0.1, log_aspect_sd=0.005)
    after(check, stretched, 1)
    assert check.widened(BELIEF, wall_at(2.0)) is BELIEF  # one view may be wrong
    assert after(check, stretched, 20)
    added = check.widened(BELIEF, wall_at(2.0)).covariance - BELIEF.covariance
    np.testing.assert_allclose(added, np.diag([0.12**2] * 3 + [0.06**2] * 3), rtol=1e-6, atol=1e-12)


def test_another_focal_length_may_be_a_tenth_wrong_until_landmarks_measure_it() -> None:
    """It then moves the camera by a tenth of the scene's distance, along its optical axis."""
    check = CameraCheck(0.02, 0.01, False)
    assert sd_along_axis(check, None) == 0.0  # nothing was seen yet
    assert sd_along_axis(check, wall_at(2.0)) == pytest.approx(0.2)
    assert not after(check, by_landmarks(0.03), 9) and not check.is_confirmed
    assert sd_along_axis(check, None) == pytest.approx(0.2)  # the scene of the last depth image
    assert not after(check, by_landmarks(0.03), 2) and check.is_confirmed
    assert sd_along_axis(check, wall_at(1.0)) == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("log_focal", "sd", "build_sd", "expected"),
    [
        (0.0, 0.01, 0.001, WELL_OBSERVED_SD),  # no measurement counts as better
        (0.0, 0.03, 0.001, 0.03),
        (0.0, 0.03, 0.04, 0.05),
        (0.04, 0.03, 0.001, 0.05),
        (-0.04, 0.03, 0.001, 0.05),
    ],
)
def test_measured_focal_length_is_as_wrong_as_difference_view_and_build_allow(
    log_focal: float, sd: float, build_sd: float, expected: float
) -> None:
    check = CameraCheck(0.0, build_sd, False)
    after(check, by_landmarks(log_focal, sd), 20)
    assert sd_along_axis(check, wall_at(1.0)) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("log_focal", "sd", "expected"), [(-0.3, 0.01, 0.27), (0.3, 0.05, 0.15), (0.3, 0.1, 0.1)])
def test_one_view_that_is_sure_of_another_focal_length_widens_the_covariance_at_once(
    log_focal: float, sd: float, expected: float
) -> None:
    """By what exceeds three standard deviations of the view."""
    check = CameraCheck(0.0, 0.01, False)
    assert not after(check, by_landmarks(log_focal, sd), 1)
    assert sd_along_axis(check, wall_at(1.0)) == pytest.approx(expected)


def test_a_focal_length_that_was_measured_stays_so_in_flat_views() -> None:
    check = CameraCheck(0.0, 0.01, False)
    after(check, by_landmarks(0.0), 20)
    after(check, by_landmarks(0.0, 0.2), 300)
    assert check.is_confirmed and sd_along_axis(check, wall_at(1.0)) == pytest.approx(WELL_OBSERVED_SD)


@pytest.mark.parametrize(
    ("sd", "pose"),
    [
        (0.01, by_landmarks(0.1)),  # another focal length
        (0.01, by_landmarks(0.0, 0.1)),  # flat views
        (1.0, by_landmarks(0.0)),  # a build that could not measure it
        (0.01, None),
    ],
)
def test_these_do_not_confirm_a_focal_length(sd: float, pose: LandmarkPose | None) -> None:
    check = CameraCheck(0.0, sd, False)
    after(check, pose, 100)
    assert not check.is_confirmed and sd_along_axis(check, wall_at(2.0)) == pytest.approx(0.2)


def test_landmarks_that_contradict_each_other_do_not_confirm_a_focal_length() -> None:
    check = CameraCheck(0.0, 0.01, False)
    for _ in range(10):
        after(check, by_landmarks(0.0), 5)
        after(check, by_landmarks(0.4), 5)
    assert not check.is_confirmed
