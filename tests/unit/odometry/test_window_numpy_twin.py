"""The native bundle adjustment against its NumPy twin."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc import _core
from monoloc.geometry import invert, se3_exp, transform
from monoloc.odometry import window_numpy_twin


@given(
    seed=st.integers(0, 2**32 - 1),
    frames=st.integers(1, 15),
    corners=st.just(0) | st.integers(30, 80),
    missing=st.floats(0.0, 0.5),
)
@settings(max_examples=60, deadline=None)
def test_adjustment_equals_twin(seed: int, frames: int, corners: int, missing: float) -> None:
    """Also where observations are missing in whole or in part, points are behind a camera, or residuals are large.

    Each keyframe observes several corners, and the first all of them. What is left to the damping amplifies rounding.
    """
    rng = np.random.default_rng(seed)
    poses = se3_exp(rng.normal(size=(frames, 6)) * 0.1)
    points = rng.uniform((-1.5, -1.0, -0.2), (1.5, 1.0, 4.0), (corners, 3))
    local = transform(invert(poses), points).swapaxes(0, 1)
    depth = np.maximum(local[..., 2], 0.3)
    rays = local[..., :2] / depth[..., None] + 0.01 * rng.standard_normal((corners, frames, 2))
    log_depth = np.log(depth) + 0.3 * rng.standard_normal((corners, frames))
    later = np.arange(frames) > 0
    rays[(rng.uniform(size=rays.shape[:2]) < missing) & later] = np.nan
    rays[(rng.uniform(size=rays.shape) < 0.05) & later[:, None]] = np.nan
    log_depth[(rng.uniform(size=log_depth.shape) < missing) & later] = np.nan
    arguments = poses, points, rays, log_depth, 0.007, 0.3, 3
    native, twin = _core.adjust_window(*arguments), window_numpy_twin.adjust_window(*arguments)
    for ours, theirs in zip(native, twin, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8 * np.abs(theirs).max(initial=1.0))
