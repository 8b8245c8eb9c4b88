"""The native kernels of landmarks against their NumPy twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc import _core
from monoloc.geometry import FloatArray, se3_exp, transform
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


@given(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(1, 1300), st.integers(1, 9))
@settings(max_examples=60, deadline=None)
def test_nearest_descriptors_equal_twin(seed: int, descriptors: int, known: int, kept: int) -> None:
    """Also where many are as near, and across the blocks of the native kernel."""
    rng = np.random.default_rng(seed)
    appearances = rng.integers(0, 256, (3, 32)).astype(np.uint8)
    ours, theirs = (
        appearances[rng.integers(3, size=count)] ^ (rng.uniform(size=(count, 32)) < 0.05).astype(np.uint8)
        for count in (descriptors, known)
    )
    native = _core.nearest_descriptors(ours, theirs, min(kept, known))
    twin = landmark_numpy_twins.nearest_descriptors(ours, theirs, min(kept, known))
    for each, expected in zip(native, twin, strict=True):
        np.testing.assert_array_equal(each, expected)


KERNEL_SDS = np.array([24.0, 12.0, 6.0, 3.0, 3.0])


def seen_landmarks(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points, rays and their standard deviations, of which a third are wrong, and a pose near the camera's."""
    pose = se3_exp(rng.normal(size=6))
    local = rng.uniform((-1.5, -1.0, 1.0), (1.5, 1.0, 4.0), (count, 3))
    sd = rng.uniform(0.002, 0.008, (count, 2))
    rays = local[:, :2] / local[:, 2:] + sd * rng.normal(size=(count, 2))
    rays[: count // 3] += rng.uniform(-0.2, 0.2, (count // 3, 2))
    return transform(pose, local), rays, sd, pose @ se3_exp(0.03 * rng.normal(size=6))


@given(st.integers(0, 2**32 - 1), st.integers(0, 200))
@settings(max_examples=60, deadline=None)
def test_pose_equals_twin(seed: int, count: int) -> None:
    """Also from a prior that is far off, for which points are beside or behind the camera."""
    rng = np.random.default_rng(seed)
    points, rays, sd, near = seen_landmarks(rng, count)
    information = np.diag(rng.uniform(0.02, 0.1, 6) ** -2)
    for prior in (near, se3_exp(2.0 * rng.normal(size=6))):
        arguments = points, rays, sd, prior, information, KERNEL_SDS, 0.05
        for native, twin in zip(_core.fit_pose(*arguments), landmark_numpy_twins.fit_pose(*arguments), strict=True):
            np.testing.assert_allclose(native, twin, rtol=1e-9, atol=1e-9 * np.abs(twin).max(initial=1.0))


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.floats(-0.2, 0.2))
@settings(max_examples=60, deadline=None)
def test_focal_length_equals_twin(seed: int, count: int, log_focal: float) -> None:
    points, rays, sd, near = seen_landmarks(np.random.default_rng(seed), count)
    information = np.diag(np.repeat([0.5, 0.1, 0.2], [3, 3, 1]) ** -2)
    arguments = points, np.exp(log_focal) * rays, sd, near, information, KERNEL_SDS, 0.05
    native, twin = _core.fit_log_focal(*arguments), landmark_numpy_twins.fit_log_focal(*arguments)
    np.testing.assert_allclose(native, twin, rtol=1e-9, atol=1e-9)


def test_pose_of_unknown_rays_is_unknown_and_without_information_there_is_none() -> None:
    points, rays, sd, near = seen_landmarks(np.random.default_rng(0), 30)
    rays[5, 1] = np.nan
    for fit in (_core.fit_pose, landmark_numpy_twins.fit_pose):
        _, _, _, weights = fit(points, rays, sd, near, np.eye(6), KERNEL_SDS, 0.05)
        assert np.isnan(weights).all()
        with pytest.raises(ValueError, match="ingular"):  # NumPy's LinAlgError is a ValueError
            fit(points[:0], rays[:0], sd[:0], near, np.zeros((6, 6)), KERNEL_SDS, 0.05)
