"""Correction of a depth image's scale and tilt by the corners of odometry."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray
from monoloc.odometry.motion import Motion
from monoloc.odometry.scale_tilt import ScaleTiltConfig, correct_scale_and_tilt

PINHOLE = Camera(80, 60, 70.0, 70.0, 39.5, 29.5)
DISTORTED = Camera(80, 60, 70.0, 70.0, 39.0, 30.0, (-0.2, 0.03, 0.001, -0.002, 0.0))
CAMERAS = pytest.mark.parametrize("camera", [PINHOLE, DISTORTED], ids=["pinhole", "distorted"])
TILT = np.array([0.03, -0.06, 0.04])  # log-scale; change of log-depth along x and along y


def slanted(rays: FloatArray) -> FloatArray:
    """Depth of a slanted wall on rays (..., 3) with z = 1: (...)."""
    return np.asarray(2.5 / (1.0 + 0.2 * rays[..., 0] - 0.1 * rays[..., 1]))


def tilted(camera: Camera, tilt: FloatArray = TILT) -> DepthPrediction:
    """Depth of the wall that is too small by a factor ``exp(tilt)``, plane in log-depth."""
    rays = camera.pixel_rays()
    return DepthPrediction((slanted(rays) * np.exp(-plane(rays, tilt))).astype(np.float32), camera)


def plane(rays: FloatArray, tilt: FloatArray) -> FloatArray:
    return np.asarray(tilt[0] + tilt[1] * rays[..., 0] + tilt[2] * rays[..., 1])


def corners(camera: Camera, count: int, seed: int = 0, sd: float = 0.02) -> Motion:
    """Corners on the wall itself, at centres of pixels, so that nothing is interpolated."""
    rng = np.random.default_rng(seed)
    pixels = np.column_stack([rng.integers(2, camera.width - 2, count), rng.integers(2, camera.height - 2, count)])
    rays = camera.rays(pixels)
    return Motion(np.eye(4), count, rays * slanted(rays)[:, None], np.full(count, sd))


def with_points(motion: Motion, points: FloatArray) -> Motion:
    return Motion(motion.T_previous_current, motion.inliers, points, motion.log_depth_sd)


def change(before: DepthPrediction, after: DepthPrediction) -> FloatArray:
    return np.asarray(np.log(after.depth_m.astype(np.float64) / before.depth_m))


@CAMERAS
@pytest.mark.parametrize("count", [10, 15, 120])
def test_correction_is_that_of_ridge_regression(camera: Camera, count: int) -> None:
    """Of small errors, where Huber's loss is quadratic; the prior is rows of an ordinary least-squares problem."""
    config = ScaleTiltConfig()
    depth, motion = tilted(camera, 0.2 * TILT), corners(camera, count)
    after = correct_scale_and_tilt(depth, motion, config)
    rays = motion.points / motion.points[:, 2:]
    sd = np.hypot(0.02, config.corner_sd) / np.sqrt(min(1.0, config.effective_corners / count))
    rows = np.column_stack([np.ones(count), rays[:, :2]]) / sd
    prior = np.diag(1.0 / np.array([config.scale_sd, config.tilt_sd, config.tilt_sd]))
    wanted = np.concatenate([plane(rays, 0.2 * TILT) / sd, np.zeros(3)])
    expected = np.linalg.lstsq(np.concatenate([rows, prior]), wanted, rcond=None)[0]
    np.testing.assert_allclose(change(depth, after), plane(camera.pixel_rays(), expected), atol=1e-5)
    assert np.linalg.norm(expected) > 0.2 * np.linalg.norm(0.2 * TILT)  # not trivially


@CAMERAS
def test_wide_prior_gives_the_whole_correction(camera: Camera) -> None:
    wide_prior = ScaleTiltConfig(scale_sd=10.0, tilt_sd=10.0, effective_corners=1000.0)
    depth = tilted(camera)
    after = correct_scale_and_tilt(depth, corners(camera, 100), wide_prior)
    np.testing.assert_allclose(after.depth_m, slanted(camera.pixel_rays()), rtol=1e-4)


def test_precise_corners_have_more_weight() -> None:
    """Half of the corners are too far, half too near, in the same places."""
    rays = corners(PINHOLE, 30).points
    points = np.concatenate([1.05 * rays, rays / 1.05])
    config = ScaleTiltConfig(corner_sd=0.01, scale_sd=1.0, effective_corners=1000.0)
    depth = tilted(PINHOLE, np.zeros(3))

    def log_change(near_sd: float, far_sd: float) -> float:
        sd = np.repeat([near_sd, far_sd], len(rays))
        return float(change(depth, correct_scale_and_tilt(depth, Motion(np.eye(4), 60, points, sd), config)).mean())

    assert log_change(0.1, 0.1) == pytest.approx(0.0, abs=1e-4)
    assert log_change(0.02, 0.1) > 0.03
    assert log_change(0.1, 0.02) < -0.03


def test_corners_beyond_the_effective_number_add_no_information() -> None:
    depth, few = tilted(PINHOLE, 0.2 * TILT), corners(PINHOLE, 40)
    config = ScaleTiltConfig(effective_corners=20.0)
    many = Motion(few.T_previous_current, 120, np.tile(few.points, (3, 1)), np.tile(few.log_depth_sd, 3))
    once, thrice = correct_scale_and_tilt(depth, few, config), correct_scale_and_tilt(depth, many, config)
    np.testing.assert_allclose(thrice.depth_m, once.depth_m, rtol=1e-6)


@CAMERAS
@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_a_fifth_of_outliers_hardly_changes_the_correction(camera: Camera, factor: float) -> None:
    depth, motion = tilted(camera), corners(camera, 100)
    clean = correct_scale_and_tilt(depth, motion, ScaleTiltConfig())
    spoilt = motion.points.copy()
    spoilt[::5] *= factor  # along their rays: only their depth is wrong
    after = correct_scale_and_tilt(depth, with_points(motion, spoilt), ScaleTiltConfig())
    # The outliers' mean is a fifth of log 3, or 0.22; least squares with the same prior follows it by 0.16.
    assert np.abs(change(clean, after)).mean() < 0.02
    # It remains better than no correction.
    truth = slanted(camera.pixel_rays())
    errors = [np.abs(np.log(d.depth_m / truth)).mean() for d in (depth, after)]
    assert errors[1] < errors[0]


# --- Without enough corners, depth is returned as it is ---


def outside_the_image(points: FloatArray) -> FloatArray:
    return points + np.array([1.0, 0.0, 0.0]) * 4.0 * points[:, 2:]


def behind_the_camera(points: FloatArray) -> FloatArray:
    return -points


def too_near(points: FloatArray) -> FloatArray:
    return points * 0.09 / points[:, 2:]


@CAMERAS
def test_nine_corners_are_too_few(camera: Camera) -> None:
    depth = tilted(camera)
    assert correct_scale_and_tilt(depth, corners(camera, 9), ScaleTiltConfig()) is depth
    nothing = Motion(np.eye(4), 0, np.zeros((0, 3)), np.zeros(0))
    assert correct_scale_and_tilt(depth, nothing, ScaleTiltConfig()) is depth
    assert correct_scale_and_tilt(depth, corners(camera, 10), ScaleTiltConfig()) is not depth


@CAMERAS
@pytest.mark.parametrize("displace", [outside_the_image, behind_the_camera, too_near])
def test_corners_out_of_view_are_ignored(camera: Camera, displace) -> None:
    depth, motion = tilted(camera), corners(camera, 50)
    assert correct_scale_and_tilt(depth, with_points(motion, displace(motion.points)), ScaleTiltConfig()) is depth
    # Nor do they change anything beside good ones.
    good = corners(camera, 20, seed=1)
    points = np.concatenate([good.points, displace(motion.points)])
    both = Motion(np.eye(4), 70, points, np.concatenate([good.log_depth_sd, motion.log_depth_sd]))
    expected = correct_scale_and_tilt(depth, good, ScaleTiltConfig())
    np.testing.assert_array_equal(correct_scale_and_tilt(depth, both, ScaleTiltConfig()).depth_m, expected.depth_m)


def test_uncertain_corners_are_ignored() -> None:
    depth = tilted(PINHOLE)
    assert (
        correct_scale_and_tilt(depth, corners(PINHOLE, 50, sd=0.16), ScaleTiltConfig(max_corner_log_depth_sd=0.15))
        is depth
    )
    assert (
        correct_scale_and_tilt(depth, corners(PINHOLE, 50, sd=0.14), ScaleTiltConfig(max_corner_log_depth_sd=0.15))
        is not depth
    )


@CAMERAS
def test_corners_without_depth_are_ignored(camera: Camera) -> None:
    motion = corners(camera, 50)
    empty = DepthPrediction(np.zeros((60, 80), dtype=np.float32), camera)
    assert correct_scale_and_tilt(empty, motion, ScaleTiltConfig()) is empty
    # So are those at a hole's border, where interpolation would mix depth with zeros.
    depth = tilted(camera, np.zeros(3))
    half = depth.depth_m.copy()
    half[:, :40] = 0.0
    pixels = np.column_stack([np.full(20, 39.5), np.linspace(5.0, 50.0, 20)])
    rays = camera.rays(pixels)
    border = Motion(np.eye(4), 20, rays * slanted(rays)[:, None], np.full(20, 0.02))
    holed = DepthPrediction(half, camera)
    assert correct_scale_and_tilt(holed, border, ScaleTiltConfig()) is holed


# --- What remains unchanged ---


def test_holes_and_stated_errors_are_preserved() -> None:
    depth = tilted(PINHOLE)
    holed = depth.depth_m.copy()
    holed[:10] = 0.0
    log_error = np.linspace(-3.0, 0.0, 4800, dtype=np.float32).reshape(60, 80)
    given = DepthPrediction(holed, PINHOLE, log_error)
    before = holed.copy()
    after = correct_scale_and_tilt(given, corners(PINHOLE, 80), ScaleTiltConfig())
    assert after is not given
    assert np.array_equal(after.depth_m == 0.0, holed == 0.0)
    assert after.log_error is log_error and after.camera is PINHOLE
    assert after.depth_m.dtype == np.float32 and after.depth_m.shape == holed.shape
    assert np.array_equal(holed, before)  # the input is not modified


def test_depth_that_agrees_with_its_corners_is_unchanged() -> None:
    depth = tilted(PINHOLE, np.zeros(3))
    np.testing.assert_allclose(
        correct_scale_and_tilt(depth, corners(PINHOLE, 60), ScaleTiltConfig()).depth_m, depth.depth_m, rtol=1e-5
    )


@pytest.mark.parametrize("name", ["scale_sd", "tilt_sd", "corner_sd", "max_corner_log_depth_sd", "effective_corners"])
def test_settings_must_be_positive(name: str) -> None:
    with pytest.raises(ValueError, match=name):
        ScaleTiltConfig(**{name: 0.0})
