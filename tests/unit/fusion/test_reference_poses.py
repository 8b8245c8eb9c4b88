"""The particles' known bias at the poses that a room was built from."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from monoloc.fusion.reference_poses import MOST_POSES, ReferencePoses, bias_correlation
from monoloc.geometry import FloatArray, pose_distance_m, se3_exp

twists = arrays(np.float64, (5, 6), elements=st.floats(-1.0, 1.0))
pose_twists = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0))
STILL = np.zeros(6)


def common_bias(forward: FloatArray, backward: FloatArray) -> FloatArray:
    return ReferencePoses(np.tile(np.eye(4), (len(forward), 1, 1)), forward, backward).common_bias


@given(poses=twists, forward=twists, backward=twists, at=pose_twists, motion=pose_twists)
def test_bias_lies_between_those_of_the_nearest_reference_poses(
    poses: FloatArray, forward: FloatArray, backward: FloatArray, at: FloatArray, motion: FloatArray
) -> None:
    known, pose = ReferencePoses(se3_exp(poses), forward, backward), se3_exp(at)
    bias, distances_m = known.bias_at(pose, motion), pose_distance_m(pose, known.poses)
    assert known.distance_m(pose) == distances_m.min()
    is_near = distances_m < distances_m.min() + 1.5  # half a metre is e^-5 of a weight
    bounds = np.concatenate([each[is_near] for each in (forward, backward, known.common_bias)])
    assert np.all(bias <= bounds.max(axis=0) + 1e-5) and np.all(bias >= bounds.min(axis=0) - 1e-5)


@given(biases=twists)
def test_far_from_the_others_a_reference_poses_bias_is_its_own(biases: FloatArray) -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = 3.0 * np.arange(5)
    known = ReferencePoses(poses, biases, biases)
    np.testing.assert_allclose([known.bias_at(pose, STILL) for pose in poses], biases, atol=1e-10)
    halfway = poses[2].copy()
    halfway[0, 3] += 1.5
    np.testing.assert_allclose(known.bias_at(halfway, STILL), biases[2:4].mean(axis=0), atol=1e-10)


@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_direction_of_motion_selects_the_bias(turned: float) -> None:
    """Along a curve: in order, in reverse, across it, and standing still."""
    step = np.array([0.1, 0.0, 0.03, 0.0, 0.05, 0.0])
    poses = np.stack([se3_exp([0.0, 0.0, 0.0, turned, 0.0, 0.0]) @ se3_exp(k * step) for k in range(20)])
    rng = np.random.default_rng(0)
    of_place, of_direction = rng.normal(size=6), rng.normal(size=6)
    forward, backward = (np.tile(of_place + sign * of_direction, (20, 1)) for sign in (1.0, -1.0))
    known = ReferencePoses(poses, forward, backward)
    for motion, expected in (
        (8.0 * step, forward[0]),
        (-8.0 * step, backward[0]),
        (np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), known.common_bias[0]),
        (STILL, known.common_bias[0]),
    ):
        # Up to the two centimetres within which the camera counts as still.
        np.testing.assert_allclose(known.bias_at(poses[10], motion), expected, atol=0.03 * np.abs(of_direction).max())


def test_jump_between_reference_poses_has_no_direction() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 4.0
    known = ReferencePoses(poses, np.full((2, 6), 0.1), np.full((2, 6), 0.05))
    np.testing.assert_allclose(known.bias_at(poses[0], np.array([1.0, 0, 0, 0, 0, 0])), known.common_bias[0])


def test_rounding_of_equal_poses_has_no_direction() -> None:
    poses = se3_exp(1e-9 * np.random.default_rng(0).normal(size=(5, 6)))
    known = ReferencePoses(poses, np.full((5, 6), 0.1), np.full((5, 6), -0.1))
    np.testing.assert_array_equal(known.bias_at(poses[2], np.full(6, 1.0)), np.zeros(6))


def test_without_measured_bias_it_is_zero_and_without_poses_the_distance_is_too() -> None:
    poses, motion = se3_exp(np.random.default_rng(0).normal(size=(3, 6))), np.ones(6)
    unbiased, none = ReferencePoses.without_bias(poses), ReferencePoses.none()
    assert len(unbiased) == 3 and not unbiased.bias_at(poses[0], motion).any()
    assert len(none) == 0 and none.distance_m(poses[0]) == 0.0 and not none.bias_at(poses[0], motion).any()


@given(both=arrays(np.float64, (2, 9, 6), elements=st.floats(-0.1, 0.1)))
def test_common_bias_lies_between_both_directions_and_zero(both: FloatArray) -> None:
    forward, backward = both
    correlation = bias_correlation(forward, backward)
    assert np.all((correlation >= 0.0) & (correlation <= 1.0 + 1e-12))
    np.testing.assert_array_equal(bias_correlation(backward, forward), correlation)
    common = common_bias(forward, backward)
    assert np.all(common <= np.maximum(0.0, both.max(axis=0)) + 1e-12)
    assert np.all(common >= np.minimum(0.0, both.min(axis=0)) - 1e-12)


@given(bias=arrays(np.float64, (9, 6), elements=st.floats(-0.1, 0.1)))
def test_equal_biases_are_common_and_opposite_ones_are_not(bias: FloatArray) -> None:
    np.testing.assert_allclose(common_bias(bias, bias), bias, atol=1e-12)
    np.testing.assert_array_equal(common_bias(bias, -bias), np.zeros((9, 6)))


@pytest.mark.parametrize("of_place", [0.0, 0.5, 1.0, 2.0])
def test_common_bias_predicts_a_third_flight_best(of_place: float) -> None:
    """Errors of the place, and as large ones of the flight: no other share of the mean of two leaves less."""
    rng = np.random.default_rng(0)
    shared = of_place * rng.normal(size=(4000, 6))
    forward, backward, third = (shared + rng.normal(size=(4000, 6)) for _ in range(3))
    expected = of_place**2 / (1.0 + of_place**2)
    np.testing.assert_allclose(bias_correlation(forward, backward), expected, atol=0.05)

    def remaining(share: float) -> float:
        return float(np.mean((third - share * 0.5 * (forward + backward)) ** 2))

    best = min(map(remaining, np.linspace(0.0, 1.0, 21)))
    assert np.mean((third - common_bias(forward, backward)) ** 2) <= 1.005 * best


def test_more_poses_than_a_frame_has_time_for_are_refused() -> None:
    count = MOST_POSES + 1
    poses, biases = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 6))
    with pytest.raises(ValueError, match=f"there are {count} poses, more than {MOST_POSES}"):
        ReferencePoses(poses, biases, biases)
    assert len(ReferencePoses(poses[1:], biases[1:], biases[1:]).poses) == MOST_POSES
