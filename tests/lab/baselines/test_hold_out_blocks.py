"""Frames that are held out of a PoseNet's training: blocks in time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc_lab.baselines.hold_out_blocks import hold_out_blocks


@settings(max_examples=50)
@given(st.integers(20, 600), st.integers(1, 6), st.floats(0.02, 0.3))
def test_blocks_partition_the_frames_into_runs(frames: int, blocks: int, share: float) -> None:
    training, held_out = hold_out_blocks(frames, blocks, share)
    assert sorted([*training, *held_out]) == list(range(frames))  # disjoint, and together everything
    assert len(training) > 0 and len(held_out) > 0
    runs = 1 + int((np.diff(held_out) > 1).sum())
    assert runs <= blocks
    if share * frames >= 2 * blocks:
        assert len(held_out) == pytest.approx(share * frames, abs=blocks)
        assert runs == blocks


def test_few_frames_can_be_split() -> None:
    for frames in range(5, 20):
        training, held_out = hold_out_blocks(frames, 3, 0.12)
        assert len(training) >= 2 and len(held_out) >= 1
