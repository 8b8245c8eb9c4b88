"""What is known at a build's viewpoints."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from monoloc.filter.viewpoints import Viewpoints
from monoloc.geometry import FloatArray, se3_exp, viewpoints_apart

twists = arrays(np.float64, (5, 6), elements=st.floats(-1.0, 1.0))
somewhere = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0))


@given(places=twists, errors=twists, at=somewhere)
def test_an_error_is_a_mean_of_those_of_the_nearest(places: FloatArray, errors: FloatArray, at: FloatArray) -> None:
    known, pose = Viewpoints(se3_exp(places), errors), se3_exp(at)
    found, distances_m = known.error_at(pose), viewpoints_apart(pose, known.poses)
    assert known.distance_m(pose) == distances_m.min()
    is_near = distances_m < distances_m.min() + 1.5  # half a metre is e^-5 of a weight
    assert np.all(found <= errors[is_near].max(axis=0) + 1e-5)
    assert np.all(found >= errors[is_near].min(axis=0) - 1e-5)


@given(errors=twists)
def test_where_others_are_far_a_viewpoint_s_error_is_its_own(errors: FloatArray) -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = 3.0 * np.arange(5)
    known = Viewpoints(poses, errors)
    np.testing.assert_allclose([known.error_at(pose) for pose in poses], errors, atol=1e-10)
    halfway = poses[2].copy()
    halfway[0, 3] += 1.5
    np.testing.assert_allclose(known.error_at(halfway), errors[2:4].mean(axis=0), atol=1e-10)


def test_of_poses_alone_no_error_is_known_and_nowhere_is_far_from_none() -> None:
    poses = se3_exp(np.random.default_rng(0).normal(size=(3, 6)))
    assert not Viewpoints.of(poses).error_at(poses[0]).any() and len(Viewpoints.of(poses)) == 3
    assert Viewpoints.none().distance_m(poses[0]) == 0.0 and not Viewpoints.none().error_at(poses[0]).any()
