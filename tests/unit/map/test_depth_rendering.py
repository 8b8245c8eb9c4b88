"""Depth of a cloud seen from a pose: right where surfaces are, and none through them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from depth_helpers import ROOM, SMALL_CAMERA, small_recording
from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.geometry import se3_exp
from monoloc.map.depth_rendering import map_depth
from synthetic_room import RoomRecording


def test_rendered_depth_is_that_of_the_room() -> None:
    spacing_m, recording = 0.03, small_recording(12)
    depth_of = map_depth(recording, ROOM.cloud(spacing_m))
    for index in (0, 6):
        depth, exact = depth_of(index), recording.depth(index)
        seen = depth > 0.0
        assert depth.shape == exact.shape and depth.dtype == np.float32
        assert seen.mean() > 0.5
        # A point lies in its pixel, not in the middle of it, and points up to 5 % behind the nearest still count.
        nearest, farthest = cv2.erode(exact, np.ones((3, 3))), cv2.dilate(exact, np.ones((3, 3)))
        assert (depth > 0.99 * nearest)[seen].all()
        assert np.mean((depth < 1.06 * farthest)[seen]) > 0.999  # few points are seen through gaps of what is close
        inside_surfaces = seen & ~(cv2.dilate(at_discontinuity(exact, 0.03).astype(np.uint8), np.ones((9, 9))) > 0)
        error = depth[inside_surfaces] - exact[inside_surfaces]
        assert np.mean(np.abs(error) < spacing_m) > 0.99  # it is rendered at half the frame's width
        assert np.abs(np.median(error)) < 0.003


def test_rendering_does_not_see_through_surfaces() -> None:
    """Two walls, one behind the other, of which the near one ends in the middle of the image."""
    y, x = np.mgrid[-2.0:2.0:0.02, -3.0:3.0:0.02].reshape(2, -1)
    far = np.stack([x, y, np.full_like(x, 3.0)], axis=1)
    near = np.stack([x, y, np.full_like(x, 1.5)], axis=1)[x < 0.0]
    behind = np.stack([x, y, np.full_like(x, -1.0)], axis=1)
    recording = RoomRecording(ROOM, se3_exp(np.full((1, 6), 1e-9)), SMALL_CAMERA)
    depth = map_depth(recording, np.concatenate([far, near, behind]))(0)
    left, right = depth[:, : int(SMALL_CAMERA.cx) - 6], depth[:, int(SMALL_CAMERA.cx) + 6 :]
    assert set(np.unique(left.round(3))) == {np.float32(0.0), np.float32(1.5)}
    assert set(np.unique(right.round(3))) == {np.float32(0.0), np.float32(3.0)}
    assert (left > 0).mean() > 0.5 and (right > 0).mean() > 0.9


def test_points_that_distortion_folds_into_the_image_are_not_seen() -> None:
    """Brown's polynomial maps a point 74 degrees off the axis to a pixel near the middle."""
    camera = Camera(320, 240, 260.0, 260.0, 159.5, 119.5, (-0.08, 0.0, 0.0, 0.0, 0.0))
    aside, before = np.array([[3.5, 0.0, 1.0]]), np.array([[0.1, 0.0, 1.0]])
    assert 0.0 < camera.project(aside)[0, 0] < 320.0
    np.testing.assert_array_equal(camera.in_sight(np.concatenate([aside, before, -before])), [False, True, False])
    recording = RoomRecording(ROOM, se3_exp(np.full((1, 6), 1e-9)), camera)
    assert not map_depth(recording, aside)(0).any()
    assert map_depth(recording, before)(0).any()


@pytest.mark.parametrize("near_m", [0.2, 0.4, 0.7, 1.0])
def test_rendering_does_not_see_through_surfaces_next_to_the_camera(near_m: float) -> None:
    """A camera next to a wall: its points, three centimetres apart, are many pixels apart in the image."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[-2.0:2.0:0.03, -3.0:3.0:0.03].reshape(2, -1)
    near, far = (
        np.stack([x, y, np.full_like(x, z)], axis=1)
        + np.append(rng.uniform(-0.015, 0.015, (len(x), 2)), np.zeros((len(x), 1)), axis=1)
        for z in (near_m, 3.0)
    )
    recording = RoomRecording(ROOM, se3_exp(np.full((1, 6), 1e-9)), SMALL_CAMERA)
    depth = map_depth(recording, np.concatenate([far, near]))(0)
    seen = depth[depth > 0.0]
    assert len(seen) > 0 and np.mean(seen > 1.1 * near_m) < 0.01


def test_dense_rendering_shows_all_that_the_other_does_and_more() -> None:
    """The points of a floor before a far wall: what is beyond the floor's edge is hidden in wide cells."""
    x, z = np.mgrid[-1.0:1.0:0.05, 0.3:1.2:0.05].reshape(2, -1)
    wall_x, wall_y = np.mgrid[-3.0:3.0:0.05, -1.0:1.0:0.05].reshape(2, -1)
    floor, wall = np.stack([x, 0.2 + 0.0 * x, z], axis=1), np.stack([wall_x, wall_y, 3.0 + 0.0 * wall_x], axis=1)
    recording = RoomRecording(ROOM, se3_exp(np.full((1, 6), 1e-9)), SMALL_CAMERA)
    some, all_ = (map_depth(recording, np.concatenate([floor, wall]), each)(0) for each in (False, True))
    assert (all_ > 0.0).sum() > (some > 0.0).sum()
    assert (all_[some > 0.0] > 0.0).all()
