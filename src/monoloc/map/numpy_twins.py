"""NumPy twins of the native kernels: readable reference implementations for tests and benchmarks.

They are dense and slow by design. Tests check that ``monoloc._core`` gives the same results. :func:`log_terms` and
:func:`log_sum_exp` also serve code that is not performance-critical.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from monoloc.geometry import FloatArray, transform


class Statistics(NamedTuple):
    """Sufficient statistics of the M-step, with offsets ``d_nk = x_n - mu_k`` from the current means.

    Attributes:
        mass: ``sum_n r_nk``, (K,).
        first: ``sum_n r_nk d_nk``, (K, 3).
        second: ``sum_n r_nk d_nk d_nk^T``, (K, 3, 3).
        log_likelihood: ``sum_n log p(x_n)``, nats.
    """

    mass: FloatArray
    first: FloatArray
    second: FloatArray
    log_likelihood: float


def log_terms(points: FloatArray, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> FloatArray:
    """``log(pi_k N(x_p; mu_k, Sigma_k))``: (P, 3) -> (P, K), nats."""
    lower = np.linalg.cholesky(covariances)
    # Looping over components is ten times as fast as one (P, K, 3) array.
    whitened = ((points - mean) @ inverse.T for mean, inverse in zip(means, np.linalg.inv(lower), strict=True))
    squared_distances = np.stack([(z**2).sum(axis=-1) for z in whitened], axis=-1)
    log_determinant = 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
    log_normaliser = -0.5 * (3.0 * np.log(2.0 * np.pi) + log_determinant)
    with np.errstate(divide="ignore"):  # component of weight 0
        return np.asarray(np.log(weights) + log_normaliser - 0.5 * squared_distances)


def log_sum_exp(terms: FloatArray) -> FloatArray:
    """``log(sum_k exp(terms_k))`` over the last axis, without overflow."""
    largest = terms.max(axis=-1)
    return np.asarray(largest + np.log(np.exp(terms - largest[..., None]).sum(axis=-1)))


def log_density(points: FloatArray, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> FloatArray:
    """``log sum_k pi_k N(x_p; mu_k, Sigma_k)``: (P, 3) -> (P,), nats."""
    return log_sum_exp(log_terms(points, weights, means, covariances))


def weigh(
    poses: FloatArray,
    log_scales: FloatArray,
    scan: FloatArray,
    point_weights: FloatArray | None,
    weights: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    outlier_share: float,
    volume_m3: float,
) -> FloatArray:
    """``sum_p w_p log((1 - eps) M(T_n e^{s_n} x_p) + eps / V)``: (N, 4, 4), (N,), (P, 3) -> (N,), nats."""
    w = np.ones(len(scan)) if point_weights is None else point_weights
    result = np.empty(len(poses))
    for n, (T_world_camera, s) in enumerate(zip(poses, log_scales, strict=True)):
        points_world = transform(T_world_camera, np.exp(s) * scan)
        density = np.exp(log_density(points_world, weights, means, covariances))
        result[n] = w @ np.log((1.0 - outlier_share) * density + outlier_share / volume_m3)
    return result


def weigh_rays(
    poses: FloatArray,
    log_scales: FloatArray,
    scan: FloatArray,
    point_weights: FloatArray | None,
    weights: FloatArray,
    means: FloatArray,
    covariances: FloatArray,
    log_depth_sd: float,
    outlier_share: float,
    log_depth_range: float,
    nearest_m: float = 0.05,
) -> FloatArray:
    """``sum_p w_p log((1 - eps) d p(d | o, r) + eps / range)``: (N, 4, 4), (N,), (P, 3) -> (N,), nats.

    Point p has depth ``d = e^s z_p`` on the ray ``o + d r`` of particle n. Along the ray, component k is a Gaussian
    in d with precision ``q_k = r^T Sigma_k^-1 r``, centre ``d_k = r^T Sigma_k^-1 (mu_k - o) / q_k`` and mass
    ``m_k = pi_k N(o + d_k r; mu_k, Sigma_k) sqrt(2 pi / q_k)``. The error of depth is proportional to depth, so

        p(d | o, r) = sum_k m_k N(d; d_k, 1 / q_k + (log_depth_sd d_k)^2) / sum_k m_k

    over the components with ``d_k > nearest_m``. The normalisation removes the dependence of the map's density on the
    pose, so that neither dense regions nor grazing views attract the scan.
    """
    w = np.ones(len(scan)) if point_weights is None else point_weights
    precisions = np.linalg.inv(covariances)
    rays = scan / scan[:, 2:]
    result = np.empty(len(poses))
    for n, (T_world_camera, s) in enumerate(zip(poses, log_scales, strict=True)):
        origin, r = T_world_camera[:3, 3], rays @ T_world_camera[:3, :3].T
        q = np.einsum("pi,kij,pj->pk", r, precisions, r)
        surface = np.einsum("pi,kij,kj->pk", r, precisions, means - origin) / q
        nearest = origin + surface[..., None] * r[:, None]
        offsets = nearest - means
        log_peak = np.log(weights) + 0.5 * np.linalg.slogdet(precisions)[1]
        log_mass = log_peak - 0.5 * np.einsum("pki,kij,pkj->pk", offsets, precisions, offsets) - 0.5 * np.log(q)
        log_mass = np.where(surface > nearest_m, log_mass, -np.inf)
        largest = log_mass.max(axis=1, keepdims=True)
        mass = np.exp(log_mass - np.where(np.isfinite(largest), largest, 0.0))
        variance = 1.0 / q + (log_depth_sd * surface) ** 2
        d = np.exp(s) * scan[:, 2]
        parts = mass * np.exp(-0.5 * (d[:, None] - surface) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        total = mass.sum(axis=1)
        density = d * parts.sum(axis=1) / np.where(total > 0.0, total, 1.0)
        result[n] = w @ np.log((1.0 - outlier_share) * density + outlier_share / log_depth_range)
    return result


def expectation(points: FloatArray, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> Statistics:
    """E-step: sums over the responsibilities ``r_nk`` of points (N, 3) (Bishop 2006, section 9.2.2)."""
    terms = log_terms(points, weights, means, covariances)
    log_densities = log_sum_exp(terms)
    r = np.exp(terms - log_densities[:, None])
    offsets = points[:, None, :] - means
    first = np.einsum("nk,nki->ki", r, offsets)
    second = np.einsum("nk,nki,nkj->kij", r, offsets, offsets)
    return Statistics(r.sum(axis=0), first, second, float(log_densities.sum()))
