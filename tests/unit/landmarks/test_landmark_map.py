"""The landmark map."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.landmarks.landmark_map import Landmarks


def test_a_landmark_takes_44_bytes() -> None:
    assert Landmarks(np.zeros((7, 3), np.float32), np.zeros((7, 32), np.uint8)).bytes == 7 * 44
    assert len(Landmarks.none()) == Landmarks.none().bytes == 0


def test_other_types_are_refused() -> None:
    with pytest.raises(ValueError, match="must be float32 and uint8, got float64 and uint8"):
        Landmarks(np.zeros((2, 3)), np.zeros((2, 32), np.uint8))  # type: ignore[arg-type]


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be \(L, 3\) and \(L, 32\), got \(2, 3\) and \(2, 31\)"):
        Landmarks(np.zeros((2, 3), np.float32), np.zeros((2, 31), np.uint8))
