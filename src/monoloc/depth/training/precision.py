"""Training precision: bfloat16 only where it is faster."""

from __future__ import annotations

import torch


def learns_in_bfloat16(device_type: str) -> bool:
    """Whether to compute convolutions in bfloat16 during training, rather than float32.

    GPUs multiply bfloat16 faster, and so do CPUs with AVX-512, with or without dedicated instructions. Other CPUs
    emulate it: with AVX2, a tuning step takes ten times as long as in float32.

    Args:
        device_type: as in :attr:`torch.device.type`.
    """
    return device_type != "cpu" or torch.backends.cpu.get_cpu_capability() == "AVX512"
