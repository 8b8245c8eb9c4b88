"""Selection of the frames on which the learning rates of PoseNets are compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def hold_out_blocks(frames: int, blocks: int, share: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split frames in time order: (training, held out), with held-out blocks spread over the recording.

    Blocks rather than single frames, because neighbouring frames show nearly the same image.
    """
    length = max(1, round(frames * share / blocks))
    starts = np.linspace(0, frames, blocks + 2)[1:-1] - length / 2
    held_out = np.unique(np.clip(np.concatenate([np.arange(length) + round(s) for s in starts]), 0, frames - 1))
    return np.setdiff1d(np.arange(frames), held_out), held_out
