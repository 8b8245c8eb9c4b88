"""The precision in which a network learns: half the bits only where that is the faster."""

from __future__ import annotations

import torch


def learns_in_bfloat16(device_type: str) -> bool:
    """Whether convolutions are learned in bfloat16, or else in float32.

    GPUs multiply it faster, and so does AVX-512, with or without instructions of its own for it. Other processors
    emulate it: with AVX2 a step of tuning takes ten times as long as in float32.

    Args:
        device_type: as :attr:`torch.device.type` has it.
    """
    return device_type != "cpu" or torch.backends.cpu.get_cpu_capability() == "AVX512"
