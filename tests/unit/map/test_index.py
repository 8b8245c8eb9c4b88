"""The index: weighing against its NumPy twin, and density against the exact mixture."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from map_helpers import make_mixture, make_particles, nats_with_outliers
from monoloc.map import numpy_twins
from monoloc.map.mixture import GaussianMixture
from monoloc_lab.bench.scenes import building


@pytest.mark.parametrize("with_weights", [False, True])
@pytest.mark.parametrize("particles", [1, 17, 100])
def test_weigh_equals_twin(particles: int, with_weights: bool) -> None:
    rng = np.random.default_rng(particles)
    mixture = make_mixture(60)
    poses, log_scales = make_particles(particles, rng)
    scan = mixture.sample(40, rng).astype(np.float32)
    weights = rng.uniform(0.0, 2.0, 40).astype(np.float32) if with_weights else None
    share, volume = 0.2, mixture.volume_m3
    native = mixture.index().weigh(
        poses, log_scales, scan, outlier_share=share, volume_m3=volume, point_weights=weights
    )
    twin = numpy_twins.weigh(
        poses,
        log_scales,
        scan.astype(np.float64),
        None if weights is None else weights.astype(np.float64),
        mixture.weights,
        mixture.means,
        mixture.covariances,
        share,
        volume,
    )
    np.testing.assert_allclose(native, twin, atol=0.01 * 40)  # 0.01 nat a point
    assert native.dtype == np.float64


def test_evaluations_count_whole_blocks() -> None:
    mixture = make_mixture(20)
    index = mixture.index()
    assert index.evaluations(np.full((5, 3), 1e5)) == 0
    assert index.evaluations(mixture.means) >= 8 * 20
    assert index.evaluations(mixture.means) % 8 == 0
    assert index.evaluations(np.empty((0, 3))) == 0


def assert_index_is_accurate(mixture: GaussianMixture, rng: np.random.Generator, share: float) -> None:
    """At most 0.01 nat on average and 0.1 at worst, up to 10 cm from the map's points."""
    points = mixture.sample(20_000, rng)
    directions = rng.normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points += directions * rng.uniform(0.0, 0.1, (len(points), 1)) * rng.integers(0, 2, (len(points), 1))
    index, volume = mixture.index(), mixture.volume_m3
    exact = nats_with_outliers(mixture.log_density(points), share, volume)
    error = np.abs(nats_with_outliers(index.log_density(points), share, volume) - exact)
    assert error.mean() <= 0.01
    assert error.max() <= 0.1


@pytest.mark.parametrize("share", [0.1, 0.4])
@pytest.mark.parametrize("components", [1, 200, 1000])
def test_index_is_accurate_near_the_surface(components: int, share: float) -> None:
    assert_index_is_accurate(make_mixture(components), np.random.default_rng(0), share)


def test_index_is_accurate_for_large_voxels_and_far_from_the_origin() -> None:
    mixture = make_mixture(100)
    moved = GaussianMixture(mixture.weights, mixture.means + np.array([500.0, -300.0, 20.0]), mixture.covariances)
    points = moved.sample(5000, np.random.default_rng(1))
    exact = nats_with_outliers(moved.log_density(points), 0.1, moved.volume_m3)
    for voxel_m in (0.05, 0.2, 0.4):
        indexed = nats_with_outliers(moved.index(voxel_m).log_density(points), 0.1, moved.volume_m3)
        assert np.abs(indexed - exact).max() < 0.1


def test_memory_grows_with_the_surface_not_the_box() -> None:
    near = make_mixture(50)
    apart = near.means.copy()
    apart[25:] += 100.0  # the same two clusters, a hundred metres apart
    far = GaussianMixture(near.weights, apart, near.covariances)
    floor = 0.1 / near.volume_m3
    assert far.index(floor_density=floor).nbytes <= 3 * near.index(floor_density=floor).nbytes


def test_memory_of_a_building_grows_with_its_rooms() -> None:
    """Neither memory nor the candidates at one place depend on the other rooms."""
    room = make_mixture(50)
    rooms = building(room, 1000, np.random.default_rng(0))
    floor = 0.1 / room.volume_m3
    # A room's share of the weight is a twentieth, so the floor that it sees is as well.
    one, all_of_them = room.index(floor_density=floor), rooms.index(floor_density=floor / 20.0)
    assert all_of_them.nbytes <= 25 * one.nbytes
    assert all_of_them.mean_candidates <= 1.5 * one.mean_candidates


def test_index_reports_itself_and_is_empty_outside() -> None:
    index = make_mixture(20).index(0.1)
    assert index.voxel_m == 0.1
    assert 0 < index.lists <= index.voxels
    assert index.mean_candidates >= 1.0
    assert np.isneginf(index.log_density([[1e5, 0.0, 0.0], [-1e9, 1e9, 0.0]])).all()


def test_index_under_a_floor_above_the_map_is_empty() -> None:
    index = make_mixture(5).index(floor_density=1e12)
    assert index.voxels == 0
    assert np.isneginf(index.log_density(np.zeros((3, 3)))).all()


INTERRUPTED = """
import signal, time
import numpy as np
from monoloc.map.mixture import GaussianMixture
means = np.random.default_rng(0).uniform(-5.0, 5.0, (100, 3))
mixture = GaussianMixture(np.full(100, 0.01), means, np.tile(0.09 * np.eye(3), (100, 1, 1)))
began_s = time.monotonic()
mixture.index(voxel_m=0.05)
whole_s = time.monotonic() - began_s
signal.signal(signal.SIGALRM, signal.default_int_handler)
signal.setitimer(signal.ITIMER_REAL, whole_s / 8.0)
began_s = time.monotonic()
try:
    mixture.index(voxel_m=0.05)
except KeyboardInterrupt:
    print((time.monotonic() - began_s) / whole_s)
"""


def test_ctrl_c_ends_the_construction() -> None:
    """After an eighth of its time, in a process of its own: only a main thread is interrupted."""
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 0.5


def test_no_particles_and_no_points() -> None:
    index = make_mixture(5).index()
    none = np.empty((0, 4, 4))
    assert index.weigh(none, [], np.zeros((3, 3)), outlier_share=0.1, volume_m3=1.0).shape == (0,)
    weighed = index.weigh(np.eye(4)[None], [0.0], np.empty((0, 3)), outlier_share=0.1, volume_m3=1.0)
    np.testing.assert_array_equal(weighed, [0.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.eye(4)}, r"poses must have shape \(N, 4, 4\), got \(4, 4\)"),
        ({"log_scales": np.zeros(3)}, r"log_scales must have shape \(2,\), got \(3,\)"),
        ({"scan": np.zeros((5, 2))}, r"scan must have shape \(N, 3\), got \(5, 2\)"),
        ({"point_weights": np.ones(4)}, r"point_weights must have shape \(5,\), got \(4,\)"),
        ({"outlier_share": 0.0}, r"outlier_share must be in \(0, 1\], got 0.0"),
        ({"volume_m3": -1.0}, "volume_m3 must be positive and finite, got -1.0"),
    ],
)
def test_invalid_weigh_arguments_are_refused(changes: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {
        "poses": np.tile(np.eye(4), (2, 1, 1)),
        "log_scales": np.zeros(2),
        "scan": np.zeros((5, 3)),
        "outlier_share": 0.1,
        "volume_m3": 50.0,
    }
    arguments.update(changes)
    index = make_mixture(3).index()
    with pytest.raises(ValueError, match=message):
        index.weigh(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"voxel_m": 0.0}, "voxel_m must be positive and finite, got 0.0"),
        ({"floor_density": -1.0}, "floor_density must be positive and finite, got -1.0"),
        ({"tolerance": np.nan}, "tolerance must be positive and finite, got nan"),
        ({"voxel_m": 1e-4}, "too small for a map of this extent"),
    ],
)
def test_invalid_index_settings_are_refused(settings_: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_mixture(3).index(**settings_)
