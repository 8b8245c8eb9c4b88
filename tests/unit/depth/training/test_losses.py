"""Losses on log-depth: their values, what they ignore, and their gradients."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.stats import laplace
from torch import Tensor

from monoloc.camera import Camera
from monoloc.depth.training.losses import (
    LossConfig,
    depth_loss,
    gradient_loss,
    laplace_loss,
    log_l1_loss,
    masked_mean,
    normal_loss,
    scale_invariant_loss,
)
from monoloc.geometry import FloatArray

pytestmark = pytest.mark.usefixtures("one_thread")

Loss = Callable[[Tensor, Tensor, Tensor], Tensor]
FOCAL_PX = 20.0
EVERY_TERM = LossConfig(log_l1=1.0, scale_invariant=0.7, gradient=0.5, normal=0.3)


def random_batch(seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Log-depth predicted and true, (2, 1, 12, 16) float64, and where the truth is known."""
    generator = torch.Generator().manual_seed(seed)
    shape = (2, 1, 12, 16)
    predicted = torch.randn(shape, dtype=torch.float64, generator=generator)
    truth = torch.randn(shape, dtype=torch.float64, generator=generator)
    return predicted, truth, torch.rand(shape, generator=generator) < 0.7


def test_log_l1_is_the_mean_absolute_log_ratio() -> None:
    depth = torch.tensor([1.0, 2.0, 3.0, 4.0]).log().reshape(1, 1, 2, 2)
    other = torch.tensor([2.0, 1.0, 3.0, 99.0]).log().reshape(1, 1, 2, 2)
    valid = torch.tensor([True, True, True, False]).reshape(1, 1, 2, 2)
    assert float(log_l1_loss(depth, other, valid)) == pytest.approx(2.0 * np.log(2.0) / 3.0)


@given(st.floats(-3.0, 3.0), st.integers(0, 100))
@settings(max_examples=10)
def test_gradient_loss_ignores_scale_and_log_l1_measures_it(offset: float, seed: int) -> None:
    _, truth, valid = random_batch(seed)
    assert float(gradient_loss(truth + offset, truth, valid)) == pytest.approx(0.0, abs=1e-12)
    assert float(log_l1_loss(truth + offset, truth, valid)) == pytest.approx(abs(offset), abs=1e-12)


def test_gradient_loss_of_a_ramp() -> None:
    """An error of 0.1 per column differs by 0.1 s across s columns and by nothing across rows."""
    ramp = (0.1 * torch.arange(16.0)).expand(1, 1, 16, 16)
    zero, valid = torch.zeros_like(ramp), torch.ones_like(ramp, dtype=torch.bool)
    expected = 0.1 * (1 + 2 + 4 + 8) / 4
    assert float(gradient_loss(ramp, zero, valid)) == pytest.approx(expected, rel=1e-5)
    assert float(gradient_loss(ramp.mT, zero, valid)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("rows", [12, 8, 3])
def test_gradient_loss_and_its_gradient_are_those_of_the_formula(rows: int) -> None:
    """Also where there are no more rows than a step, and where the truth is NaN."""
    predicted, truth, valid = (each[:, :, :rows] for each in random_batch())
    steps = (1, 2, 4, 8)
    truth = torch.where(valid, truth, torch.nan)

    def plain(x: Tensor) -> Tensor:
        error, total = x - torch.nan_to_num(truth), torch.zeros((), dtype=torch.float64)
        for step in steps:
            x_known = valid[..., step:] & valid[..., :-step]
            y_known = valid[..., step:, :] & valid[..., :-step, :]
            total = total + masked_mean((error[..., step:] - error[..., :-step]).abs(), x_known)
            total = total + masked_mean((error[..., step:, :] - error[..., :-step, :]).abs(), y_known)
        return total / len(steps)

    ours, theirs = (predicted.clone().requires_grad_(True) for _ in range(2))
    loss, expected = 3.0 * gradient_loss(ours, truth, valid), 3.0 * plain(theirs)
    loss.backward()
    expected.backward()
    assert loss.item() > 0.0
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(ours.grad, theirs.grad)


@given(st.floats(-3.0, 3.0), st.integers(0, 100))
@settings(max_examples=10)
def test_scale_invariant_loss_is_the_spread_of_the_error(offset: float, seed: int) -> None:
    predicted, truth, valid = random_batch(seed)
    spreads = [np.std((p - t)[v].numpy()) for p, t, v in zip(predicted, truth, valid, strict=True)]
    expected = pytest.approx(float(np.mean(spreads)), rel=1e-9)
    assert float(scale_invariant_loss(predicted, truth, valid)) == expected
    assert float(scale_invariant_loss(predicted + offset, truth, valid)) == expected


def test_every_image_has_a_scale_of_its_own() -> None:
    predicted, truth, valid = random_batch()
    own = torch.tensor([0.7, -1.3], dtype=torch.float64).reshape(2, 1, 1, 1)
    expected = scale_invariant_loss(predicted, truth, valid)
    torch.testing.assert_close(scale_invariant_loss(predicted + own, truth, valid), expected)


def test_pure_scale_error_has_a_finite_gradient() -> None:
    """There the root's slope is infinite."""
    truth = random_batch()[1]
    predicted = (truth + 0.4).requires_grad_(True)
    loss = scale_invariant_loss(predicted, truth, torch.ones_like(truth, dtype=torch.bool))
    loss.backward()
    assert float(loss.detach()) <= 1.001e-3
    assert predicted.grad is not None and bool(torch.isfinite(predicted.grad).all())


def log_depth_of_plane(normal: FloatArray, distance_m: float = 2.0, shape: tuple[int, int] = (16, 20)) -> Tensor:
    """Log-depth of the plane ``n . x = distance`` for a camera with a centred principal point, (1, 1, h, w)."""
    height, width = shape
    camera = Camera(width, height, FOCAL_PX, FOCAL_PX, (width - 1) / 2.0, (height - 1) / 2.0)
    return torch.from_numpy(np.log(distance_m / (camera.pixel_rays() @ normal)))[None, None]


def normal_vector(angle_rad: float, about: float) -> FloatArray:
    """A normal that leans by an angle, towards a direction in the image."""
    return np.array([np.sin(angle_rad) * np.cos(about), np.sin(angle_rad) * np.sin(about), np.cos(angle_rad)])


@given(st.floats(0.0, 0.6), st.floats(0.0, 6.28), st.floats(0.0, 0.6), st.floats(0.0, 6.28), st.floats(-2.0, 2.0))
@settings(max_examples=15)
def test_normal_loss_of_two_planes_is_one_minus_the_cosine_between_them(
    angle_rad: float, direction: float, other_rad: float, other_direction: float, log_factor: float
) -> None:
    """Whatever their distances: the loss is invariant to scale."""
    one, other = normal_vector(angle_rad, direction), normal_vector(other_rad, other_direction)
    predicted, truth = log_depth_of_plane(one), log_depth_of_plane(other, 3.0)
    valid = torch.ones_like(truth, dtype=torch.bool)
    loss = normal_loss(predicted + log_factor, truth, valid, FOCAL_PX)
    assert float(loss) == pytest.approx(1.0 - float(one @ other), abs=1e-7)


@given(st.integers(0, 100), st.floats(-2.0, 2.0))
@settings(max_examples=10)
def test_normal_loss_ignores_scale_on_any_surface(seed: int, log_factor: float) -> None:
    predicted, truth, valid = random_batch(seed)
    once, scaled, own = (
        float(normal_loss(surface, truth, valid, FOCAL_PX))
        for surface in (predicted, predicted + log_factor, truth + log_factor)
    )
    assert once > 0.1
    assert scaled == pytest.approx(once, rel=1e-9)
    assert own == pytest.approx(0.0, abs=1e-9)


def test_normals_need_a_focal_length() -> None:
    with pytest.raises(ValueError, match="the loss of normals needs focal_px"):
        depth_loss(torch.zeros(1, 1, 4, 4), torch.ones(1, 1, 16, 16), LossConfig(normal=1.0))


@given(st.integers(0, 100))
@settings(max_examples=10)
def test_most_likely_error_scale_is_the_mean_absolute_error(seed: int) -> None:
    predicted, truth, valid = random_batch(seed)
    depth_m = torch.where(valid, truth.exp(), 0.0)

    def loss(log_scale: float) -> float:
        return float(laplace_loss(predicted, torch.full_like(predicted, log_scale), depth_m))

    found = minimize_scalar(loss, bounds=(-5.0, 3.0), method="bounded", options={"xatol": 1e-7})
    assert np.exp(found.x) == pytest.approx(float((predicted - truth).abs()[valid].mean()), rel=1e-4)


def test_laplace_loss_is_scipy_s_minus_log_two() -> None:
    predicted, truth, valid = random_batch()
    log_scale = 0.3 * random_batch(1)[0]
    error = (predicted - truth)[valid].numpy()
    expected = -laplace.logpdf(error, scale=np.exp(log_scale[valid].numpy())).mean() - np.log(2.0)
    loss = laplace_loss(predicted, log_scale, torch.where(valid, truth.exp(), 0.0))
    assert float(loss) == pytest.approx(float(expected), rel=1e-9)


def test_laplace_loss_has_no_gradient_in_depth() -> None:
    predicted, truth, _ = random_batch()
    predicted.requires_grad_(True)
    log_scale = torch.zeros_like(predicted, requires_grad=True)
    laplace_loss(predicted, log_scale, truth.exp()).backward()
    assert predicted.grad is None
    assert log_scale.grad is not None and log_scale.grad.abs().min() > 0.0


def normal_loss_here(predicted: Tensor, truth: Tensor, valid: Tensor) -> Tensor:
    return normal_loss(predicted, truth, valid, FOCAL_PX)


@pytest.mark.parametrize("loss", [log_l1_loss, scale_invariant_loss, gradient_loss, normal_loss_here])
def test_masked_pixels_have_no_influence(loss: Loss) -> None:
    predicted, truth, valid = random_batch()
    predicted.requires_grad_(True)
    value = loss(predicted, truth, valid)
    (gradient,) = torch.autograd.grad(value, predicted)
    changed = torch.where(valid, truth, torch.full_like(truth, 20.0))
    also_changed = torch.where(valid, predicted.detach(), torch.full_like(truth, -30.0)).requires_grad_(True)
    other = loss(also_changed, changed, valid)
    (other_gradient,) = torch.autograd.grad(other, also_changed)
    torch.testing.assert_close(other, value)
    torch.testing.assert_close(other_gradient, gradient)
    assert not gradient[~valid].any()
    assert gradient[valid].any()


def test_masked_pixels_have_no_influence_on_the_stated_error() -> None:
    predicted, truth, valid = random_batch()
    log_scale = torch.zeros_like(predicted, requires_grad=True)
    depth_m = torch.where(valid, truth.exp(), 0.0)
    value = laplace_loss(predicted, log_scale, depth_m)
    (gradient,) = torch.autograd.grad(value, log_scale)
    other = torch.where(valid, predicted, torch.full_like(predicted, -30.0))
    torch.testing.assert_close(laplace_loss(other, log_scale, depth_m), value)
    assert not gradient[~valid].any() and gradient[valid].any()


@pytest.mark.parametrize("loss", [log_l1_loss, scale_invariant_loss, gradient_loss, normal_loss_here])
def test_terms_have_the_correct_gradient(loss: Loss) -> None:
    predicted, truth, valid = random_batch()
    predicted = predicted[:1, :, :, :10].clone().requires_grad_(True)
    truth, valid = truth[:1, :, :, :10], valid[:1, :, :, :10]
    assert torch.autograd.gradcheck(lambda x: loss(x, truth, valid), predicted)


def test_stated_error_has_the_correct_gradient() -> None:
    predicted, truth, valid = random_batch()
    depth_m = torch.where(valid, truth.exp(), 0.0)
    log_scale = 0.3 * random_batch(1)[0][:, :, ::4, ::4].clone()
    assert torch.autograd.gradcheck(lambda x: laplace_loss(predicted, x, depth_m), log_scale.requires_grad_(True))


def test_depth_loss_is_the_weighted_sum_of_its_terms() -> None:
    predicted, truth, valid = random_batch()
    depth_m = torch.where(valid, truth.exp(), 0.0)
    terms = {
        "log_l1": log_l1_loss,
        "scale_invariant": scale_invariant_loss,
        "gradient": gradient_loss,
        "normal": normal_loss_here,
    }
    assert terms.keys() == LossConfig.model_fields.keys()
    weights = EVERY_TERM.model_dump()
    expected = sum(weights[name] * term(predicted, truth, valid) for name, term in terms.items())
    torch.testing.assert_close(depth_loss(predicted, depth_m, EVERY_TERM, FOCAL_PX), expected)


def test_without_truth_there_is_neither_loss_nor_gradient() -> None:
    predicted = torch.zeros(1, 1, 8, 8, requires_grad=True)
    log_scale = torch.zeros(1, 1, 8, 8, requires_grad=True)
    nothing = torch.zeros(1, 1, 32, 32)
    loss = depth_loss(predicted, nothing, EVERY_TERM, focal_px=46.0) + laplace_loss(predicted, log_scale, nothing)
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0.0, abs=2e-3)  # the root of a variance has a lower bound
    assert log_scale.grad is not None and not log_scale.grad.any()
    assert predicted.grad is not None and not predicted.grad.any()
    assert float(masked_mean(torch.ones(3), torch.zeros(3, dtype=torch.bool))) == 0.0


def test_zero_depth_is_missing_depth() -> None:
    depth_m = torch.full((1, 1, 16, 16), 3.0)
    log_predicted = torch.full((1, 1, 4, 4), float(np.log(6.0)))
    assert float(depth_loss(log_predicted, depth_m, LossConfig())) == pytest.approx(np.log(2.0), rel=1e-5)
    depth_m[..., :8, :] = 0.0
    log_predicted[..., 0, :] = 50.0  # the row of the prediction farthest from any truth
    assert float(depth_loss(log_predicted, depth_m, LossConfig())) == pytest.approx(np.log(2.0), rel=1e-5)


@pytest.mark.parametrize("weights", [LossConfig(), EVERY_TERM])
def test_depth_loss_has_the_correct_gradient(weights: LossConfig) -> None:
    generator = torch.Generator().manual_seed(0)
    depth_m = 1.0 + torch.rand(1, 1, 10, 11, dtype=torch.float64, generator=generator)
    depth_m[0, 0, 2:4, 3:6] = 0.0
    predicted = torch.randn(1, 1, 3, 4, dtype=torch.float64, generator=generator, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: depth_loss(x, depth_m, weights, FOCAL_PX), predicted)
