"""How the learning rate of a training goes up and down."""

from __future__ import annotations

from torch.optim import Optimizer
from torch.optim.lr_scheduler import OneCycleLR


def one_cycle(optimizer: Optimizer, steps: int) -> OneCycleLR:
    """Smith's one cycle over so many steps: in a tenth of them every group's rate rises to its own, then falls."""
    rise = 0.1 if steps != 10 else 0.2  # torch divides by the rise's steps less one
    return OneCycleLR(optimizer, [group["lr"] for group in optimizer.param_groups], total_steps=steps, pct_start=rise)
