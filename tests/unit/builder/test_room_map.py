"""The cloud that a map is fitted to."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import room_cloud
from monoloc.progress import NoProgress
from synthetic_room import Room


@pytest.mark.parametrize("count", [500, 3000, 20_000])
def test_points_without_neighbours_go_and_those_of_a_sparse_cloud_stay(count: int) -> None:
    """A structure-from-motion cloud has a few thousand points a room."""
    rng = np.random.default_rng(0)
    surfaces = rng.permutation(Room().cloud(0.02))[:count]
    low, high = surfaces.min(axis=0), surfaces.max(axis=0)
    far_off = low - (high - low) * rng.uniform(0.5, 3.0, (count // 50, 3))
    cloud = room_cloud(None, np.concatenate([surfaces, far_off]), BuildConfig(), NoProgress())
    assert 0.5 * count < len(cloud) <= count
    assert np.all(cloud >= low - 1e-9)
