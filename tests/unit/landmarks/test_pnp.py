"""Poses of points: the solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.evaluation.consistency import CHI2_6_QUANTILE_95, CHI2_6_QUANTILE_99
from monoloc.evaluation.trajectory import pose_errors
from monoloc.fusion.bias_model import LandmarkBiasModel
from monoloc.geometry import FloatArray, invert, make_pose, pose_distance_m, se3_exp, se3_log, so3_exp, transform
from monoloc.landmarks.features import Keypoints
from monoloc.landmarks.pnp import PRIOR_COVARIANCE as PRIOR
from monoloc.landmarks.pnp import LandmarkMeasurement, LandmarkPose, fit_matches, is_within_prior, prior_radius_m
from monoloc.supervision.camera_check import WELL_OBSERVED_SD
from synthetic_room import CAMERA


def near(pose: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A pose whose error has the covariance PRIOR."""
    return np.asarray(pose @ se3_exp(np.sqrt(np.diag(PRIOR)) * rng.standard_normal(6)))


def seen_from(
    pose: FloatArray, rng: np.random.Generator, camera: Camera = CAMERA, count: int = 80
) -> tuple[FloatArray, FloatArray]:
    """Points, world frame, and where a camera sees them."""
    pixels = rng.uniform((0.0, 0.0), (camera.width, camera.height), (count, 2))
    points = transform(pose, camera.rays(pixels) * rng.uniform(1.0, 4.0, (count, 1)))
    return points, pixels


def pose_from_matches(
    points: FloatArray, seen: Keypoints, camera: Camera, prior: FloatArray, covariance: FloatArray
) -> tuple[NDArray[np.bool_], LandmarkPose | None]:
    agree, fit = fit_matches(points, seen, camera, prior, covariance)
    return agree, None if fit is None else fit.measurement()


def keypoints_at(pixels: FloatArray, sd_px: FloatArray | float = 1.0) -> Keypoints:
    count = len(pixels)
    return Keypoints(pixels, np.zeros((count, 32), np.uint8), np.broadcast_to(sd_px, (count,)))


@pytest.mark.parametrize("seed", range(3))
def test_pose_is_exact_despite_two_fifths_of_wrong_matches(seed):
    rng = np.random.default_rng(seed)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    wrong = rng.choice(80, 32, replace=False)
    pixels[wrong] += rng.uniform(-40.0, 40.0, (32, 2))
    agree, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, near(pose, rng), PRIOR)
    assert found is not None and 48 <= len(found.points) <= 55
    np.testing.assert_array_equal(points[agree], found.points)
    errors = pose_errors(found.pose[None], pose[None])
    assert errors.position_m[0] < 0.01 and errors.rotation_rad[0] < 0.004


def test_pose_does_not_contain_the_prior():
    """The prior only rejects wrong matches: the filter fuses it with the pose afterwards."""
    rng = np.random.default_rng(0)
    pose = se3_exp(rng.normal(size=6))
    points, pixels = seen_from(pose, rng)
    pixels += rng.normal(size=pixels.shape)
    one, other = (
        pose_from_matches(points, keypoints_at(pixels), CAMERA, pose @ se3_exp(np.full(6, off)), PRIOR)[1]
        for off in (-0.02, 0.02)
    )
    assert one is not None and other is not None
    np.testing.assert_allclose(se3_log(invert(one.pose) @ other.pose), 0.0, atol=3e-4)


BARREL = Camera(320, 256, 272.0, 272.0, 159.5, 127.5, (-0.25, 0.0, 0.0, 0.0, 0.0))
TALL_PIXELS = Camera(320, 256, 272.0, 400.0, 159.5, 127.5)


@pytest.mark.parametrize("camera", [CAMERA, BARREL, TALL_PIXELS], ids=["plain", "barrel", "tall pixels"])
def test_squared_errors_match_the_covariance(camera):
    """In units of the covariance their mean is six; over 150 poses its standard deviation is 0.3."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(150):
        pose = se3_exp(rng.normal(size=6))
        points, pixels = seen_from(pose, rng, camera)
        sd_px = rng.uniform(0.5, 2.0, 80)
        pixels += sd_px[:, None] * rng.normal(size=pixels.shape)
        _, found = pose_from_matches(points, keypoints_at(pixels, sd_px), camera, near(pose, rng), PRIOR)
        assert found is not None
        error = se3_log(invert(found.pose) @ pose)
        squares.append(error @ np.linalg.solve(found.covariance, error))
    # Points with large errors have less weight than they could, so the covariance is a fifth too large.
    assert 4.2 < np.mean(squares) < 6.5


def test_exact_prior_is_accepted():
    rng = np.random.default_rng(2)
    points, pixels = seen_from(np.eye(4), rng)
    _, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, np.eye(4), np.zeros((6, 6)))
    assert found is not None
    np.testing.assert_allclose(found.pose, np.eye(4), atol=1e-6)


def test_too_few_or_too_concentrated_points_give_no_pose():
    rng = np.random.default_rng(3)
    points, pixels = seen_from(np.eye(4), rng)
    for count in (14, 0):
        agree, found = pose_from_matches(points[:count], keypoints_at(pixels[:count]), CAMERA, np.eye(4), PRIOR)
        assert agree.tolist() == [True] * count and found is None
    # All at one place, seen from afar: the camera's position around it is undetermined.
    narrow = np.array([0.0, 0.0, 4.0]) + 0.02 * rng.normal(size=(80, 3))
    seen = keypoints_at(CAMERA.project(narrow))
    agree, found = pose_from_matches(narrow, seen, CAMERA, np.eye(4), PRIOR)
    assert agree.sum() == 80 and found is None


def test_mirrored_pose_of_a_flat_view_is_covered_by_the_covariance() -> None:
    """A plane of 50 cm at 2 m, tilted by 9 degrees, and a prior at the pose where it is tilted to the other side."""
    rng = np.random.default_rng(4)
    centre, tilt = np.array([0.0, 0.0, 2.0]), 0.15
    points = np.column_stack([rng.uniform(-0.25, 0.25, (80, 2)), np.zeros(80)]) @ so3_exp([tilt, 0.0, 0.0]).T + centre
    mirrored = make_pose(so3_exp([2.0 * tilt, 0.0, 0.0]), centre - so3_exp([2.0 * tilt, 0.0, 0.0]) @ centre)
    model, with_rivals, alone = LandmarkBiasModel(common_error=0.05), [], []
    for _ in range(40):
        seen = keypoints_at(CAMERA.project(points) + rng.normal(0.0, 0.5, (80, 2)), 0.5)
        _, found = pose_from_matches(points, seen, CAMERA, mirrored, PRIOR)
        assert found is not None
        error = se3_log(invert(found.pose))
        single = replace(found, rivals=np.zeros((0, 6)), rival_nats=np.zeros(0))
        for squares, pose in ((with_rivals, found), (alone, single)):
            squares.append(error @ np.linalg.solve(model.covariance(pose, 0.0), error))
    # Measured 0.88 and 0.10.
    assert np.mean(np.array(with_rivals) < CHI2_6_QUANTILE_95) > 0.75
    assert np.mean(np.array(alone) < CHI2_6_QUANTILE_95) < 0.25


def test_pose_does_not_rest_on_one_match() -> None:
    """Landmarks on a small patch of a wall, and one far from them, seen 25 pixels from where it is.

    The wrong match agrees with the pose that it leads to, and makes it look well known.
    """
    rng = np.random.default_rng(6)
    squares = []
    for _ in range(40):
        patch = np.column_stack([rng.uniform(-0.4, 0.4, (30, 2)), np.full(30, 4.0) + rng.uniform(-0.1, 0.1, 30)])
        points = np.vstack([patch, [0.8, 0.6, 2.0]])
        pixels = CAMERA.project(points) + rng.normal(0.0, 1.0, (31, 2))
        pixels[-1] += [20.0, -15.0]
        agree, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, np.eye(4), 25.0 * PRIOR)
        assert not agree[-1]
        if found is not None:
            error = se3_log(invert(found.pose))
            squares.append(error @ np.linalg.solve(found.covariance, error))
    # Measured 0.95 of 39; of the poses that rest on the match, 0 of 40, with a median error of 38 cm.
    assert len(squares) > 30 and np.mean(np.array(squares) < CHI2_6_QUANTILE_95) > 0.85


def test_a_view_with_depth_has_no_other_poses() -> None:
    rng = np.random.default_rng(0)
    points, pixels = seen_from(np.eye(4), rng)
    _, found = pose_from_matches(
        points, keypoints_at(pixels + rng.normal(size=pixels.shape)), CAMERA, np.eye(4), PRIOR
    )
    assert found is not None
    is_same = np.linalg.norm(found.rivals, axis=1) < 0.02
    assert np.all(is_same | (found.rival_nats > 20.0))


@pytest.mark.parametrize("factor", [0.8, 0.9, 1.0, 1.1, 1.3])
def test_wrong_focal_length_is_recovered(factor: float) -> None:
    """From a pose near the true one; the corners' noise explains what remains."""
    rng = np.random.default_rng(5)
    true = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    deviations = []
    for _ in range(30):
        pose = se3_exp(rng.normal(size=6))
        points, pixels = seen_from(pose, rng, true)
        seen = keypoints_at(pixels + rng.normal(size=pixels.shape))
        _, found = pose_from_matches(points, seen, CAMERA, near(pose, rng), PRIOR)
        if found is None:
            continue
        assert found.log_focal_sd < 0.01
        deviations.append((found.log_focal - np.log(factor)) / found.log_focal_sd)
    assert len(deviations) > 20
    assert np.median(np.abs(deviations)) < 1.5 and np.percentile(np.abs(deviations), 90.0) < 4.0


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
def test_stretch_along_one_axis_is_recovered_in_flat_views_too(factor: float) -> None:
    """A wall at 3 m, and a fifth of wrong matches."""
    rng = np.random.default_rng(9)
    true = replace(CAMERA, fy=factor * CAMERA.fy)
    deviations = []
    for _ in range(30):
        pixels = rng.uniform((0.0, 0.0), (CAMERA.width, CAMERA.height), (150, 2))
        points = 3.0 * true.rays(pixels)
        pixels += rng.normal(size=pixels.shape)
        pixels[:30] += rng.uniform(-40.0, 40.0, (30, 2))
        _, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, near(np.eye(4), rng), PRIOR)
        if found is not None:
            assert found.log_aspect_sd < 0.01
            deviations.append((found.log_aspect - np.log(factor)) / found.log_aspect_sd)
    assert len(deviations) > 20
    assert np.median(np.abs(deviations)) < 1.5 and np.percentile(np.abs(deviations), 90.0) < 3.0


@pytest.mark.parametrize("factor", [0.77, 1.0, 1.3])
def test_focal_length_in_a_flat_view_is_within_its_standard_deviation(factor: float) -> None:
    """A wall at 3 m, a little tilted, and a quarter of wrong matches."""
    rng = np.random.default_rng(8)
    true = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    deviations = []
    for _ in range(30):
        pixels = rng.uniform((0.0, 0.0), (CAMERA.width, CAMERA.height), (60, 2))
        rays = true.rays(pixels)
        points = rays * (3.0 / (1.0 + 0.3 * rays[:, :1]))
        pixels += rng.normal(size=pixels.shape)
        pixels[:15] += rng.uniform(-40.0, 40.0, (15, 2))
        _, found = pose_from_matches(points, keypoints_at(pixels), CAMERA, near(np.eye(4), rng), PRIOR)
        if found is not None:
            deviations.append((found.log_focal - np.log(factor)) / found.log_focal_sd)
    assert len(deviations) > 20
    # Measured 0.5 to 1.2, and 1.3 to 1.8. If only the rays shrink, and not what they deviate by: up to 2.4.
    assert np.median(np.abs(deviations)) < 1.5 and np.percentile(np.abs(deviations), 90.0) < 2.5


def test_focal_length_is_undetermined_where_all_points_are_at_one_depth_and_near_the_centre() -> None:
    """A step along the view looks the same."""
    rng = np.random.default_rng(6)
    pixels = rng.uniform((120.0, 90.0), (200.0, 165.0), (80, 2))
    points = 3.0 * CAMERA.rays(pixels)
    seen = keypoints_at(pixels + rng.normal(size=pixels.shape), 1.0)
    _, found = pose_from_matches(points, seen, CAMERA, np.eye(4), PRIOR)
    assert found is not None and found.log_focal_sd > WELL_OBSERVED_SD


@pytest.mark.parametrize("seed", range(3))
def test_prior_radius_bounds_the_poses_within_the_prior(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(0.0, 0.05, (6, 6))
    prior, covariance = se3_exp(rng.normal(size=6)), root @ root.T
    directions = rng.normal(size=(20_000, 6))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on_bound = np.sqrt(CHI2_6_QUANTILE_99) * directions @ np.linalg.cholesky(covariance + PRIOR).T
    poses = prior @ se3_exp(0.999 * on_bound)
    assert all(is_within_prior(pose, prior, covariance) for pose in poses[:50])
    assert not any(is_within_prior(pose, prior, covariance) for pose in prior @ se3_exp(1.001 * on_bound[:50]))
    farthest_m = pose_distance_m(prior, poses).max()
    radius_m = prior_radius_m(covariance)
    assert 0.8 * radius_m < farthest_m < radius_m


@pytest.mark.parametrize(
    ("pose", "covariance", "problem"),
    [
        (2.0 * np.eye(4), np.eye(6), "pose of landmarks must be a rigid T_world_camera"),
        (np.eye(4), np.ones(6), "covariance of a landmark pose must be finite, .6, 6."),
        (np.eye(4), np.full((6, 6), np.nan), "covariance of a landmark pose must be finite, .6, 6."),
        (np.eye(4), -np.eye(6), "covariance of a landmark pose must be symmetric and positive semidefinite"),
        (np.eye(4), np.triu(np.ones((6, 6))), "covariance of a landmark pose must be symmetric"),
    ],
)
def test_what_is_no_landmark_pose_is_refused(pose: FloatArray, covariance: FloatArray, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        LandmarkPose(pose, covariance, np.zeros((20, 3)))


def test_flags_of_other_landmarks_than_those_in_view_are_refused() -> None:
    with pytest.raises(ValueError, match=r"is_found must have shape \(5,\) as visible, got \(2,\)"):
        LandmarkMeasurement(5, 2, None, np.arange(5), np.ones(2, dtype=np.bool_))
