"""What is known at a build's viewpoints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from monoloc.fusion.reference_poses import ReferencePoses, bias_correlation
from monoloc.geometry import FloatArray, pose_distance_m, se3_exp

twists = arrays(np.float64, (5, 6), elements=st.floats(-1.0, 1.0))
somewhere = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0))
STILL = np.zeros(6)


def common(there: FloatArray, back: FloatArray) -> FloatArray:
    """What two flights have in common, wherever they went."""
    return ReferencePoses(np.tile(np.eye(4), (len(there), 1, 1)), there, back).common_bias


@given(places=twists, there=twists, back=twists, at=somewhere, way=somewhere)
def test_an_error_is_between_those_of_the_nearest(
    places: FloatArray, there: FloatArray, back: FloatArray, at: FloatArray, way: FloatArray
) -> None:
    known, pose = ReferencePoses(se3_exp(places), there, back), se3_exp(at)
    found, distances_m = known.bias_at(pose, way), pose_distance_m(pose, known.poses)
    assert known.distance_m(pose) == distances_m.min()
    is_near = distances_m < distances_m.min() + 1.5  # half a metre is e^-5 of a weight
    bounds = np.concatenate([each[is_near] for each in (there, back, known.common_bias)])
    assert np.all(found <= bounds.max(axis=0) + 1e-5) and np.all(found >= bounds.min(axis=0) - 1e-5)


@given(errors=twists)
def test_where_others_are_far_a_viewpoint_s_error_is_its_own(errors: FloatArray) -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = 3.0 * np.arange(5)
    known = ReferencePoses(poses, errors, errors)
    np.testing.assert_allclose([known.bias_at(pose, STILL) for pose in poses], errors, atol=1e-10)
    halfway = poses[2].copy()
    halfway[0, 3] += 1.5
    np.testing.assert_allclose(known.bias_at(halfway, STILL), errors[2:4].mean(axis=0), atol=1e-10)


@pytest.mark.parametrize("turned", [0.0, 1.0])
def test_the_way_tells_which_of_the_flights_is_like_this_one(turned: float) -> None:
    """Along a curve: in order, in reverse, across it, and standing still."""
    step = np.array([0.1, 0.0, 0.03, 0.0, 0.05, 0.0])
    poses = np.stack([se3_exp([0.0, 0.0, 0.0, turned, 0.0, 0.0]) @ se3_exp(k * step) for k in range(20)])
    rng = np.random.default_rng(0)
    place, along = rng.normal(size=6), rng.normal(size=6)
    known = ReferencePoses(poses, np.tile(place + along, (20, 1)), np.tile(place - along, (20, 1)))
    common_bias = known.common_bias[0]
    for way, expected in (
        (8.0 * step, place + along),
        (-8.0 * step, place - along),
        (np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]), common_bias),
        (STILL, common_bias),
    ):
        # But for two centimetres, on less than which the camera goes nowhere.
        np.testing.assert_allclose(known.bias_at(poses[10], way), expected, atol=0.03 * np.abs(along).max())


def test_from_one_walk_to_the_next_is_no_way() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 4.0
    known = ReferencePoses(poses, np.full((2, 6), 0.1), np.full((2, 6), 0.05))
    np.testing.assert_allclose(known.bias_at(poses[0], np.array([1.0, 0, 0, 0, 0, 0])), known.common_bias[0])


def test_a_camera_that_stands_goes_nowhere() -> None:
    """What poses differ by in rounding is no way."""
    poses = se3_exp(1e-9 * np.random.default_rng(0).normal(size=(5, 6)))
    known = ReferencePoses(poses, np.full((5, 6), 0.1), np.full((5, 6), -0.1))
    np.testing.assert_array_equal(known.bias_at(poses[2], np.full(6, 1.0)), np.zeros(6))


def test_of_poses_alone_no_error_is_known_and_nowhere_is_far_from_none() -> None:
    poses, ahead = se3_exp(np.random.default_rng(0).normal(size=(3, 6))), np.ones(6)
    assert not ReferencePoses.of(poses).bias_at(poses[0], ahead).any() and len(ReferencePoses.of(poses)) == 3
    assert (
        ReferencePoses.none().distance_m(poses[0]) == 0.0 and not ReferencePoses.none().bias_at(poses[0], ahead).any()
    )


passes = arrays(np.float64, (2, 9, 6), elements=st.floats(-0.1, 0.1))


@given(both=passes)
def test_what_two_passes_have_in_common_lies_between_them_and_zero(both: FloatArray) -> None:
    there, back = both
    alike = bias_correlation(there, back)
    assert np.all((alike >= 0.0) & (alike <= 1.0 + 1e-12))
    np.testing.assert_array_equal(bias_correlation(back, there), alike)
    found = common(there, back)
    assert np.all(found <= np.maximum(0.0, both.max(axis=0)) + 1e-12)
    assert np.all(found >= np.minimum(0.0, both.min(axis=0)) - 1e-12)


@given(one=arrays(np.float64, (9, 6), elements=st.floats(-0.1, 0.1)))
def test_the_same_twice_is_of_the_place_and_the_opposite_is_not(one: FloatArray) -> None:
    np.testing.assert_allclose(common(one, one), one, atol=1e-12)
    np.testing.assert_array_equal(common(one, -one), np.zeros((9, 6)))


@pytest.mark.parametrize("of_the_place", [0.0, 0.5, 1.0, 2.0])
def test_what_is_taken_off_leaves_least_of_another_pass(of_the_place: float) -> None:
    """Errors of the place, and as large ones of the way: no other share of the two passes' mean would leave less."""
    rng = np.random.default_rng(0)
    place = of_the_place * rng.normal(size=(4000, 6))
    there, back, another = (place + rng.normal(size=(4000, 6)) for _ in range(3))
    alike = bias_correlation(there, back)
    np.testing.assert_allclose(alike, of_the_place**2 / (1.0 + of_the_place**2), atol=0.05)

    def left(share: float) -> float:
        return float(np.mean((another - share * 0.5 * (there + back)) ** 2))

    found = float(np.mean((another - common(there, back)) ** 2))
    assert found <= 1.005 * min(map(left, np.linspace(0.0, 1.0, 21)))
