"""Local refits: what is far is not touched, mass is conserved, and the border is sharp."""

from __future__ import annotations

import numpy as np
import pytest

from map_helpers import make_mixture
from monoloc.editing.box import Box
from monoloc.map.cloud import voxel_thin
from monoloc.map.em import fit_mixture
from monoloc.map.local_fit import Components, estimated_points, fitted, part

DOWN = np.array([0.0, 1.0, 0.0])
POINTS = 20_000.0


def plate(rng: np.random.Generator, count: int = 20_000) -> np.ndarray:
    """Points of a plate of 4 x 4 m in the plane z = 2."""
    return np.column_stack([rng.uniform(-2.0, 2.0, (count, 2)), rng.normal(2.0, 0.01, count)])


def box(lower: tuple[float, float, float], upper: tuple[float, float, float]) -> Box:
    return Box.between(np.array(lower), np.array(upper), DOWN)


def test_plate_gets_a_hole_and_is_kept_around_it() -> None:
    rng = np.random.default_rng(0)
    components = Components.of(fit_mixture(plate(rng), 60, rng).mixture, POINTS)
    hole = box((-0.7, -0.7, 1.5), (0.7, 0.7, 2.5))
    parted = part(components, hole, rng)
    rest = components[parted.is_outside] + parted.outer
    before, after = components.mixture().sample(40_000, rng), rest.mixture().sample(40_000, rng)
    share = hole.contains(before).mean()
    assert hole.contains(after).mean() < 0.15 * share
    # Around the hole, the plate has as many points as before.
    around = box((-1.2, -1.2, 1.5), (1.2, 1.2, 2.5))
    ring = (around.contains(before) & ~hole.contains(before)).mean() * components.mass.sum()
    left = (around.contains(after) & ~hole.contains(after)).mean() * rest.mass.sum()
    assert left == pytest.approx(ring, rel=0.1)
    assert np.abs(after[around.contains(after), 2] - 2.0).max() < 0.1
    assert 0 < len(parted.outer) <= 2 * (~parted.is_outside).sum()


def test_mass_is_shared_between_both_sides_and_the_far_is_not_touched() -> None:
    rng = np.random.default_rng(1)
    components = Components.of(make_mixture(60), POINTS)
    region = box((-0.4, -0.4, -0.4), (0.6, 0.5, 0.4))
    parted = part(components, region, rng)
    assert parted.is_outside.sum() > 20 and (~parted.is_outside).any()
    parts = (components[parted.is_outside], components[parted.is_inside], parted.outer, parted.inner)
    assert sum(each.mass.sum() for each in parts) == pytest.approx(POINTS, rel=0.02)
    inside = region.contains(components.mixture().sample(50_000, rng)).mean() * POINTS
    assert parts[1].mass.sum() + parts[3].mass.sum() == pytest.approx(inside, rel=0.1)


def test_region_in_empty_space_changes_nothing() -> None:
    components = Components.of(make_mixture(10), POINTS)
    parted = part(components, box((9.0, 9.0, 9.0), (10.0, 10.0, 10.0)), np.random.default_rng(0))
    assert parted.is_outside.all() and not len(parted.inner) and not len(parted.outer)


def test_moved_components_are_the_mixture_of_moved_points() -> None:
    region = box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    components = Components.of(make_mixture(4), 100.0)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), [1.0, 2.0, 3.0]
    moved = components.moved(pose)
    points = components.mixture().sample(200, np.random.default_rng(0))
    np.testing.assert_allclose(
        moved.mixture().log_density(points @ pose[:3, :3].T + pose[:3, 3]),
        components.mixture().log_density(points),
        rtol=1e-9,
    )
    assert region.reach_m == pytest.approx(np.sqrt(0.75))


def test_new_points_get_the_asked_number_of_components_and_their_mass() -> None:
    rng = np.random.default_rng(0)
    new = fitted(plate(rng, 500), 500.0, 4.4, rng)
    assert len(new) == 4 and new.mass.sum() == pytest.approx(500.0)
    assert len(fitted(plate(rng, 500), 500.0, 0.2, rng)) == 1
    assert len(fitted(np.zeros((0, 3)), 0.0, 3.0, rng)) == 0


@pytest.mark.parametrize("tilt", [0.0, 0.6])
def test_points_of_a_cloud_are_estimated_from_the_map(tilt: float) -> None:
    """Within a factor of two, whether the surface lies along the grid or not."""
    rng = np.random.default_rng(0)
    points = plate(rng, 400_000)
    points[:, 2] += 0.0137
    turn = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    cloud = voxel_thin(points @ turn.T, 0.03)
    estimate = estimated_points(fit_mixture(cloud, 40, rng).mixture, 0.03)
    assert 0.6 < estimate / len(cloud) < 1.8


def test_tails_around_a_thing_that_is_cut_out_leave_no_cloud_in_its_place() -> None:
    """Four sides of a table: below the box lies a fifteenth of each, far from the others."""
    sd_m, half_m = 0.15, 0.4
    sides = np.array([[half_m, 0.0, 0.0], [-half_m, 0.0, 0.0], [0.0, 0.0, half_m], [0.0, 0.0, -half_m]])
    covariances = np.tile(np.diag([0.02, sd_m, 0.02]) ** 2, (4, 1, 1))
    floor = Components(np.array([500.0]), np.array([[0.0, 3.0, 0.0]]), np.diag([1.0, 0.02, 1.0])[None] ** 2)
    table = Components(np.full(4, 100.0), sides, covariances)
    parted = part(table + floor, box((-0.5, -0.22, -0.5), (0.5, 2.0, 0.5)), np.random.default_rng(0))
    assert parted.is_outside.tolist() == [False, False, False, False, True]
    spread = np.sqrt(np.linalg.eigvalsh(parted.outer.covariances)[:, -1])
    assert len(spread) and np.all(spread < sd_m)
    assert parted.inner.mass.sum() == pytest.approx(400.0, rel=0.1)
