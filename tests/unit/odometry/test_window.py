"""Bundle adjustment of a few keyframes, on scenes of known geometry."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.geometry import FloatArray, invert, se3_exp, so3_exp, transform
from monoloc.odometry.window import Window, adjust
from monoloc.odometry.window_numpy_twin import linearise

FRAMES, CORNERS = 6, 120
RAY_SD, LOG_DEPTH_SD = 0.002, 0.3


def scene(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Poses (W, 4, 4) along half a metre and corners (N, 3) one to four metres away."""
    depth = rng.uniform(1.0, 4.0, CORNERS)
    points = np.column_stack(
        [rng.uniform(-0.5, 0.5, CORNERS) * depth, rng.uniform(-0.4, 0.4, CORNERS) * depth, depth]
    )
    steps = np.zeros((FRAMES, 6))
    steps[:, 0] = np.linspace(0.0, 0.5, FRAMES)
    steps[:, 4] = np.linspace(0.0, -0.1, FRAMES)
    return se3_exp(steps), points


def observe(poses: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exact rays (N, W, 2) and log-depth (N, W)."""
    local = transform(invert(poses), points).swapaxes(0, 1)
    return local[..., :2] / local[..., 2:], np.log(local[..., 2])


def test_jacobians_are_the_derivatives_of_the_residuals() -> None:
    rng = np.random.default_rng(0)
    poses, points = scene(rng)
    rays, log_depth = observe(poses, points)
    # Small residuals, so that Huber's weights are 1 and the residual is the plain one.
    seen = rays + 0.0005 * rng.standard_normal(rays.shape), log_depth, RAY_SD, LOG_DEPTH_SD
    J_pose, J_point, residual = linearise(poses, points, *seen)
    step = 1e-6
    for axis in range(6):
        twist = np.zeros(6)
        twist[axis] = step
        moved = linearise(poses @ se3_exp(twist), points, *seen)[2]
        np.testing.assert_allclose((moved - residual) / step, J_pose[..., axis], atol=1e-2, rtol=1e-3)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        moved = linearise(poses, points + shift, *seen)[2]
        np.testing.assert_allclose((moved - residual) / step, J_point[..., axis], atol=1e-2, rtol=1e-3)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_parallax_corrects_distorted_depth_of_corners(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses, points = scene(rng)
    rays, log_depth = observe(poses, points)
    # The first keyframe's depth, 15 % wrong from corner to corner, places the points; poses are a few mm off.
    wrong = log_depth + rng.normal(0.0, 0.15, (CORNERS, 1))
    start = np.column_stack([rays[:, 0], np.ones(CORNERS)]) * np.exp(wrong[:, :1])
    start_poses = poses @ se3_exp(rng.normal(0.0, 0.005, (FRAMES, 6)))
    start_poses[0] = poses[0]
    noisy = rays + 0.5 * RAY_SD * rng.standard_normal(rays.shape)
    adjusted_poses, adjusted, information = adjust(
        Window(start_poses, start, noisy, wrong), RAY_SD, LOG_DEPTH_SD, iterations=10
    )
    error = np.log(adjusted[:, 2] / points[:, 2])
    shape = np.median(np.abs(error - np.median(error)))
    before = np.log(start[:, 2] / points[:, 2])
    assert shape < 0.2 * np.median(np.abs(before - np.median(before)))
    # Scale is the depth's, on average; with it taken out the poses are right to some millimetres.
    scale = np.exp(np.median(error))
    assert abs(np.log(scale)) < 0.1
    np.testing.assert_allclose(adjusted_poses[:, :3, 3] / scale, poses[:, :3, 3], atol=0.02)
    assert np.all(np.linalg.eigvalsh(information) > 0.0)


def test_truth_is_a_fixed_point() -> None:
    poses, points = scene(np.random.default_rng(3))
    rays, log_depth = observe(poses, points)
    adjusted_poses, adjusted, _ = adjust(Window(poses, points, rays, log_depth), RAY_SD, LOG_DEPTH_SD, iterations=3)
    np.testing.assert_allclose(adjusted_poses, poses, atol=1e-8)
    np.testing.assert_allclose(adjusted, points, atol=1e-7)


def test_scaled_depth_scales_the_solution() -> None:
    rng = np.random.default_rng(4)
    poses, points = scene(rng)
    rays, log_depth = observe(poses, points)
    noisy = rays + RAY_SD * rng.standard_normal(rays.shape)
    rough = log_depth + rng.normal(0.0, 0.1, (CORNERS, 1))
    factor = 1.7
    larger = poses.copy()
    larger[:, :3, 3] *= factor
    small = adjust(Window(poses, points, noisy, rough), RAY_SD, LOG_DEPTH_SD, iterations=5)
    large = adjust(Window(larger, points * factor, noisy, rough + np.log(factor)), RAY_SD, LOG_DEPTH_SD, iterations=5)
    np.testing.assert_allclose(large[1], factor * small[1], rtol=1e-4)
    np.testing.assert_allclose(large[0][:, :3, 3], factor * small[0][:, :3, 3], atol=1e-4)
    np.testing.assert_allclose(large[0][:, :3, :3], small[0][:, :3, :3], atol=1e-5)


def test_missing_observations_and_outliers_do_no_harm() -> None:
    rng = np.random.default_rng(5)
    poses, points = scene(rng)
    rays, log_depth = observe(poses, points)
    rays[rng.uniform(size=rays.shape[:2]) < 0.3] = np.nan
    log_depth[rng.uniform(size=log_depth.shape) < 0.5] = np.nan
    rays[:3, 2] += 0.2  # three corners jump by fifty pixels in one frame
    adjusted_poses, adjusted, _ = adjust(Window(poses, points, rays, log_depth), RAY_SD, LOG_DEPTH_SD, iterations=10)
    assert np.all(np.isfinite(adjusted))
    np.testing.assert_allclose(adjusted_poses[:, :3, 3], poses[:, :3, 3], atol=0.02)
    turned = adjusted_poses[:, :3, :3] @ poses[:, :3, :3].swapaxes(-1, -2)
    np.testing.assert_allclose(turned, np.broadcast_to(so3_exp(np.zeros(3)), turned.shape), atol=0.01)
