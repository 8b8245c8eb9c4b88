"""The one-cycle schedule of the learning rate."""

from __future__ import annotations

import pytest
import torch

from monoloc.depth.training.schedule import one_cycle


@pytest.mark.parametrize("steps", [1, 2, 9, 10, 11, 20, 100])
def test_rates_rise_to_their_own_maximum_and_fall(steps: int) -> None:
    """A tenth of the steps may be one step, or none."""
    groups = [{"params": [torch.nn.Parameter(torch.zeros(1))], "lr": lr} for lr in (0.1, 0.01)]
    optimizer = torch.optim.SGD(groups)
    schedule, rates = one_cycle(optimizer, steps), []
    for _ in range(steps):
        rates.append([group["lr"] for group in optimizer.param_groups])
        optimizer.step()
        if len(rates) < steps:
            schedule.step()
    first, second = map(torch.tensor, zip(*rates, strict=True))
    torch.testing.assert_close(second, 0.1 * first)
    assert first.max() <= 0.1 and torch.isfinite(first).all()
    peak = int(first.argmax())
    assert (first[: peak + 1].diff() >= 0.0).all() and (first[peak:].diff() <= 0.0).all()
    if steps >= 20:
        assert first.max() == pytest.approx(0.1) and peak < 0.2 * steps and first[-1] < 1e-3
