"""Losses on log-depth. All take (B, 1, H, W) predictions and truth and a boolean mask of valid truth."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def masked_mean(values: Tensor, valid: Tensor) -> Tensor:
    """Mean over the valid entries; zero, with a gradient of zero, when there are none."""
    return torch.where(valid, values, 0.0).sum() / valid.sum().clamp(min=1)


def log_l1_loss(log_predicted: Tensor, log_truth: Tensor, valid: Tensor) -> Tensor:
    """Mean absolute error of log-depth: a relative error, equal for near and far."""
    return masked_mean((log_predicted - log_truth).abs(), valid)


def gradient_loss(
    log_predicted: Tensor, log_truth: Tensor, valid: Tensor, steps: tuple[int, ...] = (1, 2, 4, 8)
) -> Tensor:
    """Mean absolute difference of log-depth gradients over several pixel steps (Li & Snavely, MegaDepth, 2018).

    It asks for sharp steps and smooth planes where the plain error is content with blur.
    """
    error = log_predicted - log_truth
    total = log_predicted.new_zeros(())
    for step in steps:
        along_x = (error[..., step:] - error[..., :-step]).abs()
        along_y = (error[..., step:, :] - error[..., :-step, :]).abs()
        total = total + masked_mean(along_x, valid[..., step:] & valid[..., :-step])
        total = total + masked_mean(along_y, valid[..., step:, :] & valid[..., :-step, :])
    return total / len(steps)


def depth_loss(log_predicted: Tensor, depth_m: Tensor, gradient_weight: float) -> Tensor:
    """Training loss of a prediction at any resolution against a depth image, 0 where there is no truth.

    Args:
        log_predicted: (B, 1, h, w) log-depth; brought to the truth's size bilinearly.
        depth_m: (B, 1, H, W) metres.
        gradient_weight: weight of :func:`gradient_loss` beside :func:`log_l1_loss`.
    """
    log_predicted = F.interpolate(log_predicted, size=depth_m.shape[-2:], mode="bilinear", align_corners=False)
    valid = depth_m > 0.0
    log_truth = torch.log(depth_m.clamp(min=1e-3))
    loss = log_l1_loss(log_predicted, log_truth, valid)
    if gradient_weight > 0.0:
        loss = loss + gradient_weight * gradient_loss(log_predicted, log_truth, valid)
    return loss
