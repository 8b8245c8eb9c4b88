"""Landmarks that a camera may see, chosen cube by cube."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from monoloc.camera import Camera
from monoloc.geometry import invert, se3_exp, transform
from monoloc.landmarks.landmark_cells import LandmarkCells
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews

CAMERA = Camera(320, 240, 260.0, 260.0, 159.5, 119.5)


@settings(deadline=None)
@given(
    count=st.integers(0, 3000),
    extent_m=st.floats(0.1, 60.0),
    turn=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    has_views=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_no_landmark_in_view_and_within_sight_is_missed(
    count: int, extent_m: float, turn: list[float], has_views: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    points = (extent_m * rng.uniform(-1.0, 1.0, (count, 3))).astype(np.float32)
    views, sight_m = None, np.inf
    if has_views and count:
        found = np.arange(count) == np.linalg.norm(points, axis=1).argmin()
        views = LandmarkViews(np.eye(4)[None], found[None])
        sight_m = 3.0 * views.farthest_m(points) or np.inf
    pose = se3_exp([*rng.uniform(-0.5 * extent_m, 0.5 * extent_m, 3), *turn])
    nearby, near_points = LandmarkCells(Landmarks(points, np.zeros((count, 32), np.uint8), views)).nearby(
        pose, CAMERA
    )
    local = transform(invert(pose), points.astype(np.float64))
    distances_m = np.linalg.norm(local, axis=1)
    assert np.isin(np.flatnonzero(CAMERA.in_sight(local) & (distances_m < sight_m - 1e-4)), nearby).all()
    assert (distances_m[nearby] < sight_m + 1e-4).all()
    assert (np.diff(nearby) > 0).all()
    np.testing.assert_array_equal(near_points, points[nearby])


def test_most_landmarks_out_of_view_are_left_out() -> None:
    points = np.random.default_rng(0).uniform(-20.0, 20.0, (20_000, 3)).astype(np.float32)
    cells = LandmarkCells(Landmarks(points, np.zeros((len(points), 32), np.uint8)))
    in_view = np.count_nonzero(CAMERA.in_sight(points.astype(np.float64)))
    assert in_view <= len(cells.nearby(np.eye(4), CAMERA)[0]) < 1.5 * in_view
