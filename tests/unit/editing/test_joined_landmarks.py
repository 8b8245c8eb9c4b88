"""Landmarks of two maps as one."""

from __future__ import annotations

import numpy as np

from monoloc.editing.joined_landmarks import joined
from monoloc.geometry import se3_exp
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews


def test_views_of_both_maps_find_what_both_have() -> None:
    """The second map has the first one's landmarks from the 20th on, in another order, and ten more."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.0, 2.0, (70, 3)).astype(np.float32)
    descriptors = rng.integers(0, 256, (70, 32), dtype=np.uint8)
    chosen = rng.permutation(np.arange(20, 70))
    poses = se3_exp(rng.normal(size=(7, 6)))
    found = rng.uniform(size=(7, 70)) < 0.4
    first = Landmarks(points[:60], descriptors[:60], LandmarkViews(poses[:4], found[:4, :60]))
    second = Landmarks(
        points[chosen] + np.float32(0.005), descriptors[chosen], LandmarkViews(poses[4:], found[4:][:, chosen])
    )
    both = joined(first, second)
    new = chosen[chosen >= 60]
    assert len(both) == 60 + len(new) == 70 and both.views is not None
    np.testing.assert_array_equal(both.descriptors, descriptors[np.concatenate([np.arange(60), new])])
    np.testing.assert_array_equal(both.views.poses, poses)
    np.testing.assert_array_equal(both.views.found[4:, 20:60], found[4:, 20:60])
    np.testing.assert_array_equal(both.views.found[4:, 60:], found[4:][:, new])
    assert not both.views.found[4:, :20].any() and not both.views.found[:4, 60:].any()
    np.testing.assert_array_equal(both.views.found[:4, :60], found[:4, :60])
