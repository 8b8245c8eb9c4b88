"""The native kernels, written as their formulas: NumPy twins for tests and benchmarks.

Dense and slow on purpose. The tests hold ``monoloc._core`` equal to these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import transform

FloatArray = NDArray[np.float64]


class Statistics(NamedTuple):
    """What EM's M-step needs, with offsets ``d_nk = x_n - mu_k`` from the current means.

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
    """``log(pi_k N(x_p; mu_k, Sigma_k))``: (P, 3) -> (P, K)."""
    offsets = points[:, None, :] - means
    lower = np.linalg.cholesky(covariances)
    whitened = np.linalg.solve(lower, offsets[..., None])[..., 0]
    log_determinant = 2.0 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)
    log_normaliser = -0.5 * (3.0 * np.log(2.0 * np.pi) + log_determinant)
    with np.errstate(divide="ignore"):  # a component of weight 0
        return np.asarray(np.log(weights) + log_normaliser - 0.5 * (whitened**2).sum(axis=-1))


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


def expectation(points: FloatArray, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> Statistics:
    """The E-step: responsibilities ``r_nk`` of points (N, 3) and their sums (Bishop 2006, section 9.2.2)."""
    terms = log_terms(points, weights, means, covariances)
    log_densities = log_sum_exp(terms)
    r = np.exp(terms - log_densities[:, None])
    offsets = points[:, None, :] - means
    first = np.einsum("nk,nki->ki", r, offsets)
    second = np.einsum("nk,nki,nkj->kij", r, offsets, offsets)
    return Statistics(r.sum(axis=0), first, second, float(log_densities.sum()))
