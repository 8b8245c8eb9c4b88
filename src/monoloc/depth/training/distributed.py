"""Distributed training over several processes under ``torchrun``; a single process otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import distributed, nn


@dataclass(frozen=True)
class Worker:
    """This process in a training run.

    Attributes:
        rank: index of the process; rank 0 validates, writes files and reports progress.
        count: number of processes.
        device: device of this process.
    """

    rank: int
    count: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        return self.rank == 0

    def wrap(self, network: nn.Module) -> nn.Module:
        """Wrap the network so that gradients are averaged over all workers."""
        return network if self.count == 1 else nn.parallel.DistributedDataParallel(network)

    def mean(self, value: torch.Tensor) -> float:
        """Mean of a scalar over all workers."""
        if self.count > 1:
            distributed.all_reduce(value)
        return float(value) / self.count


@contextmanager
def training_worker() -> Iterator[Worker]:
    """Set up this process: GPUs over NCCL if there are any, else CPUs over Gloo."""
    has_gpu = torch.cuda.is_available()
    if not distributed.is_torchelastic_launched():
        yield Worker(0, 1, torch.device("cuda" if has_gpu else "cpu"))
        return
    distributed.init_process_group("nccl" if has_gpu else "gloo")
    try:
        rank = distributed.get_rank()
        device = torch.device("cuda", rank % torch.cuda.device_count()) if has_gpu else torch.device("cpu")
        if has_gpu:
            torch.cuda.set_device(device)
        yield Worker(rank, distributed.get_world_size(), device)
    finally:
        distributed.destroy_process_group()
