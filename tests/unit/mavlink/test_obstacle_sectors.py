"""Distances as both firmwares take them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mavlink_helpers import over_the_wire
from monoloc.mavlink.messages import UNKNOWN_CM, obstacle_distance
from monoloc.mavlink.obstacle_sectors import sector_distances_cm
from monoloc.obstacles import LEAST_M, MOST_M, SECTORS
from monoloc_lab.soak.ardupilot_decoder import ArduPilot


def test_free_is_beyond_the_range_and_unknown_is_said() -> None:
    distances_m = np.full(SECTORS, np.nan)
    distances_m[:4] = [np.inf, 2.344, 0.1, MOST_M]
    distances_cm = sector_distances_cm(distances_m)
    assert distances_cm[:4].tolist() == [
        round(100.0 * MOST_M) + 1,
        234,
        round(100.0 * LEAST_M),
        round(100.0 * MOST_M),
    ]
    assert np.all(distances_cm[4:] == UNKNOWN_CM) and distances_cm.dtype == np.uint16


def px4_bins_m(message: Any) -> dict[int, float]:
    """Distance of each 5-degree bin clockwise from forward that has data; free bins are infinite.

    Sources: ``mavlink_receiver.cpp`` (handle_message_obstacle_distance) and ``CollisionPrevention.cpp`` of PX4.
    """
    assert message.frame == 12  # MAV_FRAME_BODY_FRD
    increment = message.increment_f if message.increment_f > 0 else float(message.increment)
    bins: dict[int, float] = {}
    for index, value in enumerate(message.distances):
        if value != 65535 and value >= message.min_distance:
            bearing = (message.angle_offset + index * increment) % 360.0
            bins[round(bearing / 5.0) % 72] = np.inf if value > message.max_distance else value / 100.0
    return bins


def test_both_firmwares_read_the_same_bearings() -> None:
    distances_m = np.full(SECTORS, np.nan)
    distances_m[[0, 71]] = 2.0
    distances_m[3] = np.inf
    distances_cm = sector_distances_cm(distances_m)
    message = over_the_wire(obstacle_distance(1.0, distances_cm, LEAST_M, MOST_M))
    px4, ardupilot = px4_bins_m(message), ArduPilot.obstacles(message)
    assert px4[0] == ardupilot[0.0] == pytest.approx(2.0, rel=0.02)
    assert px4[71] == ardupilot[355.0] and px4[3] == np.inf and 15.0 not in ardupilot
    assert set(px4) == {0, 3, 71}
