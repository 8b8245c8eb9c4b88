"""Losses on log-depth; all take (B, 1, H, W) predictions and truth, and a boolean mask of valid truth."""

from __future__ import annotations

from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

_GRADIENT_STEPS = (1, 2, 4, 8)  # pixels; fine ones for edges, coarse ones for planes
_NORMAL_STEP = 8  # pixels; sensor depth is too coarse for normals from adjacent pixels


class LossConfig(BaseModel):
    """Weights of the terms of :func:`depth_loss`.

    Attributes:
        log_l1: weight of :func:`log_l1_loss`.
        scale_invariant: weight of :func:`scale_invariant_loss`.
        gradient: weight of :func:`gradient_loss`.
        normal: weight of :func:`normal_loss`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    log_l1: float = Field(1.0, ge=0.0)
    scale_invariant: float = Field(0.0, ge=0.0)
    gradient: float = Field(0.5, ge=0.0)
    normal: float = Field(0.0, ge=0.0)


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean over the valid entries; if there are none, zero with a zero gradient."""
    return torch.where(valid, values, 0.0).sum() / valid.sum().clamp(min=1)


def log_l1_loss(log_predicted: Tensor, log_truth: Tensor, valid: Tensor) -> Tensor:
    """Mean absolute error of log-depth: a relative error, independent of distance."""
    return masked_mean((log_predicted - log_truth).abs(), valid)


def scale_invariant_loss(log_predicted: Tensor, log_truth: Tensor, valid: Tensor) -> Tensor:
    """Standard deviation of the log-depth error within an image, mean over images: the error that no scale explains.

    Root form of Eigen, Puhrsch & Fergus (2014), eq. 4, with lambda = 1.
    """
    error = torch.where(valid, log_predicted - log_truth, 0.0).flatten(1)
    count = valid.flatten(1).sum(1).clamp(min=1)
    mean = error.sum(1) / count
    variance = error.square().sum(1) / count - mean.square()
    known = valid.flatten(1).any(1)
    return masked_mean(variance.clamp(min=1e-6).sqrt(), known)


def gradient_loss(log_predicted: Tensor, log_truth: Tensor, valid: Tensor) -> Tensor:
    """Mean absolute difference of log-depth gradients over 1, 2, 4 and 8 pixels (Li & Snavely, MegaDepth, 2018).

    It favours sharp depth edges and smooth planes, where the plain error tolerates blur.
    """
    # Unknown truth may be NaN, which multiplication by a mask would not remove.
    error = torch.where(valid, log_predicted - log_truth, 0.0)
    loss: Tensor = _GradientLoss.apply(error, valid)  # type: ignore[no-untyped-call]
    return loss


class _GradientLoss(torch.autograd.Function):
    """The gradient is the sum of the differences' signs; computed in place, it takes a third of autograd's time."""

    @staticmethod
    def forward(ctx: Any, error: Tensor, valid: Tensor) -> Tensor:
        mask, gradient, total = valid.to(error.dtype), torch.zeros_like(error), error.new_zeros(())
        for step in _GRADIENT_STEPS:
            for along in (-1, -2):
                length = error.shape[along] - step
                if length <= 0:
                    continue
                near, far = ((along, at, length) for at in (0, step))
                known = mask.narrow(*near) * mask.narrow(*far)
                difference = (error.narrow(*far) - error.narrow(*near)).mul_(known)
                share = 1.0 / (len(_GRADIENT_STEPS) * known.sum().clamp(min=1.0))
                total += share * difference.abs().sum()
                difference.sign_().mul_(share)
                gradient.narrow(*far).add_(difference)
                gradient.narrow(*near).sub_(difference)
        ctx.save_for_backward(gradient)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, loss_gradient: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return loss_gradient * gradient, None


def normal_loss(log_predicted: Tensor, log_truth: Tensor, valid: Tensor, focal_px: float) -> Tensor:
    """Mean of one minus the cosine between the normals of predicted and true surfaces (Hu et al. 2019).

    Normals span :data:`_NORMAL_STEP` pixels. The principal point is assumed at the image centre; a shift of it shears
    both surfaces equally.
    """
    step = _NORMAL_STEP
    known = valid[..., step:, step:] & valid[..., :-step, step:] & valid[..., step:, :-step]
    cosine = F.cosine_similarity(_normals(log_predicted, focal_px), _normals(log_truth, focal_px), dim=1)
    return masked_mean(1.0 - cosine[:, None], known)


def _normals(log_depth: Tensor, focal_px: float) -> Tensor:
    """Unnormalised surface normals of a log-depth image: (B, 3, H - step, W - step)."""
    height, width = log_depth.shape[-2:]
    x = (torch.arange(width, device=log_depth.device) - (width - 1) / 2.0) / focal_px
    y = (torch.arange(height, device=log_depth.device) - (height - 1) / 2.0) / focal_px
    rays = torch.stack([x.expand(height, width), y[:, None].expand(height, width), torch.ones_like(log_depth[0, 0])])
    points = rays * log_depth.exp()
    corner = points[..., _NORMAL_STEP:, _NORMAL_STEP:]
    across = corner - points[..., _NORMAL_STEP:, :-_NORMAL_STEP]
    down = corner - points[..., :-_NORMAL_STEP, _NORMAL_STEP:]
    return torch.cross(across, down, dim=1)


def depth_loss(log_predicted: Tensor, depth_m: Tensor, weights: LossConfig, focal_px: float | None = None) -> Tensor:
    """Training loss of a prediction at any resolution against a depth image.

    Args:
        log_predicted: (B, 1, h, w) log-depth; resized bilinearly to the truth's size.
        depth_m: (B, 1, H, W) metres, 0 where there is no truth.
        weights: weights of the terms.
        focal_px: focal length of the truth's pixels; only the normal term needs it.

    Raises:
        ValueError: the normal term has weight but no focal length is given.
    """
    log_predicted, log_truth, valid = _at_truth(log_predicted, depth_m)
    loss = weights.log_l1 * log_l1_loss(log_predicted, log_truth, valid)
    if weights.scale_invariant > 0.0:
        loss = loss + weights.scale_invariant * scale_invariant_loss(log_predicted, log_truth, valid)
    if weights.gradient > 0.0:
        loss = loss + weights.gradient * gradient_loss(log_predicted, log_truth, valid)
    if weights.normal > 0.0:
        if focal_px is None:
            raise ValueError("the loss of normals needs focal_px")
        loss = loss + weights.normal * normal_loss(log_predicted, log_truth, valid, focal_px)
    return loss


def laplace_loss(log_predicted: Tensor, log_scale: Tensor, depth_m: Tensor) -> Tensor:
    """Negative log-likelihood of the log-depth error under a Laplace density, minus log 2: ``|e| / b + log b``, nats.

    Args:
        log_predicted: (B, 1, h, w) log-depth; detached, so that the loss does not worsen depth to gain certainty.
        log_scale: (B, 1, h, w) natural logarithm of the scale b (Kendall & Gal 2017).
        depth_m: (B, 1, H, W) metres, 0 where there is none.
    """
    log_predicted, log_truth, valid = _at_truth(log_predicted.detach(), depth_m)
    log_scale = F.interpolate(log_scale, size=depth_m.shape[-2:], mode="bilinear", align_corners=False)
    return masked_mean((log_predicted - log_truth).abs() * torch.exp(-log_scale) + log_scale, valid)


def _at_truth(log_predicted: Tensor, depth_m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Prediction at the truth's size, log of the truth, and its valid mask."""
    log_predicted = F.interpolate(log_predicted, size=depth_m.shape[-2:], mode="bilinear", align_corners=False)
    return log_predicted, torch.log(depth_m.clamp(min=1e-3)), depth_m > 0.0
