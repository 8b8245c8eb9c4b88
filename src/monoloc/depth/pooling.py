"""Max-pooling for training on a processor: PyTorch's takes a third of a step there, ours a tenth of that."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from monoloc import _core

_MOST_PIXELS = 65536  # of an image; the kernel counts them in 16 bits


def max_pool5(x: Tensor) -> Tensor:
    """5 x 5 max-pooling with stride 1 and the same size, (N, C, H, W).

    In bfloat16 with a gradient on a CPU, by a kernel of ours: with the results of
    :func:`torch.nn.functional.max_pool2d`, the first of several largest values having the gradient, which is added up
    in float32.
    """
    if x.requires_grad and x.dtype == torch.bfloat16 and x.device.type == "cpu" and x[0, 0].numel() <= _MOST_PIXELS:
        pooled: Tensor = _MaxPool5.apply(x)  # type: ignore[no-untyped-call]
        return pooled
    return F.max_pool2d(x, 5, stride=1, padding=2)


class _MaxPool5(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        values = _channels_last_bits(x)
        largest, ctx.came_from = torch.empty_like(values), torch.empty_like(values)
        _core.max_pool(values.numpy(), torch.get_num_threads(), largest.numpy(), ctx.came_from.numpy())
        return _images(largest)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:
        gradient = _channels_last_bits(gradients[0])
        out = torch.empty_like(gradient)
        _core.max_pool_gradient(gradient.numpy(), ctx.came_from.numpy(), torch.get_num_threads(), out.numpy())
        return _images(out)


def _channels_last_bits(x: Tensor) -> Tensor:
    """(N, C, H, W) bfloat16 -> (N, H, W, C) uint16."""
    return x.detach().permute(0, 2, 3, 1).contiguous().view(torch.uint16)


def _images(bits: Tensor) -> Tensor:
    return bits.view(torch.bfloat16).permute(0, 3, 1, 2)
