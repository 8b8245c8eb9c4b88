"""Errors of depth as steps of the camera: the linear map between them, and the loss on it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck

from depth_helpers import ROOM, looking_around
from monoloc.adapt.pose_step import pose_step_loss, pose_steps
from monoloc.camera import Camera
from monoloc.geometry import FloatArray, se3_exp

CAMERA = Camera(40, 32, 34.0, 36.0, 18.3, 16.4)
RAYS = CAMERA.pixel_rays()


def depth_from(pose: FloatArray) -> FloatArray:
    return ROOM.view(pose, CAMERA)[1].astype(np.float64)


def step_of(depth_m: FloatArray, log_error: FloatArray, prior_sd: float = 0.1) -> FloatArray:
    """The step (6,) that errors of log-depth (h, w) cause."""
    steps = pose_steps(depth_m[None].astype(np.float32), RAYS, prior_sd)[0].double().numpy()
    return np.asarray(steps @ log_error.ravel())


def lone_wall(distance_m: float) -> FloatArray:
    return np.full(RAYS.shape[:2], distance_m)


@given(seed=st.integers(0, 1000))
@settings(max_examples=15)
def test_errors_that_look_like_a_motion_cause_it(seed: int) -> None:
    """Depth as seen from another pose, taken for one's own, moves the estimate to that pose.

    What is seen may not determine the pose itself, so depth is compared, away from edges, under a loose prior.
    """
    rng = np.random.default_rng(seed)
    pose = looking_around(8, seed)[int(rng.integers(8))]
    truth = depth_from(pose)
    error = np.log(depth_from(pose @ se3_exp(1e-3 * rng.normal(size=6))) / truth)
    same_surface = np.abs(error) < 0.05
    step = step_of(truth, np.where(same_surface, error, 0.0), prior_sd=10.0)
    left = error - np.log(depth_from(pose @ se3_exp(step)) / truth)
    # Over all these seeds a hundredth to a tenth is left, and half where edges fill the image.
    assert np.median(np.abs(left[same_surface])) < 0.6 * np.median(np.abs(error[same_surface]))


def test_step_is_the_least_squares_solution() -> None:
    """Against a solver that is given every pixel's Jacobian, by differences, and the prior as rows."""
    truth, h = depth_from(np.eye(4)), 1e-5
    flat_error = 0.05 * np.random.default_rng(0).normal(size=truth.size)

    # A Jacobian by differences: a surface's plane at each pixel, seen from a camera moved a little.
    points = (RAYS * truth[..., None]).astype(np.float64)
    normals = np.zeros_like(points)
    normals[1:-1, 1:-1] = np.cross(
        points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1], axis=-1
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    offset = np.einsum("ijk,ijk->ij", normals, points)
    used = (pose_steps(truth[None].astype(np.float32), RAYS)[0] != 0.0).any(0).numpy().reshape(truth.shape)
    columns = []
    for axis in range(6):
        moved = se3_exp(h * np.eye(6)[axis])
        turned = RAYS @ moved[:3, :3].T
        depth = (offset - normals @ moved[:3, 3]) / np.where(used, np.einsum("ijk,ijk->ij", normals, turned), 1.0)
        columns.append((np.log(np.where(used, depth, 1.0)) - np.log(np.where(used, truth, 1.0)))[used] / h)
    jacobian = np.stack(columns, axis=1)
    variance = 0.08**2 + (0.03 / np.abs(offset[used])) ** 2
    root = np.sqrt(30.0 / used.sum() / variance)
    rows = np.vstack([jacobian * root[:, None], np.diag(np.full(6, 1.0 / 0.1))])
    right = np.concatenate([flat_error[used.ravel()] * root, np.zeros(6)])
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(step_of(truth, flat_error.reshape(truth.shape)), expected, rtol=2e-3, atol=1e-5)


def test_unobservable_directions_stay_at_zero() -> None:
    """A wall that comes out too far away moves the camera back, not along it."""
    step = step_of(lone_wall(2.0), np.full((32, 40), 0.05))
    assert step[2] < -0.05
    np.testing.assert_allclose(step[[0, 1, 5]], 0.0, atol=5e-3)


def test_pixels_at_edges_or_without_depth_have_no_influence() -> None:
    depth = lone_wall(2.0)
    depth[:, 20:] = 3.0
    depth[5, 7] = 0.0
    used = (pose_steps(depth[None].astype(np.float32), RAYS)[0] != 0.0).any(0).numpy().reshape(32, 40)
    expected = np.zeros((32, 40), dtype=np.bool_)
    expected[1:-1, 1:-1] = True
    expected[:, 19:21] = False
    for row, column in ((5, 7), (4, 7), (6, 7), (5, 6), (5, 8)):
        expected[row, column] = False
    np.testing.assert_array_equal(used, expected)


@pytest.mark.parametrize("known", [0, 2])
def test_too_little_depth_gives_no_step_and_no_gradient(known: int) -> None:
    depth = np.zeros((1, 32, 40), dtype=np.float32)
    depth[0, 10, 10 : 10 + known] = 2.0
    steps = pose_steps(depth, RAYS)
    assert not steps.any()
    log_depth = torch.zeros(1, 1, 32, 40, requires_grad=True)
    pose_step_loss(log_depth, torch.from_numpy(depth)[:, None], steps).backward()  # type: ignore[no-untyped-call]
    assert log_depth.grad is not None and not log_depth.grad.any()


def test_correct_depth_has_no_loss_and_a_finite_gradient() -> None:
    depth = torch.from_numpy(depth_from(np.eye(4)).astype(np.float32))[None, None]
    log_depth = depth.log().requires_grad_(True)
    loss = pose_step_loss(log_depth, depth, pose_steps(depth[:, 0].numpy(), RAYS))
    loss.backward()  # type: ignore[no-untyped-call]
    assert loss.item() == pytest.approx(0.0, abs=2e-3)
    assert log_depth.grad is not None and bool(torch.isfinite(log_depth.grad).all())


def test_loss_is_the_mean_length_of_the_steps_and_bounded() -> None:
    depths = np.stack([depth_from(pose) for pose in looking_around(3)]).astype(np.float32)
    truth, steps = torch.from_numpy(depths)[:, None], pose_steps(depths, RAYS)
    error = 0.1 * torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    lengths = [
        np.linalg.norm(step_of(d.astype(np.float64), e[0].numpy())) for d, e in zip(depths, error, strict=True)
    ]
    assert float(pose_step_loss(truth.log() + error, truth, steps)) == pytest.approx(np.mean(lengths), rel=2e-2)
    far, farther = (float(pose_step_loss(truth.log() + by, truth, steps)) for by in (1.0, 2.0))
    assert far == farther


def test_loss_has_the_correct_gradient() -> None:
    depth = torch.from_numpy(depth_from(np.eye(4))[None, None, ::4, ::4])
    rays = RAYS[::4, ::4]
    steps = pose_steps(depth[:, 0].float().numpy(), rays).double()

    def loss(log_depth: Tensor) -> Tensor:
        return pose_step_loss(log_depth, depth, steps)

    error = 0.05 * torch.randn(depth.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert steps.any()
    assert gradcheck(loss, (depth.log() + error).requires_grad_(True))
