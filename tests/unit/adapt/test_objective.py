"""The objective: divergence of matched mixtures and likelihood of depth along a ray, with their gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import multivariate_normal
from torch import Tensor, nn
from torch.autograd import gradcheck

from adapt_helpers import as_tensors
from depth_helpers import ROOM, looking_around
from map_helpers import make_mixture
from monoloc.adapt.map_transform import AdaptedMap
from monoloc.adapt.objective import matched_kl, ray_log_likelihood, volume_log_likelihood
from monoloc.geometry import FloatArray, se3_exp, so3_exp, transform
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import uniform_scan
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from synthetic_room import RoomRecording

pytestmark = pytest.mark.usefixtures("one_thread")


# --- Divergence ---


def perturbed(mixture: GaussianMixture, size: float, rng: np.random.Generator) -> GaussianMixture:
    """Components moved, turned, stretched and given other weights; each still matches its original."""
    count = len(mixture)
    A = np.eye(3) + size * rng.normal(size=(count, 3, 3))
    covariances = A @ mixture.covariances @ A.swapaxes(-1, -2)
    weights = mixture.weights * np.exp(size * rng.normal(size=count))
    return GaussianMixture(
        weights / weights.sum(),
        mixture.means + 0.1 * size * rng.normal(size=(count, 3)),
        0.5 * (covariances + covariances.swapaxes(-1, -2)),
    )


@pytest.mark.parametrize("seed", range(3))
def test_kl_of_two_gaussians_is_the_closed_form(seed: int) -> None:
    a, b = make_mixture(1, seed), make_mixture(1, seed + 100)
    inverse, offset = np.linalg.inv(b.covariances[0]), b.means[0] - a.means[0]
    log_ratio = np.linalg.slogdet(b.covariances[0])[1] - np.linalg.slogdet(a.covariances[0])[1]
    expected = 0.5 * (np.trace(inverse @ a.covariances[0]) + offset @ inverse @ offset - 3.0 + log_ratio)
    assert float(matched_kl(*as_tensors(a), *as_tensors(b))) == pytest.approx(expected, rel=1e-9)


def monte_carlo_kl(a: GaussianMixture, b: GaussianMixture, rng: np.random.Generator) -> tuple[float, float]:
    """KL(a || b) and its standard error, from samples of a."""
    points = a.sample(50_000, rng)
    log_ratios = a.log_density(points) - b.log_density(points)
    return float(log_ratios.mean()), float(log_ratios.std() / np.sqrt(len(points)))


def test_kl_of_separated_mixtures_agrees_with_monte_carlo() -> None:
    rng = np.random.default_rng(0)
    packed = make_mixture(8)
    corners = 8.0 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    apart = GaussianMixture(packed.weights, corners, packed.covariances)
    other = perturbed(apart, 0.3, rng)
    assert np.abs(other.weights / apart.weights - 1.0).max() > 0.2  # mixing proportions differ
    expected, error = monte_carlo_kl(apart, other, rng)
    ours = float(matched_kl(*as_tensors(apart), *as_tensors(other)))
    assert expected > 10.0 * error
    assert ours == pytest.approx(expected, abs=4.0 * error)


@settings(max_examples=6)
@given(st.integers(0, 10_000))
def test_kl_is_an_upper_bound_of_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mixture = make_mixture(12, seed, extent_m=0.4)
    other = perturbed(mixture, 0.3, rng)
    expected, error = monte_carlo_kl(mixture, other, rng)
    assert float(matched_kl(*as_tensors(mixture), *as_tensors(other))) > expected - 4.0 * error


def test_kl_of_other_mixing_proportions_is_that_of_the_proportions() -> None:
    mixture, rng = make_mixture(6), np.random.default_rng(0)
    _, means, covariances = as_tensors(mixture)
    p, q = rng.dirichlet(np.ones(6)), rng.dirichlet(np.ones(6))
    ours = matched_kl(
        torch.from_numpy(np.log(p)), means, covariances, torch.from_numpy(np.log(q)), means, covariances
    )
    assert float(ours) == pytest.approx(float(np.sum(p * np.log(p / q))), rel=1e-9)


def test_component_without_weight_adds_no_divergence() -> None:
    """EM may leave a component without points."""
    mixture, rng = make_mixture(5), np.random.default_rng(0)
    other = perturbed(mixture, 0.2, rng)
    expected = float(matched_kl(*as_tensors(mixture), *as_tensors(other)))
    a, b = (
        (torch.cat([w, torch.tensor([-torch.inf])]), torch.cat([m, m[:1]]), torch.cat([c, c[:1]]))
        for w, m, c in (as_tensors(mixture), as_tensors(other))
    )
    moved = b[1].clone().requires_grad_(True)
    divergence = matched_kl(*a, b[0], moved, b[2])
    assert float(divergence.detach()) == pytest.approx(expected)
    divergence.backward()
    assert moved.grad is not None and bool(torch.isfinite(moved.grad).all())


def test_kl_has_the_correct_gradient() -> None:
    mixture, other = make_mixture(3), perturbed(make_mixture(3), 0.3, np.random.default_rng(0))

    def divergence(*factors: Tensor) -> Tensor:
        w, m, L, w_other, m_other, L_other = factors
        return matched_kl(w.log_softmax(0), m, L @ L.mT, w_other.log_softmax(0), m_other, L_other @ L_other.mT)

    inputs = []
    for w, m, c in (as_tensors(mixture), as_tensors(other)):
        inputs += [t.clone().requires_grad_(True) for t in (w, m, torch.linalg.cholesky(c))]
    assert gradcheck(divergence, inputs)


# --- Likelihood of depth along a ray ---


def random_rays(count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log-depth (count,), rays with z = 1 in rotated cameras and camera centres, (count, 3) each."""
    rays = np.concatenate([rng.uniform(-0.6, 0.6, (count, 2)), np.ones((count, 1))], axis=1)
    rays = np.einsum("nij,nj->ni", so3_exp(rng.normal(size=(count, 3))), rays)
    return rng.normal(0.2, 0.5, count), rays, rng.uniform(-0.5, 0.5, (count, 3))


def log_likelihood(
    log_depth: FloatArray, rays: FloatArray, origins: FloatArray, mixture: GaussianMixture, share: float = 0.1
) -> FloatArray:
    tensors = (torch.from_numpy(np.ascontiguousarray(array)) for array in (log_depth, rays, origins))
    return ray_log_likelihood(*tensors, *as_tensors(mixture), share).numpy()


def test_ray_likelihood_matches_its_definition() -> None:
    """The mixture's density from SciPy, its normaliser by quadrature; most depths are on or near a component."""
    rng = np.random.default_rng(0)
    mixture = make_mixture(8, extent_m=0.3)
    origins = rng.uniform(-0.5, 0.5, (16, 3))
    log_depth = rng.normal(0.0, 0.5, 16)
    rays = (mixture.sample(16, rng) - origins) / np.exp(log_depth + rng.normal(0.0, 0.05, 16))[:, None]
    components = [
        (w, multivariate_normal(m, c))
        for w, m, c in zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    ]

    def along(depth: float, ray: FloatArray, origin: FloatArray) -> float:
        return float(sum(w * normal.pdf(origin + depth * ray) for w, normal in components))

    expected = []
    for s, ray, origin in zip(log_depth, rays, origins, strict=True):
        crossings = np.sort(np.maximum((mixture.means - origin) @ ray / (ray @ ray), 1e-3))
        normaliser, _ = quad(along, 0.0, 20.0, args=(ray, origin), points=crossings, limit=400, epsrel=1e-7)
        expected.append(np.log(0.8 * np.exp(s) * along(np.exp(s), ray, origin) / normaliser + 0.2 / 4.0))
    assert np.median(expected) > np.log(0.2 / 4.0) + 0.5  # not only outliers are compared
    np.testing.assert_allclose(log_likelihood(log_depth, rays, origins, mixture, 0.2), expected, atol=1e-5)


@pytest.mark.parametrize("share", [0.01, 0.6])
def test_ray_likelihood_integrates_to_one_over_log_depth(share: float) -> None:
    mixture = make_mixture(15)
    _, rays, origins = random_rays(6, np.random.default_rng(1))
    grid = np.linspace(-18.0, 3.0, 10_001)
    for ray, origin in zip(rays, origins, strict=True):
        many = (np.broadcast_to(value, (len(grid), 3)) for value in (ray, origin))
        density = np.exp(log_likelihood(grid, *many, mixture, share))
        inliers = np.trapezoid(density - share / 4.0, grid)
        assert inliers == pytest.approx(1.0 - share, abs=1e-3)


@settings(max_examples=10)
@given(st.integers(0, 10_000), st.floats(1e-3, 1e3))
def test_ray_likelihood_is_invariant_to_a_common_scale_of_map_depth_and_trajectory(seed: int, factor: float) -> None:
    mixture = make_mixture(10, seed)
    shrunk = GaussianMixture(mixture.weights, factor * mixture.means, factor**2 * mixture.covariances)
    log_depth, rays, origins = random_rays(20, np.random.default_rng(seed))
    before = log_likelihood(log_depth, rays, origins, mixture)
    after = log_likelihood(log_depth + np.log(factor), rays, factor * origins, shrunk)
    np.testing.assert_allclose(after, before, atol=1e-7)


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_ray_likelihood_does_not_depend_on_the_world_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mixture = make_mixture(10, seed)
    R, t = so3_exp(rng.normal(size=3)), rng.normal(size=3)
    turned = R @ mixture.covariances @ R.T
    moved = GaussianMixture(mixture.weights, mixture.means @ R.T + t, 0.5 * (turned + turned.swapaxes(-1, -2)))
    log_depth, rays, origins = random_rays(20, rng)
    np.testing.assert_allclose(
        log_likelihood(log_depth, rays @ R.T, origins @ R.T + t, moved),
        log_likelihood(log_depth, rays, origins, mixture),
        atol=1e-7,
    )


def test_rays_that_miss_the_map_have_finite_likelihood_and_gradient() -> None:
    mixture = make_mixture(5, extent_m=0.1)
    log_depth = torch.tensor([-12.0, 0.0, 6.0], dtype=torch.float64, requires_grad=True)
    rays = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1.0, 1.0]], dtype=torch.float64)
    origins = torch.tensor([[0.0, 0.0, 50.0]], dtype=torch.float64).expand(3, 3)
    value = ray_log_likelihood(log_depth, rays, origins, *as_tensors(mixture), 0.1)
    value.sum().backward()
    assert bool(torch.isfinite(value).all())
    assert log_depth.grad is not None and bool(torch.isfinite(log_depth.grad).all())


def test_ray_likelihood_has_the_correct_gradient() -> None:
    w, m, c = as_tensors(make_mixture(4))
    log_depth, rays, origins = map(torch.from_numpy, random_rays(5, np.random.default_rng(3)))
    inputs = [t.clone().requires_grad_(True) for t in (log_depth, rays, origins, w, m, torch.linalg.cholesky(c))]

    def likelihood(*parts: Tensor) -> Tensor:
        s, r, o, weights, means, L = parts
        return ray_log_likelihood(s, r, o, weights.log_softmax(0), means, L @ L.mT, 0.2)

    assert gradcheck(likelihood, inputs)


def test_plain_density_rewards_collapse_and_ray_likelihood_does_not() -> None:
    """The map shrunk a hundredfold onto the one place it was seen from: nothing has been learnt about depth."""
    rng = np.random.default_rng(0)
    cloud = ROOM.cloud(0.2)
    mixture = fit_mixture(cloud, 40, rng).mixture
    factor = 0.01
    collapsed = GaussianMixture(mixture.weights, factor * mixture.means, factor**2 * mixture.covariances)
    poses = looking_around(6)
    poses[:, :3, 3] = 0.0
    recording = RoomRecording(ROOM, poses)
    camera_rays = recording.camera.pixel_rays()[::16, ::16].reshape(-1, 3)
    rays = torch.from_numpy(np.concatenate([camera_rays @ pose[:3, :3].T for pose in poses]))
    depth = np.concatenate([recording.depth(index)[::16, ::16].ravel() for index in range(6)])
    depth_m, origins = torch.from_numpy(depth).double(), torch.zeros_like(rays)
    plain, by_ray = (
        [
            float(values.mean())
            for size, seen in ((1.0, as_tensors(mixture)), (factor, as_tensors(collapsed)))
            for values in [likelihood(size * depth_m, seen)]
        ]
        for likelihood in (
            lambda d, seen: volume_log_likelihood(d[:, None] * rays, *seen, 0.1, 30.0),
            lambda d, seen: ray_log_likelihood(d.log(), rays, origins, *seen, 0.1),
        )
    )
    assert plain[1] > plain[0] + 5.0
    assert by_ray[1] == pytest.approx(by_ray[0], abs=1e-9)


def test_volume_likelihood_is_the_one_that_the_filter_weighs_with() -> None:
    """Of points at a pose, under the smoothed map."""
    rng = np.random.default_rng(0)
    mixture, pose = make_mixture(8, extent_m=0.3), se3_exp(rng.normal(0.0, 0.3, 6))
    config = LikelihoodConfig(kind="volume", noise_sd_m=0.05, outlier_share=0.1)
    scan = uniform_scan(mixture.sample(40, rng).astype(np.float32))
    weighed = VolumeLikelihood(mixture, config).mean_log_likelihood(pose[None], np.zeros(1), scan)
    smoothed = mixture.smoothed(config.noise_sd_m)
    points = torch.from_numpy(transform(pose, scan.points.astype(np.float64)))
    values = volume_log_likelihood(points, *as_tensors(smoothed), config.outlier_share, smoothed.volume_m3)
    assert float(values.mean()) == pytest.approx(float(weighed[0]), abs=0.02)  # the filter's voxels round


def test_volume_likelihood_has_the_correct_gradient() -> None:
    w, m, c = as_tensors(make_mixture(4))
    points = torch.from_numpy(np.random.default_rng(2).normal(size=(5, 3)))
    inputs = [t.clone().requires_grad_(True) for t in (points, m, torch.linalg.cholesky(c))]
    assert gradcheck(lambda x, means, L: volume_log_likelihood(x, w, means, L @ L.mT, 0.2, 30.0), inputs)


# --- Both together ---


def test_objective_has_the_correct_gradient_for_last_layer_and_map_transform() -> None:
    """In float64, from features to ``-log p + lambda KL``."""
    rng = np.random.default_rng(0)
    cloud = ROOM.cloud(0.6)[::3]
    mixture = fit_mixture(cloud, 4, rng).mixture
    adapted = AdaptedMap(mixture, cloud).double()
    nn.init.normal_(adapted.transform.output.weight, 0.0, 0.05, generator=torch.Generator().manual_seed(0))
    head = nn.Conv2d(3, 1, 3, padding=1).double()
    features = torch.from_numpy(rng.normal(size=(1, 3, 2, 3)))
    rays = torch.from_numpy(np.column_stack([rng.uniform(-0.5, 0.5, (6, 2)), np.ones(6)]))
    origins = torch.zeros(6, 3, dtype=torch.float64)
    theta_D = dict(head.named_parameters())
    theta_M = {f"transform.{name}": value for name, value in adapted.transform.named_parameters()}
    assert len(theta_M) == 4 and len(theta_D) == 2

    def objective(*values: Tensor) -> Tensor:
        given = dict(zip([*theta_D, *theta_M], values, strict=True))
        log_depth = torch.func.functional_call(head, {n: given[n] for n in theta_D}, (features,)).ravel()
        means, covariances = torch.func.functional_call(adapted, {n: given[n] for n in theta_M}, ())
        fit = ray_log_likelihood(log_depth, rays, origins, adapted.log_weights, means, covariances, 0.1).mean()
        kl = matched_kl(
            adapted.log_weights, adapted.means, adapted.covariances, adapted.log_weights, means, covariances
        )
        return -fit + 0.1 * kl

    values = [v.detach().clone().requires_grad_(True) for v in (*theta_D.values(), *theta_M.values())]
    objective(*values).backward()
    for name, value in zip([*theta_D, *theta_M], values, strict=True):
        assert value.grad is not None and bool((value.grad != 0.0).any()), name
    assert gradcheck(objective, values, fast_mode=True)
