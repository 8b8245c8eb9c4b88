"""What tests of training share: a short run, a recording far from an untrained network, and progress to inspect."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from depth_helpers import TINY
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.train import EpochRecord, TrainConfig
from monoloc.progress import Step
from synthetic_room import RoomRecording

SHORT = TrainConfig(network=TINY, epochs=4, batch_size=4, learning_rate=0.03, ema_decay=0.5)
UNCERTAIN = SHORT.model_copy(update={"network": TINY.model_copy(update={"uncertainty": True})})


class FourfoldDepth(RoomRecording):
    """A depth sensor that reads four times too far: an untrained network starts far off."""

    def depth(self, index: int) -> NDArray[np.float32]:
        return super().depth(index) * np.float32(4.0)


class RecordedProgress:
    """Progress that is recorded; ``stop_at`` interrupts training after that epoch, as a power failure would."""

    def __init__(self, stop_at: int | None = None) -> None:
        self.steps: list[tuple[str, int, str]] = []
        self._stop_at = stop_at

    @contextmanager
    def task(self, name: str, total: int | None, alike: bool = True) -> Iterator[Step]:
        def step(done: int, remark: str = "", /) -> None:
            self.steps.append((name, done, remark))
            if name == "train" and done == self._stop_at:
                raise KeyboardInterrupt

        yield step


def without_seconds(history: list[EpochRecord]) -> list[EpochRecord]:
    return [replace(record, seconds=0.0) for record in history]


def weights(folder: Path) -> dict[str, Tensor]:
    return load_network(folder / "network.safetensors").state_dict()


def assert_same_weights(one: dict[str, Tensor], other: dict[str, Tensor]) -> None:
    assert one.keys() == other.keys()
    for name, tensor in one.items():
        torch.testing.assert_close(tensor, other[name], rtol=0.0, atol=0.0, msg=name)
