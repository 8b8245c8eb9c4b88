"""Multiply-adds of a network."""

from __future__ import annotations

import torch
from torch.utils.flop_counter import FlopCounterMode

from depth_helpers import TINY, UNCERTAIN, tiny_network


def test_multiply_adds_are_half_the_operations_that_torch_counts() -> None:
    for config in (TINY, UNCERTAIN):
        network = tiny_network(config=config)
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            network.with_error(torch.zeros(1, 3, 64, 96))
        assert 2 * network.multiply_adds(96, 64) == counter.get_total_flops()
