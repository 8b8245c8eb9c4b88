"""Inputs of the measurements, and the alternatives that they compare."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning

from map_helpers import make_mixture
from monoloc.map.em import fit_mixture, initial_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc_lab.bench.alternatives import DenseWeigher, sklearn_mixture, sklearn_scorer
from monoloc_lab.bench.kernels import peak_gflops, weigh_flops
from monoloc_lab.bench.scaling import tuned_dense
from monoloc_lab.bench.scenes import building, near_surface, synthetic_cloud, weighing
from monoloc_lab.bench.timing import fastest_s


@pytest.fixture(scope="module")
def cloud() -> np.ndarray:
    return synthetic_cloud(3000, np.random.default_rng(0))


@pytest.fixture(scope="module")
def mixture(cloud: np.ndarray) -> GaussianMixture:
    return fit_mixture(cloud, 20, np.random.default_rng(0), max_iterations=10).mixture


def test_alternatives_compute_the_same(cloud: np.ndarray, mixture: GaussianMixture) -> None:
    given = weighing(cloud, 15, 30, np.random.default_rng(1))
    exact = mixture.log_density(given.points_world)
    near = exact > np.log(0.1 / mixture.volume_m3)
    np.testing.assert_allclose(DenseWeigher(mixture).log_density(given.points_world)[near], exact[near], atol=0.02)
    single = tuned_dense(DenseWeigher(mixture, np.float32), given.points_world)
    np.testing.assert_allclose(single[near], exact[near], atol=0.02)
    np.testing.assert_allclose(sklearn_scorer(mixture).score_samples(given.points_world), exact, rtol=1e-6)
    share, volume = 0.1, mixture.volume_m3
    ours = mixture.index().weigh(given.poses, given.log_scales, given.scan, outlier_share=share, volume_m3=volume)
    theirs = DenseWeigher(mixture).weigh(given.points_world, 15, share, volume)
    np.testing.assert_allclose(theirs, ours, atol=0.02 * 30)


def test_sklearn_starts_from_the_same_mixture(cloud: np.ndarray) -> None:
    start = initial_mixture(cloud, 5, np.random.default_rng(0), 0.01)
    oracle = sklearn_mixture(start, 0.01, 1)
    with pytest.warns(ConvergenceWarning):  # one iteration, whose bound is that of the start
        oracle.fit(cloud)
    assert oracle.lower_bound_ == pytest.approx(start.log_density(cloud).mean(), abs=1e-3)


def test_building_consists_of_copies_of_the_room(mixture: GaussianMixture) -> None:
    rooms = building(mixture, 75, np.random.default_rng(0))
    assert len(rooms) == 80
    np.testing.assert_allclose(rooms.means[:20], mixture.means)
    lower, upper = mixture.bounds_m()
    assert rooms.bounds_m()[1][0] - rooms.bounds_m()[0][0] > 1.9 * (upper - lower)[0]


def test_scan_lies_on_the_cloud_in_front_of_the_camera(cloud: np.ndarray) -> None:
    given = weighing(cloud, 3, 50, np.random.default_rng(0))
    assert given.scan.shape == (50, 3) and given.points_world.shape == (150, 3)
    assert given.scan[:, 2].min() > 0.0
    displaced = near_surface(cloud, 0.1, np.random.default_rng(0))
    assert np.linalg.norm(displaced[len(cloud) :] - cloud, axis=1).max() <= 0.1 + 1e-12


def test_only_evaluated_components_count_as_operations() -> None:
    crowded = make_mixture(300)
    given = weighing(crowded.sample(2000, np.random.default_rng(0)), 10, 20, np.random.default_rng(0))
    few, many = weigh_flops(crowded.index(0.05), given), weigh_flops(crowded.index(0.4), given)
    assert 0.0 < few < many
    assert peak_gflops() > 0.1


def test_compared_functions_take_turns() -> None:
    calls: list[str] = []
    times = fastest_s({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, rounds=2)
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert set(times) == {"a", "b"}
