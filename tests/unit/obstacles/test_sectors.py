"""Sectors of a depth image against what a person who stands at the vehicle would measure."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from monoloc.obstacles.sectors import SECTORS, depth_points, sector_distances_m

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)  # 67 degrees wide
LEVEL = Mount().T_body_camera


def wall(distance_m: float, T_level_camera: FloatArray = LEVEL) -> DepthPrediction:
    """A vertical wall ahead of the camera."""
    rays = CAMERA.pixel_rays() @ T_level_camera[:3, :3].T
    depth = np.where(rays[..., 0] > 0.1, distance_m / np.maximum(rays[..., 0], 0.1), 0.0)
    return DepthPrediction(depth.astype(np.float32), CAMERA)


def distances_of(depth: DepthPrediction, T_level_camera: FloatArray = LEVEL, log_scale: float = 0.0) -> FloatArray:
    return sector_distances_m(transform(T_level_camera, depth_points(depth, log_scale)))


def test_wall_ahead_is_nearest_ahead_and_farther_to_the_sides() -> None:
    distances = distances_of(wall(2.0))
    for sector in (0, 1, 4, SECTORS - 4):
        bearing = np.deg2rad(5.0 * (sector if sector < 36 else sector - SECTORS))
        assert distances[sector] == pytest.approx(2.0 / np.cos(bearing), rel=0.03)
    assert np.all(np.isnan(distances[8:65]))  # outside the image


def test_depth_has_the_scale_of_the_belief() -> None:
    assert distances_of(wall(2.0), log_scale=float(np.log(1.5)))[0] == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("turn", [(0.0, 0.3, 0.0), (0.4, -0.2, 0.0), (-0.5, 0.0, 0.0)])
def test_tilt_of_the_camera_changes_nothing_where_the_wall_is_seen(turn: tuple[float, float, float]) -> None:
    tilted = make_pose(so3_exp(turn), np.zeros(3)) @ LEVEL
    assert distances_of(wall(2.0, tilted), tilted)[0] == pytest.approx(2.0, rel=0.02)


def test_floor_below_is_no_obstacle_and_a_post_at_the_right_is() -> None:
    depth = wall(4.0).depth_m.copy()
    depth[:, 130:136] = 1.0  # a post, 23 degrees to the right
    down = CAMERA.pixel_rays()[..., 1]
    depth = np.where(down > 0.1, np.minimum(depth, 0.4 / np.maximum(down, 0.1)), depth)  # the floor, 40 cm below
    distances = distances_of(DepthPrediction(depth.astype(np.float32), CAMERA))
    post = round(np.rad2deg(np.arctan2(133 - 79.5, 120.0)) / 5.0)
    assert distances[post] == pytest.approx(1.0 / np.cos(np.deg2rad(24.0)), rel=0.05)
    assert distances[0] == pytest.approx(4.0, rel=0.02)


def test_far_is_free_and_nothing_is_unknown() -> None:
    assert distances_of(wall(20.0))[0] == np.inf
    nothing = DepthPrediction(np.zeros((120, 160), dtype=np.float32), CAMERA)
    assert np.all(np.isnan(distances_of(nothing)))


def test_single_near_pixels_are_outliers() -> None:
    depth = wall(3.0).depth_m.copy()
    depth[60, 80] = 0.2
    assert distances_of(DepthPrediction(depth, CAMERA))[0] == pytest.approx(3.0, rel=0.02)
