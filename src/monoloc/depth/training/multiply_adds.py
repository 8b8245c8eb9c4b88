"""Computational cost of a network."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn


@torch.no_grad()
def multiply_adds(network: nn.Module, run: Callable[[], object]) -> int:
    """Count the multiply-adds of a network's convolutions and fully connected layers for one image.

    Args:
        network: the network whose layers are counted.
        run: runs the network once.
    """
    count = 0

    def add(layer: nn.Module, _: object, output: Tensor) -> None:
        nonlocal count
        assert isinstance(layer, nn.Conv2d | nn.Linear)
        count += output[0].numel() * layer.weight[0].numel()

    layers = [layer for layer in network.modules() if isinstance(layer, nn.Conv2d | nn.Linear)]
    hooks = [layer.register_forward_hook(add) for layer in layers]
    run()
    for hook in hooks:
        hook.remove()
    return count
