"""Map and live depth joined, in a room of known walls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from monoloc.bundle import Bundle
from monoloc.geometry import make_pose
from monoloc.map import occupancy
from monoloc.obstacles import MOST_M, DepthError, MapKnowledge, Surroundings
from refusals import refuses_setting
from synthetic_room import room_bundle

# In the room, y points down: a level vehicle that looks along z, with x to its right.
T_WORLD_LEVEL = make_pose(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), [0.0, 0.0, 0.0])
ERROR = DepthError(0.05, 0.0, True)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return room_bundle(120)


def live(distances: dict[int, float]) -> Surroundings:
    around_m = np.full(72, np.nan)
    around_m[list(distances)] = list(distances.values())
    return Surroundings(around_m, np.zeros((72, 50)), ERROR)


def test_map_tells_all_directions(bundle: Bundle) -> None:
    distances_m = MapKnowledge(bundle).distances_m(T_WORLD_LEVEL)
    assert distances_m[0] == pytest.approx(3.0, abs=0.15)  # the wall ahead, at z = 3
    assert distances_m[18] == pytest.approx(2.5, abs=0.15) and distances_m[36] == pytest.approx(2.0, abs=0.15)
    assert np.isfinite(distances_m).all()


def test_what_is_nearer_is_new_what_is_farther_is_gone_and_the_rest_is_known(bundle: Bundle) -> None:
    map_m = MapKnowledge(bundle)
    known_m = map_m.distances_m(T_WORLD_LEVEL)
    joined = map_m.joined(live({0: 1.5, 1: known_m[1] * 1.03, 2: np.inf, 3: known_m[3] * 0.97}), T_WORLD_LEVEL)
    assert np.flatnonzero(joined.is_new).tolist() == [0] and np.flatnonzero(joined.is_gone).tolist() == [2]
    assert joined.distances_m[:3].tolist() == [1.5, known_m[1], known_m[2]]
    assert joined.free_ahead(0.1).distance_m == pytest.approx(1.5) and joined.live_m[0] == 1.5
    np.testing.assert_array_equal(joined.distances_m[4:], known_m[4:])  # where the camera does not look


def test_new_obstacle_in_a_direction_that_the_map_knows_as_free(bundle: Bundle) -> None:
    means = bundle.original.means
    is_wall = means[:, 2] > 2.5
    far = replace(bundle.original, means=means + is_wall[:, None] * np.array([0.0, 0.0, 4.0]))
    knowledge = MapKnowledge(replace(bundle, original=far))
    assert knowledge.distances_m(T_WORLD_LEVEL)[0] == np.inf
    joined = knowledge.joined(live({0: 2.0}), T_WORLD_LEVEL)
    assert joined.is_new[0] and joined.distances_m[0] == 2.0
    assert not knowledge.joined(live({0: MOST_M - 0.01}), T_WORLD_LEVEL).is_new[0]


def test_map_that_is_too_large_for_its_voxels_has_coarser_ones(
    bundle: Bundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = MapKnowledge(bundle).distances_m(T_WORLD_LEVEL)
    monkeypatch.setattr(occupancy, "_MOST_VOXELS", 1 << 17)
    refuses_setting(lambda: occupancy.surface_voxels(bundle.original, 0.05), "voxel_m", "for a map of", "or more")
    np.testing.assert_allclose(MapKnowledge(bundle).distances_m(T_WORLD_LEVEL), fine, atol=0.2)
