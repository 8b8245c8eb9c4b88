"""A mixture along rays: the native kernel against its NumPy twin, and what its density of depth must obey."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_helpers import make_mixture
from monoloc.geometry import FloatArray, se3_exp, so3_exp
from monoloc.map.mixture import GaussianMixture
from monoloc.map.numpy_twins import weigh_rays
from monoloc.map.rays import LOG_DEPTH_RANGE

NOWHERE = 1e-30  # an outlier share of as good as nothing, so that what is left is the density of the map


def cloud_of(
    count: int, rng: np.random.Generator, spread_m: float, spread_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Poses (count, 4, 4) about one anywhere in the room, and log-scales (count,)."""
    centre = se3_exp(np.concatenate([rng.uniform(-0.5, 0.5, 3), rng.normal(0.0, 1.0, 3)]))
    twists = rng.uniform(-1.0, 1.0, (count, 6)) * np.repeat([spread_m, spread_rad], 3)
    return centre @ se3_exp(twists), rng.normal(0.0, 0.1, count)


def random_scan(count: int, rng: np.random.Generator) -> FloatArray:
    """Points of an image of 80 by 60 degrees, 30 cm to 4 m before the camera; exact in single precision."""
    z = rng.uniform(0.3, 4.0, count)
    scan = np.column_stack([z * rng.uniform(-0.84, 0.84, count), z * rng.uniform(-0.58, 0.58, count), z])
    return scan.astype(np.float32).astype(np.float64)


def twin(
    mixture: GaussianMixture,
    poses: FloatArray,
    log_scales: FloatArray,
    scan: FloatArray,
    *,
    log_depth_sd: float,
    outlier_share: float,
    point_weights: FloatArray | None = None,
) -> FloatArray:
    parts = mixture.weights, mixture.means, mixture.covariances
    with np.errstate(divide="ignore"):  # a component of weight 0
        return weigh_rays(
            poses, log_scales, scan, point_weights, *parts, log_depth_sd, outlier_share, LOG_DEPTH_RANGE
        )


# --- The native kernel is its twin ---


@settings(max_examples=60, deadline=None)
@given(
    position_is_unknown=st.booleans(),
    components=st.integers(1, 60),
    particles=st.integers(1, 32),
    points=st.integers(0, 30),
    is_weighted=st.booleans(),
    log_depth_sd=st.floats(0.01, 0.3),
    outlier_share=st.floats(0.05, 1.0),
    seed=st.integers(0, 10_000),
)
def test_weigh_equals_twin(
    position_is_unknown: bool,
    components: int,
    particles: int,
    points: int,
    is_weighted: bool,
    log_depth_sd: float,
    outlier_share: float,
    seed: int,
) -> None:
    """Up to 32 particles, which all have a say in the choice of components, whether they share it or not."""
    rng = np.random.default_rng(seed)
    mixture = make_mixture(components, seed)
    poses, log_scales = cloud_of(particles, rng, *((1.0, 2.0) if position_is_unknown else (0.1, 0.05)))
    scan = random_scan(points, rng)
    noise: dict[str, Any] = {"log_depth_sd": log_depth_sd, "outlier_share": outlier_share}
    if is_weighted:
        noise["point_weights"] = rng.uniform(0.0, 2.0, points).astype(np.float32).astype(np.float64)
    native = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    assert native.shape == (particles,) and native.dtype == np.float64
    # Single precision, and what 1e-5 of the mass may hold. Over 8,000 single points drawn like this the error is 2e-5
    # in the median and 4e-3 at worst, where a ray grazes a component far away.
    np.testing.assert_allclose(native, twin(mixture, poses, log_scales, scan, **noise), atol=1e-3 * points + 1e-2)


@pytest.mark.parametrize("seed", range(3))
def test_many_wide_particles_equal_the_twin(seed: int) -> None:
    """Several batches, the last one not full; each chooses its components."""
    rng = np.random.default_rng(seed)
    mixture = make_mixture(80, seed)
    poses, log_scales = cloud_of(150, rng, 1.0, 2.0)
    scan = random_scan(40, rng)
    noise = {"log_depth_sd": 0.06, "outlier_share": 0.3}
    native = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    np.testing.assert_allclose(native, twin(mixture, poses, log_scales, scan, **noise), atol=1e-4 * len(scan))


@pytest.mark.parametrize("seed", range(3))
def test_a_belief_as_a_filter_has_it_equals_the_twin(seed: int) -> None:
    """500 particles within some centimetres share the components that 32 of them chose."""
    rng = np.random.default_rng(seed)
    thin = make_mixture(200, seed)
    mixture = GaussianMixture(thin.weights, thin.means, thin.covariances + 0.02**2 * np.eye(3))
    poses = cloud_of(1, rng, 0.0, 0.0)[0][0] @ se3_exp(rng.normal(size=(500, 6)) * np.repeat([0.02, 0.01], 3))
    log_scales, scan = rng.normal(0.0, 0.03, 500), random_scan(40, rng)
    noise = {"log_depth_sd": 0.06, "outlier_share": 0.3}
    native = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    expected = twin(mixture, poses, log_scales, scan, **noise)
    # A particle may lack a component that only it would see; that costs it little, and few particles.
    np.testing.assert_allclose(native, expected, atol=1e-3 * len(scan))
    assert np.median(np.abs(native - expected)) < 1e-5 * len(scan)


@pytest.mark.parametrize("spread", [(0.05, 0.02), (1.0, 2.0)])
def test_threads_change_nothing(spread: tuple[float, float]) -> None:
    rng = np.random.default_rng(0)
    rays = make_mixture(60).along_rays()
    poses, log_scales = cloud_of(500, rng, *spread)
    scan = random_scan(30, rng)

    def weighed(threads: int) -> FloatArray:
        return rays.weigh(poses, log_scales, scan, log_depth_sd=0.06, outlier_share=0.3, threads=threads)

    alone = weighed(1)
    for threads in (2, 3, 8):
        np.testing.assert_array_equal(weighed(threads), alone)


# --- The density of depth ---

DEPTHS_M = np.exp(np.linspace(np.log(0.02), np.log(50.0), 4001))


def wall(depth_m: float, tilt_rad: float = 0.0, sd_m: float = 1e-3) -> GaussianMixture:
    """A plane of many equal pieces through (0, 0, depth) that the optical axis meets at a slant of ``tilt_rad``."""
    turn = so3_exp([0.0, tilt_rad, 0.0])
    grid = np.stack(np.meshgrid(np.linspace(-6.0, 6.0, 41), np.linspace(-1.5, 1.5, 11)), axis=-1).reshape(-1, 2)
    means = np.column_stack([grid, np.zeros(len(grid))]) @ turn.T + np.array([0.0, 0.0, depth_m])
    covariance = turn @ np.diag(np.square([0.3, 0.3, sd_m])) @ turn.T
    weights = np.full(len(grid), 1.0 / len(grid))
    return GaussianMixture(weights, means, np.repeat(covariance[None], len(grid), axis=0))


def together(share: float, mixture: GaussianMixture, other: GaussianMixture) -> GaussianMixture:
    """Both in one, the first with so much of the mass."""
    return GaussianMixture(
        np.concatenate([share * mixture.weights, (1.0 - share) * other.weights]),
        np.concatenate([mixture.means, other.means]),
        np.concatenate([mixture.covariances, other.covariances]),
    )


def density_of_log_depth(mixture: GaussianMixture, depths_m: FloatArray, log_depth_sd: float) -> FloatArray:
    """At depths (D,) on the optical axis of a camera at the origin: each one particle's scale of a single point."""
    poses = np.repeat(np.eye(4)[None], len(depths_m), axis=0)
    axis = np.array([[0.0, 0.0, 1.0]])
    scales = np.log(depths_m)
    log_density = mixture.along_rays().weigh(poses, scales, axis, log_depth_sd=log_depth_sd, outlier_share=NOWHERE)
    return np.asarray(np.exp(log_density))


@pytest.mark.parametrize("log_depth_sd", [0.02, 0.06, 0.15])
@pytest.mark.parametrize("seed", range(3))
def test_density_of_log_depth_integrates_to_one(log_depth_sd: float, seed: int) -> None:
    in_front = make_mixture(30, seed)
    mixture = GaussianMixture(in_front.weights, in_front.means + np.array([0.0, 0.0, 4.0]), in_front.covariances)
    density = density_of_log_depth(mixture, DEPTHS_M, log_depth_sd)
    assert np.trapezoid(density, np.log(DEPTHS_M)) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("depth_m", [0.5, 2.0, 5.0])
def test_depth_of_a_wall_is_spread_by_its_share(depth_m: float) -> None:
    """Nearly normal with the standard deviation asked for; its mean is the wall's depth."""
    density = density_of_log_depth(wall(depth_m, sd_m=1e-4), DEPTHS_M, 0.1)
    share = density * np.gradient(np.log(DEPTHS_M))
    mean = np.sum(share * DEPTHS_M)
    assert mean == pytest.approx(depth_m, rel=1e-3)
    assert np.sqrt(np.sum(share * (DEPTHS_M - mean) ** 2)) == pytest.approx(0.1 * depth_m, rel=0.01)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0, 75.0])
def test_grazing_views_and_dense_places_attract_nothing(tilt_deg: float) -> None:
    """The likelihood of what is seen at a wall is the same at any slant and at any density of the map there."""
    depths = 2.0 * np.exp(np.linspace(-0.15, 0.15, 31))
    head_on = density_of_log_depth(wall(2.0), depths, 0.06)
    slanting = density_of_log_depth(wall(2.0, np.deg2rad(tilt_deg)), depths, 0.06)
    np.testing.assert_allclose(slanting, head_on, rtol=0.02)
    # A hundredth of the mass: the rest lies elsewhere, behind the camera.
    sparse = density_of_log_depth(together(0.01, wall(2.0, np.deg2rad(tilt_deg)), wall(-2.0)), depths, 0.06)
    np.testing.assert_allclose(sparse, slanting, rtol=1e-4)


def test_of_two_walls_the_one_with_more_mass_on_the_ray_is_likelier() -> None:
    at_near, at_far = density_of_log_depth(together(0.25, wall(1.0), wall(3.0)), np.array([1.0, 3.0]), 0.05)
    assert at_far / at_near == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("factor", [0.4, 1.8])
def test_only_ratios_of_lengths_matter(factor: float) -> None:
    """Map, places and depth all larger: the same, for depth's error is a share and the map's own grows along."""
    rng = np.random.default_rng(0)
    mixture = make_mixture(60, extent_m=1.0)
    larger = GaussianMixture(mixture.weights, mixture.means * factor, mixture.covariances * factor**2)
    poses, log_scales = cloud_of(30, rng, 0.1, 0.05)
    scan = random_scan(30, rng)
    # All of the map before the camera and within reach: 5 cm and 12 m do not grow along.
    poses[:, :3, 3] -= 3.5 * poses[:, :3, 2]
    scaled = poses.copy()
    scaled[:, :3, 3] *= factor
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    for depth, scales in ((factor * scan, log_scales), (scan, log_scales + np.log(factor))):
        result = larger.along_rays().weigh(scaled, scales, depth, **noise)
        np.testing.assert_allclose(result, expected, atol=1e-3 * len(scan))


def test_the_world_may_be_moved() -> None:
    rng = np.random.default_rng(0)
    mixture, (poses, log_scales), scan = make_mixture(60), cloud_of(40, rng, 0.1, 0.05), random_scan(30, rng)
    T = se3_exp(np.array([300.0, -200.0, 20.0, 0.4, -1.0, 0.7]))
    R = T[:3, :3]
    moved = GaussianMixture(mixture.weights, mixture.means @ R.T + T[:3, 3], R @ mixture.covariances @ R.T)
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    result = moved.along_rays().weigh(T @ poses, log_scales, scan, **noise)
    np.testing.assert_allclose(result, expected, atol=1e-3 * len(scan))


# --- What counts, and what does not ---


def test_points_count_by_their_weight() -> None:
    rng = np.random.default_rng(0)
    rays, (poses, log_scales), scan = (
        make_mixture(40).along_rays(),
        cloud_of(20, rng, 0.1, 0.05),
        random_scan(12, rng),
    )
    weights = rng.uniform(0.0, 3.0, 12)
    weights[3] = 0.0
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    single = np.stack([rays.weigh(poses, log_scales, scan[p : p + 1], **noise) for p in range(12)])
    weighed = rays.weigh(poses, log_scales, scan, point_weights=weights, **noise)
    np.testing.assert_allclose(weighed, weights @ single, atol=1e-4)
    np.testing.assert_allclose(rays.weigh(poses, log_scales, scan, **noise), single.sum(axis=0), atol=1e-4)


def test_components_of_weight_zero_are_not_there() -> None:
    rng = np.random.default_rng(0)
    mixture, (poses, log_scales), scan = make_mixture(40), cloud_of(20, rng, 0.1, 0.05), random_scan(12, rng)
    weights = np.where(np.arange(40) % 3 == 0, 0.0, mixture.weights)
    weights /= weights.sum()
    some = GaussianMixture(weights, mixture.means, mixture.covariances)
    there = weights > 0.0
    kept = GaussianMixture(weights[there], mixture.means[there], mixture.covariances[there])
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = kept.along_rays().weigh(poses, log_scales, scan, **noise)
    np.testing.assert_array_equal(some.along_rays().weigh(poses, log_scales, scan, **noise), expected)
    np.testing.assert_allclose(twin(some, poses, log_scales, scan, **noise), expected, atol=0.02)


@pytest.mark.parametrize("place", [[0.0, 0.0, -2.0], [0.0, 0.0, 0.04], [0.0, 0.0, 40.0]])
def test_what_lies_behind_the_camera_or_out_of_reach_leaves_only_outliers(place: list[float]) -> None:
    blob = GaussianMixture(np.ones(1), np.array([place]), 1e-4 * np.eye(3)[None])
    scan = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 1.0]])
    result = blob.along_rays().weigh(np.eye(4)[None], np.zeros(1), scan, log_depth_sd=0.05, outlier_share=0.2)
    assert result[0] == pytest.approx(2.0 * np.log(0.2 / LOG_DEPTH_RANGE), abs=1e-5)


def test_nothing_to_weigh() -> None:
    rays = make_mixture(5).along_rays()
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.2}
    assert rays.weigh(np.zeros((0, 4, 4)), np.zeros(0), random_scan(3, np.random.default_rng(0)), **noise).shape == (
        0,
    )
    nothing = rays.weigh(np.repeat(np.eye(4)[None], 3, axis=0), np.zeros(3), np.zeros((0, 3)), **noise)
    np.testing.assert_array_equal(nothing, np.zeros(3))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"outlier_share": 0.0}, r"outlier_share must be in \(0, 1\], got 0.0"),
        ({"outlier_share": 1.1}, r"outlier_share must be in \(0, 1\], got 1.1"),
        ({"outlier_share": np.nan}, "outlier_share must be in"),
        ({"log_depth_sd": -0.1}, "log_depth_sd must be finite and not negative, got -0.1"),
        ({"log_depth_sd": np.inf}, "log_depth_sd must be finite and not negative, got inf"),
        ({"threads": 0}, "threads must be 1 to 256, got 0"),
        ({"poses": np.eye(4)}, r"poses must have shape \(N, 4, 4\), got \(4, 4\)"),
        ({"poses": np.full((2, 4, 4), np.nan)}, "poses must be finite"),
        ({"log_scales": np.zeros(3)}, r"log_scales must have shape \(2,\), got \(3,\)"),
        ({"scan": np.ones((4, 2))}, r"scan must have shape \(N, 3\), got \(4, 2\)"),
        ({"scan": np.array([[0.1, 0.2, 1.0], [0.1, 0.2, -1.0]])}, "scan must lie before the camera: z > 0"),
        ({"scan": np.zeros((1, 3))}, "scan must lie before the camera: z > 0"),
        ({"point_weights": np.ones(3)}, r"point_weights must have shape \(4,\), got \(3,\)"),
        ({"point_weights": np.full(4, np.inf)}, "point_weights must be finite"),
    ],
)
def test_bad_arguments_are_refused(changed: dict[str, Any], message: str) -> None:
    arguments: dict[str, Any] = {
        "poses": np.repeat(np.eye(4)[None], 2, axis=0),
        "log_scales": np.zeros(2),
        "scan": np.ones((4, 3)),
        "log_depth_sd": 0.05,
        "outlier_share": 0.3,
    } | changed
    poses, log_scales, scan = (arguments.pop(name) for name in ("poses", "log_scales", "scan"))
    with pytest.raises(ValueError, match=message):
        make_mixture(3).along_rays().weigh(poses, log_scales, scan, **arguments)
