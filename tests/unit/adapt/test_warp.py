"""Posed frames moved forward to another pose: what a camera there would see of them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from depth_helpers import ROOM, SMALL_CAMERA, looking_around
from monoloc.adapt.warp import ColoredPoints, forward_warp, points_of
from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.geometry import FloatArray, invert, se3_exp, transform

VIEW = SMALL_CAMERA.resized(96, 64)
FINE = SMALL_CAMERA  # twice as large: frames are given at the size at which views are drawn
CAMERA = Camera(16, 12, 14.0, 14.0, 7.5, 5.5)
IDENTITY = np.eye(4)
RED, GREEN = np.array([[255, 0, 0]], dtype=np.uint8), np.array([[0, 255, 0]], dtype=np.uint8)


def seen_from(pose: FloatArray) -> ColoredPoints:
    return points_of(*ROOM.view(pose, FINE), FINE.pixel_rays(), pose)


def rendered(pose: FloatArray) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """What the view would be, colour averaged over the pixel as the network's input is."""
    color = cv2.resize(ROOM.view(pose, FINE)[0], (VIEW.width, VIEW.height), interpolation=cv2.INTER_AREA)
    return np.asarray(color, dtype=np.uint8), ROOM.view(pose, VIEW)[1]


def moved(pose: FloatArray, seed: int) -> FloatArray:
    """Moved by as much as synthesised views are from their frames."""
    return pose @ se3_exp(np.random.default_rng(seed).normal(scale=np.repeat([0.2, np.deg2rad(6.0)], 3)))


def contrast(color: NDArray[np.uint8]) -> float:
    """Mean difference of a picture from an unrelated one."""
    return float(np.abs(color.astype(float) - color[::-1, ::-1]).mean())


def test_points_lie_on_the_room_s_surfaces_in_the_colours_of_their_pixels() -> None:
    pose = looking_around(6)[2]
    color, depth_m = ROOM.view(pose, FINE)
    depth_m[:20] = 0.0
    points = points_of(color, depth_m, FINE.pixel_rays(), pose)
    usable = (depth_m > 0.0) & ~at_discontinuity(depth_m, 0.1)
    assert points.points.shape == (usable.sum(), 3) and points.points.dtype == np.float64
    np.testing.assert_array_equal(points.colors, color[usable])
    assert ROOM.distance_m(points.points).max() < 1e-5
    rows, columns = np.nonzero(usable)
    in_camera = transform(invert(pose), points.points)
    np.testing.assert_allclose(FINE.project(in_camera), np.stack([columns, rows], axis=1), atol=1e-6)


def test_pixels_at_a_depth_jump_are_left_out() -> None:
    """They mix foreground and background, and would float between the two."""
    depth_m = np.full((FINE.height, FINE.width), 2.0, dtype=np.float32)
    depth_m[:, 100:] = 3.0
    points = points_of(np.zeros((FINE.height, FINE.width, 3), np.uint8), depth_m, FINE.pixel_rays(), IDENTITY)
    assert len(points.points) == FINE.height * (FINE.width - 2)


@pytest.mark.parametrize("index", range(2))
def test_a_frame_seen_from_its_own_pose_is_itself(index: int) -> None:
    pose = looking_around(2)[index]
    color, depth_m = forward_warp([seen_from(pose)], pose, VIEW)
    expected_color, expected_depth = rendered(pose)
    assert color.shape == (64, 96, 3) and color.dtype == np.uint8
    assert depth_m.shape == (64, 96) and depth_m.dtype == np.float32
    known = depth_m > 0.0
    assert known.mean() > 0.98
    error = np.abs(depth_m / expected_depth - 1.0)[known]
    assert np.median(error) < 0.01 and np.mean(error > 0.1) < 0.01
    assert np.abs(color.astype(float) - expected_color).mean() < 0.35 * contrast(expected_color)


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_view_from_another_pose_is_what_the_room_looks_like_there(seed: int) -> None:
    pose = looking_around(8, seed)[seed % 8]
    elsewhere = moved(pose, seed)
    color, depth_m = forward_warp([seen_from(pose)], elsewhere, VIEW)
    expected_color, expected_depth = rendered(elsewhere)
    known = depth_m > 0.0
    error = np.abs(depth_m / expected_depth - 1.0)[known]
    assert np.median(error) < 0.02
    # The background shows through where a surface was not seen: in 1 % of 400 views, by 11 % at most.
    assert np.mean(error > 0.1) < 0.2
    difference = np.abs(color.astype(float) - expected_color)[known]
    assert difference.mean() < 0.45 * contrast(expected_color)
    # Nothing is invented where nothing is known.
    np.testing.assert_array_equal(depth_m[~known], 0.0)


def test_noise_does_not_bring_surfaces_nearer() -> None:
    """Depth is the mean of a surface's points; the nearest of them would be too near by more than the noise."""
    rng = np.random.default_rng(0)
    normal, offset_m = np.array([0.5, 0.3, 0.8]), 2.0
    pose = se3_exp([0.1, 0.05, 0.2, 0.02, -0.05, 0.01])
    exact = offset_m / (FINE.pixel_rays() @ normal)
    sources = []
    for _ in range(3):
        measured = (exact * np.exp(rng.normal(scale=0.01, size=exact.shape))).astype(np.float32)
        nothing = np.zeros((*exact.shape, 3), dtype=np.uint8)
        sources.append(points_of(nothing, measured, FINE.pixel_rays(), IDENTITY))
    depth_m = forward_warp(sources, pose, VIEW)[1]
    rays = VIEW.pixel_rays() @ pose[:3, :3].T
    expected = (offset_m - pose[:3, 3] @ normal) / (rays @ normal)
    known = depth_m > 0.0
    error = np.log(depth_m[known] / expected[known])
    assert known.mean() > 0.8
    assert abs(np.median(error)) < 0.001 and np.median(np.abs(error)) < 0.005


def test_more_frames_leave_fewer_holes() -> None:
    poses = looking_around(8)
    elsewhere = moved(poses[0], 3)
    few, many = (forward_warp([seen_from(p) for p in chosen], elsewhere, VIEW)[1] for chosen in (poses[:1], poses))
    assert np.mean(many > 0.0) > np.mean(few > 0.0)
    assert (many > 0.0)[few > 0.0].all()


def test_views_are_not_shifted_sideways() -> None:
    """The shift, in pixels, that best explains the difference to the room rendered there."""
    slopes, errors = [], []
    for seed, pose in enumerate(looking_around(8)):
        elsewhere = moved(pose, seed)
        color, depth_m = forward_warp([seen_from(pose)], elsewhere, VIEW)
        expected_color, expected_depth = rendered(elsewhere)
        ours, theirs = (
            cv2.GaussianBlur(image[..., 0].astype(float), (0, 0), 1.0) for image in (color, expected_color)
        )
        known = cv2.erode((depth_m > 0.0).astype(np.uint8), np.ones((5, 5))) > 0
        known &= np.abs(depth_m / expected_depth - 1.0) < 0.03
        along_y, along_x = np.gradient(theirs)
        slopes.append(np.stack([along_x[known], along_y[known]], axis=1))
        errors.append((ours - theirs)[known])
    shift_px = np.linalg.lstsq(np.concatenate(slopes), np.concatenate(errors), rcond=None)[0]
    assert np.abs(shift_px).max() < 0.2


def wall(z_m: float, color: NDArray[np.uint8], spacing_m: float = 0.02) -> ColoredPoints:
    """A wall across the view, as points."""
    y, x = np.mgrid[-2.0:2.0:spacing_m, -2.0:2.0:spacing_m].reshape(2, -1)
    points = np.stack([x, y, np.full_like(x, z_m)], axis=1)
    return ColoredPoints(points, np.repeat(color, len(points), axis=0))


@pytest.mark.parametrize("near_first", [True, False])
def test_the_nearest_surface_is_seen(near_first: bool) -> None:
    near, far = wall(1.0, RED), wall(1.5, GREEN)
    color, depth_m = forward_warp([near, far] if near_first else [far, near], IDENTITY, CAMERA)
    np.testing.assert_allclose(depth_m, 1.0)
    np.testing.assert_array_equal(color, np.broadcast_to(RED, color.shape))


def test_points_behind_the_camera_or_too_near_are_not_seen() -> None:
    far = wall(1.5, GREEN)
    color, depth_m = forward_warp([wall(-1.0, RED), wall(0.05, RED), far], IDENTITY, CAMERA)
    np.testing.assert_allclose(depth_m, 1.5)
    np.testing.assert_array_equal(color, np.broadcast_to(GREEN, color.shape))


def test_distortion_folds_no_far_off_axis_point_into_a_view() -> None:
    """The polynomial maps a ray far off the axis back into the image: here at four times the view's half width."""
    distorted = replace(CAMERA, distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))
    aside = np.array([[2.0, 0.0, 1.0]])
    u, v = distorted.project(aside)[0]
    assert 0.0 <= u < CAMERA.width and 0.0 <= v < CAMERA.height
    color, depth_m = forward_warp([wall(1.5, GREEN), ColoredPoints(aside, RED)], IDENTITY, distorted)
    assert (depth_m[depth_m > 0.0] == 1.5).all() and not (color[..., 0] > 2).any()


def test_holes_have_no_depth_and_the_colour_of_their_border() -> None:
    points = wall(1.5, GREEN)
    inside = (np.abs(points.points[:, :2]) < 0.35).all(axis=1)
    color, depth_m = forward_warp([ColoredPoints(points.points[~inside], points.colors[~inside])], IDENTITY, CAMERA)
    assert (depth_m[5:7, 7:9] == 0.0).all()
    assert (depth_m[[0, -1]] > 0.0).all() and (depth_m[:, [0, -1]] > 0.0).all()
    assert set(np.unique(depth_m)) == {0.0, 1.5}
    np.testing.assert_allclose(color, np.broadcast_to(GREEN, color.shape), atol=2)  # no black, which no surface has


def test_a_view_of_nothing_has_no_depth() -> None:
    color, depth_m = forward_warp([wall(-1.0, RED)], IDENTITY, CAMERA)
    assert color.shape == (12, 16, 3) and color.dtype == np.uint8
    assert not depth_m.any()


def test_surface_that_comes_closer_has_no_gaps() -> None:
    """Up to half the distance: there its points are as far apart as each of them is wide."""
    pose = IDENTITY.copy()
    depth_m = np.full((FINE.height, FINE.width), 2.0, dtype=np.float32)
    surface = points_of(np.full((FINE.height, FINE.width, 3), 200, np.uint8), depth_m, FINE.pixel_rays(), pose)
    pose[2, 3] = 0.95
    _, seen = forward_warp([surface], pose, VIEW)
    np.testing.assert_allclose(seen, 1.05, rtol=1e-6)


def test_the_order_of_frames_does_not_matter() -> None:
    poses = looking_around(6)[:3]
    sources = [seen_from(pose) for pose in poses]
    elsewhere = moved(poses[1], 0)
    one, other = (forward_warp(order, elsewhere, VIEW) for order in (sources, sources[::-1]))
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_allclose(one[1], other[1], rtol=1e-6)  # rounding differs with the order of a sum
