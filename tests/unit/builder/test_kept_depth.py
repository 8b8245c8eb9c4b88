"""Depth images that a build keeps."""

from __future__ import annotations

import numpy as np
import pytest

from depth_helpers import small_recording
from monoloc.builder import kept_depth
from monoloc.builder.kept_depth import KeptDepth


def test_depth_is_read_once_as_far_as_memory_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = small_recording(5)
    expected = [recording.depth(index) for index in range(5)]
    monkeypatch.setattr(kept_depth, "_MOST_BYTES", 3 * expected[0].nbytes)
    read: list[int] = []
    depth_of = recording.depth

    def counted(index: int) -> np.ndarray:  # type: ignore[type-arg]
        read.append(index)
        return depth_of(index)

    monkeypatch.setattr(recording, "depth", counted)
    kept = KeptDepth(recording)
    for _ in range(2):
        for index in range(5):
            np.testing.assert_array_equal(kept.depth(index), expected[index])
    assert read == [0, 1, 2, 3, 4, 3, 4]
    assert kept.frame_names == recording.frame_names and kept.has_depth
