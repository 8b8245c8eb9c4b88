"""Learning-rate schedule of training."""

from __future__ import annotations

from torch.optim import Optimizer
from torch.optim.lr_scheduler import OneCycleLR


def one_cycle(optimizer: Optimizer, steps: int) -> OneCycleLR:
    """Smith's one-cycle schedule: every group's rate rises to its own value in a tenth of the steps, then falls."""
    rise = 0.1 if steps != 10 else 0.2  # torch divides by the number of rising steps minus one
    return OneCycleLR(optimizer, [group["lr"] for group in optimizer.param_groups], total_steps=steps, pct_start=rise)
