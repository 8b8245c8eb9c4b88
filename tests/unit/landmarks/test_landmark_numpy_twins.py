"""The native kernels of landmarks against their NumPy twins."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc import _core
from monoloc.landmarks import landmark_numpy_twins


@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.integers(0, 40), st.sampled_from([3, 30]))
@settings(max_examples=100, deadline=None)
def test_matches_equal_twin(seed: int, landmarks: int, keypoints: int, width: int) -> None:
    """Also where many are as near and look the same, and where pixels are unknown."""
    rng = np.random.default_rng(seed)
    expected, pixels = (rng.integers(0, width, (count, 2)).astype(float) for count in (landmarks, keypoints))
    expected[rng.uniform(size=expected.shape) < 0.1] = np.nan
    pixels[rng.uniform(size=pixels.shape) < 0.1] = np.nan
    appearances = rng.integers(0, 256, (3, 32)).astype(np.uint8)
    known, seen = (
        appearances[rng.integers(3, size=count)] ^ (rng.uniform(size=(count, 32)) < 0.05).astype(np.uint8)
        for count in (landmarks, keypoints)
    )
    native = _core.match_descriptors(expected, known, pixels, seen, 3.0, 64)
    twin = landmark_numpy_twins.match_descriptors(expected, known, pixels, seen, 3.0, 64)
    np.testing.assert_array_equal(native, twin)
