"""Drawing of a map before and after adaptation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.evaluation.cloud_metrics import MapClouds, cloud_distances
from monoloc.viz.map_drawing import plot_map_change
from plot_helpers import check_picture


@pytest.mark.parametrize(("down", "shift_m"), [([0.0, 1.0, 0.0], 0.0), ([0.1, 0.0, -1.0], 0.1)])
@pytest.mark.filterwarnings("error")
def test_change_of_a_map_is_drawn(tmp_path: Path, down: list[float], shift_m: float) -> None:
    cloud = np.random.default_rng(0).uniform(0.0, [4.0, 3.0, 2.0], (1000, 3))
    clouds = MapClouds(cloud, cloud + shift_m, cloud_distances(cloud, cloud + shift_m))
    plot_map_change(tmp_path / "map.png", clouds, np.array(down), "A room")
    check_picture(tmp_path / "map.png", 1500, 1200)
