"""A mixture along rays: the native kernel against its NumPy twin, and properties of its density of depth."""

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

NO_OUTLIERS = 1e-30  # an outlier share of practically nothing: the rest is the density of the map


def random_particles(
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


@settings(max_examples=40, deadline=None)
@given(
    spread_is_wide=st.booleans(),
    components=st.integers(1, 60),
    particles=st.integers(1, 32),
    points=st.integers(0, 30),
    is_weighted=st.booleans(),
    log_depth_sd=st.floats(0.01, 0.3),
    outlier_share=st.floats(0.05, 1.0),
    seed=st.integers(0, 10_000),
)
def test_weigh_equals_twin(
    spread_is_wide: bool,
    components: int,
    particles: int,
    points: int,
    is_weighted: bool,
    log_depth_sd: float,
    outlier_share: float,
    seed: int,
) -> None:
    """Up to 32 particles, all of which take part in the choice of components, whether they share it or not."""
    rng = np.random.default_rng(seed)
    mixture = make_mixture(components, seed)
    poses, log_scales = random_particles(particles, rng, *((1.0, 2.0) if spread_is_wide else (0.1, 0.05)))
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
    poses, log_scales = random_particles(150, rng, 1.0, 2.0)
    scan = random_scan(40, rng)
    noise = {"log_depth_sd": 0.06, "outlier_share": 0.3}
    native = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    np.testing.assert_allclose(native, twin(mixture, poses, log_scales, scan, **noise), atol=1e-4 * len(scan))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_concentrated_particles_equal_the_twin(seed: int) -> None:
    """500 particles within some centimetres share the components that 32 of them chose."""
    rng = np.random.default_rng(seed)
    thin = make_mixture(200, seed)
    mixture = GaussianMixture(thin.weights, thin.means, thin.covariances + 0.02**2 * np.eye(3))
    poses = random_particles(1, rng, 0.0, 0.0)[0][0] @ se3_exp(rng.normal(size=(500, 6)) * np.repeat([0.02, 0.01], 3))
    log_scales, scan = rng.normal(0.0, 0.03, 500), random_scan(40, rng)
    noise = {"log_depth_sd": 0.06, "outlier_share": 0.3}
    native = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    expected = twin(mixture, poses, log_scales, scan, **noise)
    # A particle may lack a component that only it would see; that costs it little, and few particles.
    np.testing.assert_allclose(native, expected, atol=1e-3 * len(scan))
    assert np.median(np.abs(native - expected)) < 1e-5 * len(scan)


@pytest.mark.parametrize(("spread_m", "spread_rad"), [(0.02, 0.01), (0.5, 0.2)])
def test_particles_among_many_rooms_equal_the_twin(spread_m: float, spread_rad: float) -> None:
    """Whether they share their components or not; most of the components are in other rooms or out of view."""
    rng = np.random.default_rng(0)
    room = make_mixture(60)
    offsets = np.stack(np.meshgrid(*[(-5.0, 0.0, 5.0)] * 3), axis=-1).reshape(-1, 3)
    means = (room.means + offsets[:, None]).reshape(-1, 3)
    covariances = np.tile(room.covariances + 0.02**2 * np.eye(3), (len(offsets), 1, 1))
    building = GaussianMixture(np.tile(room.weights, len(offsets)) / len(offsets), means, covariances)
    poses, log_scales = random_particles(32, rng, spread_m, spread_rad)
    scan, noise = random_scan(60, rng), {"log_depth_sd": 0.06, "outlier_share": 0.3}
    native = building.along_rays().weigh(poses, log_scales, scan, **noise)
    np.testing.assert_allclose(native, twin(building, poses, log_scales, scan, **noise), atol=1e-4 * len(scan))


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


def combined(share: float, mixture: GaussianMixture, other: GaussianMixture) -> GaussianMixture:
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
    log_density = mixture.along_rays().weigh(
        poses, scales, axis, log_depth_sd=log_depth_sd, outlier_share=NO_OUTLIERS
    )
    return np.asarray(np.exp(log_density))


@pytest.mark.parametrize("log_depth_sd", [0.02, 0.06, 0.15])
@pytest.mark.parametrize("seed", range(3))
def test_density_of_log_depth_integrates_to_one(log_depth_sd: float, seed: int) -> None:
    in_front = make_mixture(30, seed)
    mixture = GaussianMixture(in_front.weights, in_front.means + np.array([0.0, 0.0, 4.0]), in_front.covariances)
    density = density_of_log_depth(mixture, DEPTHS_M, log_depth_sd)
    assert np.trapezoid(density, np.log(DEPTHS_M)) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("depth_m", [0.5, 2.0, 5.0])
def test_depth_of_a_wall_has_the_stated_relative_error(depth_m: float) -> None:
    """Nearly normal with the standard deviation asked for; its mean is the wall's depth."""
    density = density_of_log_depth(wall(depth_m, sd_m=1e-4), DEPTHS_M, 0.1)
    share = density * np.gradient(np.log(DEPTHS_M))
    mean = np.sum(share * DEPTHS_M)
    assert mean == pytest.approx(depth_m, rel=1e-3)
    assert np.sqrt(np.sum(share * (DEPTHS_M - mean) ** 2)) == pytest.approx(0.1 * depth_m, rel=0.01)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0, 75.0])
def test_likelihood_does_not_depend_on_slant_or_density_of_the_map(tilt_deg: float) -> None:
    """A wall's depth is as likely at any slant and at any density of the map there."""
    depths = 2.0 * np.exp(np.linspace(-0.15, 0.15, 31))
    head_on = density_of_log_depth(wall(2.0), depths, 0.06)
    slanting = density_of_log_depth(wall(2.0, np.deg2rad(tilt_deg)), depths, 0.06)
    np.testing.assert_allclose(slanting, head_on, rtol=0.02)
    # A hundredth of the mass: the rest lies elsewhere, behind the camera.
    sparse = density_of_log_depth(combined(0.01, wall(2.0, np.deg2rad(tilt_deg)), wall(-2.0)), depths, 0.06)
    np.testing.assert_allclose(sparse, slanting, rtol=1e-4)


def test_density_of_two_walls_is_proportional_to_their_mass_on_the_ray() -> None:
    at_near, at_far = density_of_log_depth(combined(0.25, wall(1.0), wall(3.0)), np.array([1.0, 3.0]), 0.05)
    assert at_far / at_near == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("factor", [0.4, 1.8])
def test_likelihood_does_not_depend_on_the_unit_of_length(factor: float) -> None:
    """Map, poses and depth all scaled: depth's error is relative, and the map's own grows with it."""
    rng = np.random.default_rng(0)
    mixture = make_mixture(60, extent_m=1.0)
    larger = GaussianMixture(mixture.weights, mixture.means * factor, mixture.covariances * factor**2)
    poses, log_scales = random_particles(30, rng, 0.1, 0.05)
    scan = random_scan(30, rng)
    # All of the map before the camera and within reach: the limits of 5 cm and 12 m are not scaled.
    poses[:, :3, 3] -= 3.5 * poses[:, :3, 2]
    scaled = poses.copy()
    scaled[:, :3, 3] *= factor
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    for depth, scales in ((factor * scan, log_scales), (scan, log_scales + np.log(factor))):
        result = larger.along_rays().weigh(scaled, scales, depth, **noise)
        np.testing.assert_allclose(result, expected, atol=1e-3 * len(scan))


def test_likelihood_does_not_depend_on_the_world_frame() -> None:
    rng = np.random.default_rng(0)
    mixture, (poses, log_scales), scan = make_mixture(60), random_particles(40, rng, 0.1, 0.05), random_scan(30, rng)
    T = se3_exp(np.array([300.0, -200.0, 20.0, 0.4, -1.0, 0.7]))
    R = T[:3, :3]
    moved = GaussianMixture(mixture.weights, mixture.means @ R.T + T[:3, 3], R @ mixture.covariances @ R.T)
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = mixture.along_rays().weigh(poses, log_scales, scan, **noise)
    result = moved.along_rays().weigh(T @ poses, log_scales, scan, **noise)
    np.testing.assert_allclose(result, expected, atol=1e-3 * len(scan))


# --- Weights, and what is out of reach ---


def test_points_are_weighted() -> None:
    rng = np.random.default_rng(0)
    rays, (poses, log_scales), scan = (
        make_mixture(40).along_rays(),
        random_particles(20, rng, 0.1, 0.05),
        random_scan(12, rng),
    )
    weights = rng.uniform(0.0, 3.0, 12)
    weights[3] = 0.0
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    single = np.stack([rays.weigh(poses, log_scales, scan[p : p + 1], **noise) for p in range(12)])
    weighed = rays.weigh(poses, log_scales, scan, point_weights=weights, **noise)
    np.testing.assert_allclose(weighed, weights @ single, atol=1e-4)
    np.testing.assert_allclose(rays.weigh(poses, log_scales, scan, **noise), single.sum(axis=0), atol=1e-4)


def test_components_of_weight_zero_are_ignored() -> None:
    rng = np.random.default_rng(0)
    mixture, (poses, log_scales), scan = make_mixture(40), random_particles(20, rng, 0.1, 0.05), random_scan(12, rng)
    weights = np.where(np.arange(40) % 3 == 0, 0.0, mixture.weights)
    weights /= weights.sum()
    with_zeros = GaussianMixture(weights, mixture.means, mixture.covariances)
    positive = weights > 0.0
    without = GaussianMixture(weights[positive], mixture.means[positive], mixture.covariances[positive])
    noise = {"log_depth_sd": 0.05, "outlier_share": 0.3}
    expected = without.along_rays().weigh(poses, log_scales, scan, **noise)
    np.testing.assert_array_equal(with_zeros.along_rays().weigh(poses, log_scales, scan, **noise), expected)
    np.testing.assert_allclose(twin(with_zeros, poses, log_scales, scan, **noise), expected, atol=0.02)


@pytest.mark.parametrize("place", [[0.0, 0.0, -2.0], [0.0, 0.0, 0.04], [0.0, 0.0, 40.0]])
def test_components_behind_the_camera_or_out_of_reach_leave_only_outliers(place: list[float]) -> None:
    blob = GaussianMixture(np.ones(1), np.array([place]), 1e-4 * np.eye(3)[None])
    scan = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 1.0]])
    result = blob.along_rays().weigh(np.eye(4)[None], np.zeros(1), scan, log_depth_sd=0.05, outlier_share=0.2)
    assert result[0] == pytest.approx(2.0 * np.log(0.2 / LOG_DEPTH_RANGE), abs=1e-5)


def test_no_particles_and_no_points() -> None:
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
        ({"log_depth_sd": -0.1}, "log_depth_sd must be finite and not negative, got -0.1"),
        ({"log_depth_sd": np.inf}, "log_depth_sd must be finite and not negative, got inf"),
        ({"poses": np.eye(4)}, r"poses must have shape \(N, 4, 4\), got \(4, 4\)"),
        ({"log_scales": np.zeros(3)}, r"log_scales must have shape \(2,\), got \(3,\)"),
        ({"scan": np.ones((4, 2))}, r"scan must have shape \(N, 3\), got \(4, 2\)"),
        ({"scan": np.array([[0.1, 0.2, 1.0], [0.1, 0.2, -1.0]])}, "scan must lie before the camera: z > 0"),
        ({"scan": np.zeros((1, 3))}, "scan must lie before the camera: z > 0"),
        ({"point_weights": np.ones(3)}, r"point_weights must have shape \(4,\), got \(3,\)"),
    ],
)
def test_invalid_arguments_are_refused(changed: dict[str, Any], message: str) -> None:
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
