"""Sectors of a depth image against what a person who stands at the vehicle would measure."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mavlink_helpers import over_the_wire
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.mavlink.messages import UNKNOWN_CM, obstacle_distance
from monoloc.mavlink.obstacle_sectors import LEAST_M, MOST_M, SECTORS, sector_distances_cm
from monoloc_lab.soak.ardupilot_decoder import ArduPilot
from monoloc_lab.soak.px4_decoder import Px4

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)  # 67 degrees wide
LEVEL = Mount().T_body_camera


def wall(distance_m: float, T_level_camera: FloatArray = LEVEL) -> DepthPrediction:
    """A vertical wall ahead of the camera."""
    rays = CAMERA.pixel_rays() @ T_level_camera[:3, :3].T
    depth = np.where(rays[..., 0] > 0.1, distance_m / np.maximum(rays[..., 0], 0.1), 0.0)
    return DepthPrediction(depth.astype(np.float32), CAMERA)


def distances_of(depth: DepthPrediction, T_level_camera: FloatArray = LEVEL) -> NDArray[np.uint16]:
    return sector_distances_cm(depth, 0.0, T_level_camera)


def test_wall_ahead_is_nearest_ahead_and_farther_to_the_sides() -> None:
    distances = distances_of(wall(2.0))
    for sector in (0, 1, 4, SECTORS - 4):
        bearing = np.deg2rad(5.0 * (sector if sector < 36 else sector - SECTORS))
        assert distances[sector] == pytest.approx(200.0 / np.cos(bearing), rel=0.03)
    assert np.all(distances[8:65] == UNKNOWN_CM)  # outside the image


@pytest.mark.parametrize("turn", [(0.0, 0.3, 0.0), (0.4, -0.2, 0.0), (-0.5, 0.0, 0.0)])
def test_tilt_of_the_camera_changes_nothing_where_the_wall_is_seen(turn: tuple[float, float, float]) -> None:
    tilted = make_pose(so3_exp(turn), np.zeros(3)) @ LEVEL
    distances = distances_of(wall(2.0, tilted), tilted)
    assert distances[0] == pytest.approx(200.0, rel=0.02)


def test_floor_below_is_no_obstacle_and_a_post_at_the_right_is() -> None:
    depth = wall(4.0).depth_m.copy()
    depth[:, 130:136] = 1.0  # a post, 23 degrees to the right
    down = CAMERA.pixel_rays()[..., 1]
    depth = np.where(down > 0.1, np.minimum(depth, 0.4 / np.maximum(down, 0.1)), depth)  # the floor, 40 cm below
    distances = distances_of(DepthPrediction(depth.astype(np.float32), CAMERA))
    post = round(np.rad2deg(np.arctan2(133 - 79.5, 120.0)) / 5.0)
    assert distances[post] == pytest.approx(100.0 / np.cos(np.deg2rad(24.0)), rel=0.05)
    assert distances[0] == pytest.approx(400.0, rel=0.02)


def test_far_is_free_and_nothing_is_unknown() -> None:
    assert distances_of(wall(20.0))[0] == round(100.0 * MOST_M) + 1
    nothing = DepthPrediction(np.zeros((120, 160), dtype=np.float32), CAMERA)
    assert np.all(distances_of(nothing) == UNKNOWN_CM)


def test_single_near_pixels_are_outliers() -> None:
    depth = wall(3.0).depth_m.copy()
    depth[60, 80] = 0.2
    assert distances_of(DepthPrediction(depth, CAMERA))[0] == pytest.approx(300.0, rel=0.02)


def test_both_firmwares_read_the_same_bearings() -> None:
    distances = distances_of(wall(2.0))
    distances[3] = round(100.0 * MOST_M) + 1
    message = over_the_wire(obstacle_distance(1.0, distances, LEAST_M, MOST_M))
    px4, ardupilot = Px4.nearest_obstacle(message), ArduPilot.obstacles(message)
    assert px4[0] == ardupilot[0.0] == pytest.approx(2.0, rel=0.02)
    assert px4[71] == ardupilot[355.0] and px4[3] == np.inf and 15.0 not in ardupilot
    assert set(px4) == {sector for sector in range(SECTORS) if distances[sector] != UNKNOWN_CM}
