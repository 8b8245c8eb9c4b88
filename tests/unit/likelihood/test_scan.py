"""Scans: which pixels and corners they take, and how their points are weighted."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.depth_image import at_discontinuity
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import transform
from monoloc.likelihood.scan import scan_from_corners, scan_from_depth
from monoloc.odometry.motion import Motion
from synthetic_room import CAMERA, Room, make_path

SMALL = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
POSE = make_path(1, start_s=1.0)[0]


@pytest.fixture(scope="module")
def room() -> Room:
    return Room()


@pytest.mark.parametrize("distortion", [(0.0,) * 5, (-0.2, 0.05, 0.001, -0.002, 0.01)])
def test_points_lie_on_surfaces_evenly_over_the_image(room: Room, distortion: tuple[float, ...]) -> None:
    camera = Camera(160, 128, 136.0, 136.0, 79.5, 63.5, distortion)
    _, depth = room.view(POSE, camera)
    scan = scan_from_depth(DepthPrediction(depth, camera), 200, np.random.default_rng(0))
    assert scan.points.shape == (200, 3) and scan.points.dtype == np.float32
    assert np.array_equal(scan.weights, np.ones(200, dtype=np.float32))
    pixels = np.round(camera.project(scan.points)).astype(int)
    assert np.allclose(camera.project(scan.points), pixels, atol=1e-3)
    assert np.allclose(scan.points[:, 2], depth[pixels[:, 1], pixels[:, 0]])
    assert not at_discontinuity(depth, 0.15)[pixels[:, 1], pixels[:, 0]].any()
    assert room.distance_m(transform(POSE, scan.points)).max() < 1e-5
    assert len(np.unique(pixels, axis=0)) == 200
    quarters = np.bincount((pixels[:, 0] >= 80) + 2 * (pixels[:, 1] >= 64), minlength=4)
    assert quarters.min() > 30


def test_points_differ_between_frames_and_repeat_with_the_seed(room: Room) -> None:
    _, depth = room.view(POSE)
    rng = np.random.default_rng(3)
    first, second = (scan_from_depth(DepthPrediction(depth, CAMERA), 100, rng) for _ in range(2))
    again = scan_from_depth(DepthPrediction(depth, CAMERA), 100, np.random.default_rng(3))
    assert np.array_equal(first.points, again.points)
    assert not np.array_equal(first.points, second.points)


def test_far_and_missing_pixels_are_left_out() -> None:
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    depth[:, :10] = 0.0
    depth[:, 30:] = 9.0
    scan = scan_from_depth(DepthPrediction(depth, SMALL), 10_000, np.random.default_rng(0), max_depth_m=8.0)
    columns = np.round(SMALL.project(scan.points)[:, 0]).astype(int)
    # The column beside the step from 2 to 9 m is at a discontinuity; that beside missing depth is not.
    assert sorted(set(columns)) == list(range(10, 29))
    assert len(scan) == 19 * 30
    assert np.all(scan.points[:, 2] == 2.0)


def test_both_sides_of_a_discontinuity_are_left_out() -> None:
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    depth[10:20, 10:20] = 1.0
    scan = scan_from_depth(DepthPrediction(depth, SMALL), 10_000, np.random.default_rng(0), depth_jump=0.5)
    pixels = np.round(SMALL.project(scan.points)).astype(int)
    taken = np.zeros((30, 40), dtype=bool)
    taken[pixels[:, 1], pixels[:, 0]] = True
    assert not taken[9, 10:20].any() and not taken[10, 10:20].any()
    assert not taken[10:20, 19].any() and not taken[10:20, 20].any()
    assert taken[11:19, 11:19].all() and taken[:9].all() and taken[21:].all()


@pytest.mark.parametrize("depth_m", [0.0, 20.0])
def test_scan_without_usable_pixels_is_empty(depth_m: float) -> None:
    depth = np.full((30, 40), depth_m, dtype=np.float32)
    scan = scan_from_depth(DepthPrediction(depth, SMALL), 50, np.random.default_rng(0))
    assert scan.points.shape == (0, 3) and scan.points.dtype == np.float32 and len(scan) == 0


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_points_with_a_larger_stated_error_weigh_less(power: float) -> None:
    depth = np.full((30, 40), 2.0, dtype=np.float32)
    log_error = np.log(np.where(np.arange(40) < 20, 0.1, 0.15)).astype(np.float32) * np.ones((30, 1), np.float32)
    log_error[0, 0], log_error[0, 39] = -20.0, 20.0
    stated = DepthPrediction(depth, SMALL, log_error)
    scan = scan_from_depth(stated, 10_000, np.random.default_rng(0), power)
    columns, rows = np.round(SMALL.project(scan.points)).astype(int).T
    certain = scan.weights[(columns < 20) & (rows > 0)]
    uncertain = scan.weights[(columns >= 20) & (rows > 0)]
    assert scan.weights.mean() == pytest.approx(1.0, rel=1e-5) and scan.weights.dtype == np.float32
    assert np.ptp(certain) == 0.0 and certain[0] / uncertain[0] == pytest.approx(1.5**power, rel=1e-3)
    # However extreme a stated error, its point neither dominates nor vanishes.
    assert scan.weights.max() / scan.weights.min() == pytest.approx(16.0, rel=1e-3)
    uniform = scan_from_depth(stated, 10_000, np.random.default_rng(0), 0.0)
    assert np.array_equal(uniform.points, scan.points) and np.all(uniform.weights == 1.0)


def test_corners_are_taken_whose_depth_parallax_has_refined() -> None:
    # Of the others, one is too uncertain, one too far, one behind the camera, and one on its plane.
    points = np.array(
        [[0.1, 0.2, 2.0], [0.3, 0.1, 3.0], [0.5, 0.0, 9.0], [0.0, 0.0, 4.0], [0.1, 0.0, -2.0], [0.1, 0, 0]]
    )
    motion = Motion(np.eye(4), 6, points, np.array([0.02, 0.3, 0.02, 0.05, 0.02, 0.02]))
    scan = scan_from_corners(motion, max_log_depth_sd=0.1)
    assert scan.points.dtype == np.float32
    assert np.allclose(scan.points, points[[0, 3]])
    assert len(scan_from_corners(motion, max_log_depth_sd=0.01)) == 0
