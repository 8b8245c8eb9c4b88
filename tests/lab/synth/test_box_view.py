"""Views of boxes have the depth and the place of what they show."""

from __future__ import annotations

import numpy as np

from monoloc.geometry import make_pose, so3_exp
from monoloc_lab.synth.box_view import BoxView
from rendered_room import CAMERA, POSE, windowed_room


def test_depth_is_the_distance_to_the_nearest_box() -> None:
    """Every pixel's point lies on a surface of the room, and none is nearer than the nearest surface."""
    room = windowed_room()
    color, depth = BoxView([(room, np.eye(4))])(CAMERA, POSE)
    assert color.shape == (CAMERA.height, CAMERA.width, 3) and color.std() > 10.0
    rays = CAMERA.pixel_rays().reshape(CAMERA.height, CAMERA.width, 3)
    points = (depth[..., None] * rays) @ POSE[:3, :3].T + POSE[:3, 3]
    inside = np.all((points > -0.3) & (points < np.array(room.size) + 0.3), axis=-1)
    clearance = np.abs(room.clearance_m(points.reshape(-1, 3))).reshape(depth.shape)
    assert inside.mean() > 0.99
    # Depth is that of the nearest of the finer pixels, so it is off by up to a pixel's slope.
    assert np.percentile(clearance[inside], 95.0) < 0.02
    halfway = 0.5 * depth[..., None] * rays @ POSE[:3, :3].T + POSE[:3, 3]
    assert room.clearance_m(halfway[::4, ::4].reshape(-1, 3)).min() > 0.0


def test_a_room_that_is_moved_with_the_camera_looks_the_same() -> None:
    room = windowed_room()
    T_world_room = make_pose(so3_exp(np.array([0.0, 0.0, np.pi / 2.0])), np.array([4.0, -2.0, 0.0]))
    _, depth = BoxView([(room, np.eye(4))])(CAMERA, POSE)
    _, moved = BoxView([(room, T_world_room)])(CAMERA, T_world_room @ POSE)
    np.testing.assert_allclose(moved, depth, atol=1e-4)


def test_a_texture_stays_where_it_is_as_the_camera_moves() -> None:
    """A point that two cameras see has nearly the same colour in both."""
    room = windowed_room()
    view = BoxView([(room, np.eye(4))])
    other = POSE @ make_pose(so3_exp(np.array([0.0, 0.05, 0.0])), np.array([0.05, 0.0, 0.05]))
    (color, depth), (expected, expected_depth) = view(CAMERA, POSE), view(CAMERA, other)
    rays = CAMERA.pixel_rays().reshape(CAMERA.height, CAMERA.width, 3)
    local = ((depth[..., None] * rays) @ POSE[:3, :3].T + POSE[:3, 3] - other[:3, 3]) @ other[:3, :3]
    pixels = np.round(CAMERA.project(local.reshape(-1, 3))).astype(int).reshape(*depth.shape, 2)
    seen = np.all((pixels >= 0) & (pixels < (CAMERA.width, CAMERA.height)), axis=-1)
    x, y = pixels[seen].T
    same = np.abs(expected_depth[y, x] - local[seen][:, 2]) < 0.03
    difference = np.abs(expected[y, x].astype(float) - color[seen].astype(float)).mean(axis=1)[same]
    assert same.mean() > 0.7 and np.median(difference) < 4.0
