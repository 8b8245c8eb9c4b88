"""The landmark map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.geometry import se3_exp
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews


def test_the_most_landmarks_and_views_take_400_kb() -> None:
    """A landmark's 44 bytes hardly compress. A view finds a twentieth of them, mostly those of frames near it."""
    rng = np.random.default_rng(0)
    apart = np.abs(np.arange(7500) - np.linspace(0, 7500, 300)[:, None])
    views = LandmarkViews(se3_exp(rng.normal(size=(300, 6))), (apart < 375) & (rng.uniform(size=apart.shape) < 0.5))
    points = rng.normal(size=(7500, 3)).astype(np.float32)
    landmarks = Landmarks(points, rng.integers(0, 256, (7500, 32), dtype=np.uint8), views)
    assert 300_000 < landmarks.bytes < 400_000
    assert len(Landmarks.none()) == 0


def with_views(landmarks: int = 11) -> Landmarks:
    rng = np.random.default_rng(0)
    views = LandmarkViews(se3_exp(rng.normal(size=(5, 6))), rng.uniform(size=(5, landmarks)) < 0.5)
    points = rng.normal(size=(landmarks, 3)).astype(np.float32)
    return Landmarks(points, rng.integers(0, 256, (landmarks, 32), dtype=np.uint8), views)


def test_arrays_hold_landmarks_and_views() -> None:
    """Bundles of earlier versions have no views."""
    landmarks = with_views()
    again = Landmarks.from_arrays(landmarks.to_arrays())
    assert again.views is not None and landmarks.views is not None
    np.testing.assert_array_equal(again.points, landmarks.points)
    np.testing.assert_array_equal(again.descriptors, landmarks.descriptors)
    np.testing.assert_array_equal(again.views.found, landmarks.views.found)
    np.testing.assert_allclose(again.views.poses, landmarks.views.poses, atol=1e-6)
    earlier = {name: array for name, array in landmarks.to_arrays().items() if not name.startswith("view")}
    assert Landmarks.from_arrays(earlier).views is None


def test_times_found_are_of_the_three_nearest_views() -> None:
    """As far as they are near; a single view tells nothing."""
    along_x_m = np.array([0.0, 0.05, 0.1, 0.15, 1.0, 1.3])
    poses = se3_exp(np.stack([along_x_m, *np.zeros((5, 6))], axis=1))
    views = LandmarkViews(poses, np.tri(6, dtype=np.bool_))  # view v found landmarks 0 to v
    assert views.times_found(np.eye(4)).tolist() == [3, 2, 1, 0, 0, 0]
    assert views.without(1).times_found(np.eye(4)).tolist() == [3, 2, 2, 1, 0, 0]
    assert views.times_found(se3_exp([-0.12, 0.0, 0.0, 0.0, 0.0, 0.0])).tolist() == [2, 1, 0, 0, 0, 0]
    assert views.times_found(poses[4]) is None


def test_familiar_landmarks_are_those_in_view_that_near_views_found() -> None:
    poses = se3_exp(0.01 * np.eye(6)[:3])
    views = LandmarkViews(poses, np.array([[1, 1, 0, 1], [1, 0, 0, 1], [1, 1, 0, 0]], np.bool_))
    is_shown = np.array([False, True, True])
    familiar = views.familiar(np.eye(4), np.array([3, 2, 0]), np.array([False, True, True]), is_shown)
    assert familiar is not None
    assert (familiar.indices.tolist(), familiar.is_found.tolist()) == ([3, 0], [False, True])
    shown = familiar.shown()
    assert (shown.indices.tolist(), shown.is_found.tolist()) == ([0], [True])
    yes = np.ones(4, np.bool_)
    assert views.familiar(se3_exp([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]), np.arange(4), yes, yes) is None


def test_views_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be \(V, 4, 4\) and \(V, L\), got \(2, 4, 4\) and \(3, 7\)"):
        LandmarkViews(np.zeros((2, 4, 4)), np.zeros((3, 7), np.bool_))
    with pytest.raises(ValueError, match=r"views.found must be \(V, 12\), got \(5, 11\)"):
        replace(with_views(12), views=with_views(11).views)


def test_other_types_are_refused() -> None:
    with pytest.raises(ValueError, match="must be float32 and uint8, got float64 and uint8"):
        Landmarks(np.zeros((2, 3)), np.zeros((2, 32), np.uint8))  # type: ignore[arg-type]


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"must be \(L, 3\) and \(L, 32\), got \(2, 3\) and \(2, 31\)"):
        Landmarks(np.zeros((2, 3), np.float32), np.zeros((2, 31), np.uint8))
