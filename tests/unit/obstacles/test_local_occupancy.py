"""Local occupancy of frames before a wall: one frame that errs, a turn, a jump, what is free and how surely."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, make_pose, so3_exp
from monoloc.obstacles import MOST_M, DepthError, LocalOccupancy, Surroundings
from monoloc.particle_filter.estimate import Estimate

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
LEVEL = Mount().T_body_camera
ERROR = DepthError(relative_sd=0.06, absolute_sd_m=0.0, is_measured=True)


def wall(distance_m: float, yaw_rad: float = 0.0) -> DepthPrediction:
    """A wall across the world's x axis at a distance from a level vehicle that is turned clockwise."""
    ahead = (CAMERA.pixel_rays() @ LEVEL[:3, :3].T) @ np.array([np.cos(yaw_rad), -np.sin(yaw_rad), 0.0])
    depth = np.where(ahead > 0.1, distance_m / np.maximum(ahead, 0.1), 0.0)
    return DepthPrediction(depth.astype(np.float32), CAMERA)


def nothing() -> DepthPrediction:
    return DepthPrediction(np.zeros((60, 80), dtype=np.float32), CAMERA)


def look(
    occupancy: LocalOccupancy, time_s: float, depth: DepthPrediction, x_m: float = 0.0, yaw_rad: float = 0.0
) -> Surroundings:
    """A frame of a vehicle at a place and heading of a world whose z axis points down."""
    T_world_level = make_pose(so3_exp([0.0, 0.0, yaw_rad]), [x_m, 0.0, 0.0])
    return occupancy.update(time_s, depth, Estimate(T_world_level @ LEVEL, np.zeros((6, 6)), 0.0), LEVEL)


def test_wall_comes_nearer_as_the_vehicle_flies() -> None:
    occupancy = LocalOccupancy(ERROR)
    for frame in range(12):
        x_m = 0.1 * frame
        around = look(occupancy, 0.1 * frame, wall(3.0 - x_m), x_m)
        assert around.distances_m[0] == pytest.approx(3.0 - x_m, rel=0.02)
        assert around.sd_m[0] == pytest.approx(0.06 * (3.0 - x_m), rel=0.02)
    assert around.log_odds[0, 5] < 0.0 < around.log_odds[0, 19] and around.log_odds[0, 40] == 0.0


def test_frame_that_misses_the_wall_does_not_open_the_way() -> None:
    occupancy = LocalOccupancy(ERROR)
    for frame in range(5):
        look(occupancy, 0.1 * frame, wall(2.0))
    assert look(occupancy, 0.5, wall(4.5)).distances_m[0] == pytest.approx(2.0, abs=0.06)
    assert look(occupancy, 0.6, nothing()).distances_m[0] == pytest.approx(2.0, abs=0.06)


def test_new_obstacle_counts_at_once_and_a_false_one_is_soon_forgotten() -> None:
    occupancy = LocalOccupancy(ERROR)
    for frame in range(8):
        look(occupancy, 0.1 * frame, wall(4.0))
    assert look(occupancy, 0.8, wall(1.0)).distances_m[0] == pytest.approx(1.0, rel=0.02)
    assert look(occupancy, 0.9, wall(4.0)).distances_m[0] == pytest.approx(4.0, rel=0.02)


def test_what_left_the_image_is_remembered_for_a_second() -> None:
    occupancy = LocalOccupancy(ERROR)
    look(occupancy, 0.0, wall(2.0))
    turned = look(occupancy, 0.5, nothing(), yaw_rad=np.pi / 2.0)
    assert turned.distances_m[54] == pytest.approx(2.0, abs=0.06)  # a quarter turn to the left
    assert np.isnan(turned.distances_m[0])
    assert np.all(np.isnan(look(occupancy, 1.1, nothing(), yaw_rad=np.pi / 2.0).distances_m))


@pytest.mark.parametrize("is_cleared", [True, False])
def test_nothing_is_remembered_over_a_jump_or_a_clock_that_runs_backwards(is_cleared: bool) -> None:
    occupancy = LocalOccupancy(ERROR)
    look(occupancy, 1.0, wall(2.0))
    if is_cleared:
        occupancy.clear()
    assert np.all(np.isnan(look(occupancy, 1.1 if is_cleared else 0.9, nothing()).distances_m))


def around(distances: dict[int, float]) -> Surroundings:
    around_m: FloatArray = np.full(72, np.inf)
    around_m[list(distances)] = list(distances.values())
    return Surroundings(around_m, np.zeros((72, 50)), ERROR)


def test_free_space_ends_at_what_the_vehicle_would_touch() -> None:
    """An obstacle at 30 degrees and 1 m is half a metre aside, and 0.87 m ahead."""
    beside = around({6: 1.0})
    assert beside.free_ahead(0.3).distance_m == MOST_M
    assert beside.free_ahead(0.5).distance_m == pytest.approx(np.cos(np.deg2rad(30.0)))
    assert beside.free_ahead(0.3, np.deg2rad(30.0)).distance_m == pytest.approx(1.0)
    assert beside.free_ahead(0.3, np.deg2rad(210.0)).distance_m == MOST_M  # behind


def test_bound_is_two_standard_deviations_nearer_and_the_unknown_is_not_free() -> None:
    ahead = around({0: 2.0, 36: np.nan})
    free = ahead.free_ahead(0.3)
    assert (free.distance_m, free.sd_m) == (2.0, pytest.approx(0.12))
    assert free.least_m == pytest.approx(1.76)
    assert ahead.free_ahead(0.3, np.pi).distance_m == ahead.free_ahead(0.3, np.pi).least_m == 0.0
    # A way of 0.8 m crosses sectors up to 22 degrees aside a metre ahead; farther aside is beside the vehicle.
    narrow = around({sector % 72: np.nan for sector in range(4, 69)})
    assert narrow.free_ahead(0.2).distance_m == MOST_M and narrow.free_ahead(0.4).distance_m == 0.0
    assert around(dict.fromkeys(range(5, 68), np.nan)).free_ahead(0.4).distance_m == MOST_M


@pytest.mark.parametrize("way", [(0.3, np.nan), (np.nan, 0.0), (0.3, np.inf), (-0.3, 0.0)])
def test_way_that_is_none_is_refused_and_not_free(way: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="half_width_m must be 0 or more and azimuth_rad a number, got "):
        around(dict.fromkeys(range(72), 1.0)).free_ahead(*way)
