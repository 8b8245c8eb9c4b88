"""The native kernels of landmarks against their NumPy twins."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from monoloc import _core
from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_exp, transform
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


@given(st.integers(0, 2**32 - 1), st.integers(0, 5), st.integers(1, 1300), st.integers(1, 9), st.integers(-1, 140))
@settings(max_examples=60, deadline=None)
def test_nearest_descriptors_equal_twin(seed: int, descriptors: int, known: int, kept: int, most_bits: int) -> None:
    """Also where many are as near or too few are near enough, and across the blocks of the native kernel."""
    rng = np.random.default_rng(seed)
    appearances = rng.integers(0, 256, (3, 32)).astype(np.uint8)
    ours, theirs = (
        appearances[rng.integers(3, size=count)] ^ (rng.uniform(size=(count, 32)) < 0.05).astype(np.uint8)
        for count in (descriptors, known)
    )
    native = _core.nearest_descriptors(ours, theirs, min(kept, known), most_bits)
    twin = landmark_numpy_twins.nearest_descriptors(ours, theirs, min(kept, known), most_bits)
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


@given(st.integers(0, 2**32 - 1), st.integers(6, 200))
@settings(max_examples=60, deadline=None)
def test_leverages_equal_twin_and_add_up_to_six(seed: int, count: int) -> None:
    points, rays, sd, near = seen_landmarks(np.random.default_rng(seed), count)
    pose, normal, _, weights = _core.fit_pose(points, rays, sd, near, np.eye(6), KERNEL_SDS, 0.05)
    normal += 1e-6 * np.eye(6)  # of six landmarks, few may agree
    arguments = points, rays, sd, pose, np.linalg.inv(normal), weights, 0.05
    leverages = _core.leverages(*arguments)
    np.testing.assert_allclose(leverages, landmark_numpy_twins.leverages(*arguments), rtol=1e-6, atol=1e-9)
    if np.linalg.eigvalsh(normal)[0] > 1.0:
        assert leverages.max() <= 2.0 + 1e-5
        np.testing.assert_allclose(leverages.sum(), 6.0, atol=1e-4)


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.floats(-0.2, 0.2))
@settings(max_examples=60, deadline=None)
def test_focal_length_and_aspect_equal_twin(seed: int, count: int, logarithm: float) -> None:
    points, rays, sd, near = seen_landmarks(np.random.default_rng(seed), count)
    for fit, unknowns, wrong in ((_core.fit_log_focal, 7, [1.0, 1.0]), (_core.fit_log_aspect, 8, [0.0, 1.0])):
        information = np.diag(np.repeat([0.5, 0.1, 0.2], [3, 3, unknowns - 6]) ** -2)
        seen = np.exp(logarithm * np.array(wrong)) * rays
        arguments = points, seen, sd, near, information, KERNEL_SDS, 0.05
        np.testing.assert_allclose(fit(*arguments), landmark_numpy_twins.fit_lens(*arguments), rtol=1e-9, atol=1e-9)


def test_pose_of_unknown_rays_is_unknown_and_without_information_there_is_none() -> None:
    points, rays, sd, near = seen_landmarks(np.random.default_rng(0), 30)
    rays[5, 1] = np.nan
    for fit in (_core.fit_pose, landmark_numpy_twins.fit_pose):
        _, _, _, weights = fit(points, rays, sd, near, np.eye(6), KERNEL_SDS, 0.05)
        assert np.isnan(weights).all()
        with pytest.raises(ValueError, match="ingular"):  # NumPy's LinAlgError is a ValueError
            fit(points[:0], rays[:0], sd[:0], near, np.zeros((6, 6)), KERNEL_SDS, 0.05)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_poses_of_a_triple_are_opencv_s(seed: int) -> None:
    """OpenCV's are those nearest to what it was given, and it may leave out one of two that are nearly the same."""
    points, rays, _, _ = seen_landmarks(np.random.default_rng(seed), 3)
    directions = np.column_stack([rays, np.ones(3)]) / np.hypot(1.0, np.linalg.norm(rays, axis=1))[:, None]
    poses = landmark_numpy_twins.poses_of_triple(points, directions)
    for pose in poses:
        local = transform(invert(pose), points)
        # Two solutions that nearly coincide are known worse: of 6000 triples, one was 6e-6 off, most 1e-8 or less.
        np.testing.assert_allclose(local[:, :2] / local[:, 2:], rays, atol=1e-4)
    count, rotations, shifts = cv2.solveP3P(points, rays, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_P3P)
    for rotation, shift in zip(rotations[:count], shifts[:count], strict=True):
        theirs = np.eye(4)
        theirs[:3, :3], theirs[:3, 3] = cv2.Rodrigues(rotation)[0], shift.ravel()
        if np.abs(transform(theirs, points)[:, :2] / transform(theirs, points)[:, 2:] - rays).max() < 1e-6:
            assert pose_distance_m(invert(theirs), np.stack(poses)).min() < 1e-3


@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.integers(1, 30))
@example(13562, 43, 2)
@settings(max_examples=40, deadline=None)
def test_consensus_equals_twin(seed: int, count: int, triples: int) -> None:
    """Also of landmarks at one point, and of rays that are unknown."""
    rng = np.random.default_rng(seed)
    points, rays, sd, _ = seen_landmarks(rng, count)
    points[rng.uniform(size=count) < 0.1] = points[:1]
    rays[rng.uniform(size=count) < 0.05] = np.nan
    arguments = points, rays, sd, 0.05, 4.0, triples, 0.999
    native, twin = _core.find_consensus(*arguments), landmark_numpy_twins.find_consensus(*arguments)
    np.testing.assert_array_equal(native[1], twin[1])
    np.testing.assert_allclose(native[0], twin[0], atol=1e-4)  # some triples determine a pose badly


@pytest.mark.parametrize("right", [0.2, 0.5, 1.0])
def test_consensus_is_the_camera_s_pose_among_wrong_matches(right: float) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pose, count = se3_exp(rng.normal(size=6)), 100
        local = rng.uniform((-1.5, -1.0, 1.0), (1.5, 1.0, 4.0), (count, 3))
        sd = np.full((count, 2), 0.002)
        rays = local[:, :2] / local[:, 2:] + sd * rng.normal(size=(count, 2))
        rays[int(right * count) :] = rng.uniform(-0.6, 0.6, (count - int(right * count), 2))
        found, agreeing = _core.find_consensus(transform(pose, local), rays, sd, 0.05, 4.0, 2000, 0.999)
        assert len(agreeing) >= 0.9 * right * count and np.mean(agreeing < right * count) > 0.8
        assert pose_distance_m(pose, found[None])[0] < 0.03
