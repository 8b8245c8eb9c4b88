"""Max-pooling for training on a CPU, alone and in chains; PyTorch's takes a third of a training step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

import monoloc._core as _core

_Values = NDArray[np.float32] | NDArray[np.uint16]


def max_pool5(x: Tensor) -> Tensor:
    """5 x 5 max-pooling with stride 1 and unchanged size, (N, C, H, W).

    With gradients on a CPU it uses a kernel of its own, for float32 and bfloat16. The values equal those of
    :func:`torch.nn.functional.max_pool2d`; among equal maxima the first gets the gradient, which is accumulated in
    float32. The kernel does not handle NaN and has no second derivative.
    """
    if has_kernels(x) and x.shape[-2] * x.shape[-1] <= _core.MOST_POOLED_PIXELS:
        pooled: Tensor = _MaxPool5.apply(x)  # type: ignore[no-untyped-call]
        return pooled
    return F.max_pool2d(x, 5, stride=1, padding=2)


def chained_pools(x: Tensor, weights: Sequence[Tensor]) -> Tensor:
    """Chained residual pooling with one weight per stage and channel, then a last weight and ReLU6, (N, C, H, W).

    ``relu6(w_n * (x + p_1 + ... + p_n))`` with ``p_0 = x`` and ``p_(i+1) = w_i * max_pool5(p_i)``, channel by
    channel, so that what lies between stays in the cache. In bfloat16 only the result is rounded.

    Args:
        x: images for which :func:`has_kernels` holds.
        weights: one of C elements for each stage, and the last.
    """
    stacked = torch.stack([weight.flatten() for weight in weights]).float()
    chained: Tensor = _ChainedPools.apply(x, stacked)  # type: ignore[no-untyped-call]
    return chained


def has_kernels(x: Tensor) -> bool:
    """Whether kernels of the core compute an image's pooling: with gradients on a CPU, in float32 and bfloat16."""
    return x.requires_grad and x.dtype in (torch.float32, torch.bfloat16) and x.device.type == "cpu"


class _MaxPool5(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        values = _channels_last(x)
        largest, ctx.came_from = np.empty_like(values), np.empty(values.shape, np.uint16)
        _core.max_pool(values, torch.get_num_threads(), largest, ctx.came_from)
        return _images(largest)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        gradient = _channels_last(gradients[0])
        out = np.empty_like(gradient)
        _core.max_pool_gradient(gradient, ctx.came_from, torch.get_num_threads(), out)
        return _images(out)


class _ChainedPools(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(x, weights)
        values = _channels_last(x)
        out = np.empty_like(values)
        _core.chain_pools(values, weights.detach().numpy(), torch.get_num_threads(), out)
        return _images(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        x, weights = ctx.saved_tensors
        values, gradient = _channels_last(x), _channels_last(gradients[0])
        out, of_weights = np.empty_like(values), np.empty((len(x), *weights.shape), np.float32)
        # The stages between are computed again: to keep them would take more memory traffic.
        _core.chain_pools_gradient(values, gradient, weights.numpy(), torch.get_num_threads(), out, of_weights)
        return _images(out), torch.from_numpy(of_weights).sum(0)


def _channels_last(x: Tensor) -> Any:
    """(N, C, H, W) -> (N, H, W, C): float32, or the bits of bfloat16 as uint16."""
    rows = x.detach().permute(0, 2, 3, 1).contiguous()
    return rows.view(torch.int16).numpy().view(np.uint16) if x.dtype == torch.bfloat16 else rows.numpy()


def _images(values: _Values) -> Tensor:
    """Inverse of :func:`_channels_last`: (N, H, W, C) -> (N, C, H, W)."""
    if values.dtype == np.uint16:
        return torch.from_numpy(values.view(np.int16)).view(torch.bfloat16).permute(0, 3, 1, 2)
    return torch.from_numpy(values).permute(0, 3, 1, 2)
