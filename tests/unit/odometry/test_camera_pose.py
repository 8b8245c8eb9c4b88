"""Pose of a camera from corners of known places: tests."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, se3_exp, se3_log, transform
from monoloc.odometry.camera_pose import solve_pose
from monoloc.odometry.odometry_config import OdometryConfig

PINHOLE = Camera(320, 240, 262.0, 262.0, 159.5, 119.5)
FISHEYE = Camera(320, 240, 142.0, 142.0, 159.5, 119.5, (0.02, -0.01, 0.003, -0.001), "fisheye")
CAMERAS = [PINHOLE, FISHEYE]
CORNERS, NOISE_PX = 250, 0.3


def scene(camera: Camera, seed: int) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Points (N, 3), a pose ``T_r_camera`` near the origin, and the pixels all over its image that show them."""
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((4.0, 4.0), (camera.width - 4.0, camera.height - 4.0), (CORNERS, 2))
    points = camera.rays(pixels) * rng.uniform(1.0, 4.0, CORNERS)[:, None]
    pose = se3_exp(rng.normal(size=6) * [0.04, 0.04, 0.04, 0.02, 0.02, 0.02])
    local = transform(invert(pose), points)
    points, local = points[camera.in_sight(local)], local[camera.in_sight(local)]
    seen = camera.project(local) + NOISE_PX * rng.standard_normal((len(local), 2))
    return points, pose, seen.astype(np.float32)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_corners_count_by_their_pixels_all_over_the_image(camera: Camera, seed: int) -> None:
    """Also at the edge of a fisheye. Each pose is within four times what so much noise explains."""
    points, pose, pixels = scene(camera, seed)
    wrong = np.arange(0, len(points), 5)
    pixels[wrong] += 12.0
    solution = solve_pose(points, pixels, camera, OdometryConfig())
    assert solution is not None
    found, _, inliers = solution
    assert not np.isin(wrong, inliers).any()
    assert len(inliers) > 0.98 * (len(points) - len(wrong))
    error = se3_log(invert(pose) @ found)
    assert np.linalg.norm(error[:3]) < 0.004 and np.linalg.norm(error[3:]) < 0.002


@pytest.mark.parametrize("camera", CAMERAS)
def test_pose_needs_corners_that_agree(camera: Camera) -> None:
    points, _, pixels = scene(camera, 3)
    config = OdometryConfig()
    assert solve_pose(points[:14], pixels[:14], camera, config) is None
    assert solve_pose(points, np.random.default_rng(0).permutation(pixels), camera, config) is None


@pytest.mark.parametrize("seed", range(12))
def test_depth_that_errs_smoothly_is_followed(seed: int) -> None:
    """As a network's depth does, by up to a fifth: EPnP's pose is then at times one with which few corners agree."""
    camera = Camera(320, 227, 200.0, 200.0, 159.5, 113.0, (-0.02, 0.004, 0.0, 0.0), "fisheye")
    rng = np.random.default_rng(seed)
    rays = camera.rays(rng.uniform((4.0, 4.0), (camera.width - 4.0, camera.height - 4.0), (CORNERS, 2)))
    points = rays * (2.5 + 0.5 * np.sin(3.0 * rays[:, :1]))
    pose = se3_exp(rng.normal(size=6) * [0.08, 0.08, 0.05, 0.02, 0.02, 0.02])
    error = 0.2 * np.sin(2.0 * rays[:, :1] + rng.uniform(0.0, 6.0)) * np.cos(2.0 * rays[:, 1:2])
    local = transform(invert(pose), points)
    points, local = (points * np.exp(error))[camera.in_sight(local)], local[camera.in_sight(local)]
    seen = camera.project(local) + NOISE_PX * rng.standard_normal((len(local), 2))
    solution = solve_pose(points, seen.astype(np.float32), camera, OdometryConfig())
    assert solution is not None
    assert len(solution[2]) > 0.8 * len(points)


@pytest.mark.parametrize("camera", CAMERAS)
def test_covariance_is_that_of_25_independent_corners(camera: Camera) -> None:
    """Here all corners are independent, so a pose by n of them has 25 / n of the stated covariance."""
    normalised = []
    for seed in range(60):
        points, pose, pixels = scene(camera, seed)
        solution = solve_pose(points, pixels, camera, OdometryConfig())
        assert solution is not None
        found, covariance, inliers = solution
        error = se3_log(invert(found) @ pose)
        normalised.append(error @ np.linalg.solve(covariance * 25.0 / len(inliers), error))
    # Of 60 chi-squares with 6 degrees of freedom, the mean has a standard deviation of 0.45.
    assert 4.5 < np.mean(normalised) < 7.5


@pytest.mark.parametrize("camera", CAMERAS)
def test_covariance_has_the_shape_of_the_view(camera: Camera) -> None:
    """In front of a plane, a step to the right and a turn to the left look alike, so their errors come together."""
    rng = np.random.default_rng(0)
    rays = camera.rays(rng.uniform((80.0, 60.0), (240.0, 180.0), (CORNERS, 2)))
    correlations = []
    for depth_m in (np.full(CORNERS, 2.0), rng.uniform(0.5, 4.0, CORNERS)):
        points = rays * (depth_m / rays[:, 2])[:, None]
        seen = camera.project(points) + NOISE_PX * rng.standard_normal((CORNERS, 2))
        solution = solve_pose(points, seen.astype(np.float32), camera, OdometryConfig())
        assert solution is not None
        covariance = solution[1]
        correlations.append(covariance[0, 4] / np.sqrt(covariance[0, 0] * covariance[4, 4]))
    of_plane, of_room = correlations
    assert of_plane < -0.95 and of_plane < of_room
