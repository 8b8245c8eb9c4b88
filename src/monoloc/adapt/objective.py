"""The objective of adaptation: likelihood of predicted depth under the map, and KL of the adapted map."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from monoloc.map.rays import LOG_DEPTH_RANGE

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""(row, column) of the upper-triangular entries of a symmetric 3 x 3 matrix."""


def matched_kl(
    log_weights: Tensor,
    means: Tensor,
    covariances: Tensor,
    other_log_weights: Tensor,
    other_means: Tensor,
    other_covariances: Tensor,
) -> Tensor:
    """KL(M || M_A) of two mixtures with corresponding components, nats.

    ``sum_i pi_i (KL(N_i || N_A,i) + log(pi_i / pi_A,i))``. By convexity this is an upper bound on the true
    divergence. It equals Goldberger's approximation when each component's match is its nearest (Goldberger et al.,
    ICCV 2003, eq. 4).

    Args:
        log_weights, other_log_weights: (K,).
        means, other_means: (K, 3).
        covariances, other_covariances: (K, 3, 3).
    """
    lower = torch.linalg.cholesky(covariances)
    other_lower = torch.linalg.cholesky(other_covariances)
    whitened = torch.linalg.solve_triangular(other_lower, lower, upper=False)
    offset = torch.linalg.solve_triangular(other_lower, (other_means - means)[..., None], upper=False)
    log_determinants = 2.0 * (_log_diagonal(other_lower) - _log_diagonal(lower))
    trace, distance = whitened.square().sum((-1, -2)), offset.square().sum((-1, -2))
    component_kl = 0.5 * (trace + distance - means.shape[-1] + log_determinants)
    # A component of weight zero adds nothing; the difference of its logarithms would be NaN.
    log_ratio = torch.where(log_weights > -math.inf, log_weights - other_log_weights, 0.0)
    divergence: Tensor = (log_weights.exp() * (component_kl + log_ratio)).sum()
    return divergence


def ray_log_likelihood(
    log_depth: Tensor,
    rays_world: Tensor,
    origins: Tensor,
    log_weights: Tensor,
    means: Tensor,
    covariances: Tensor,
    outlier_share: float,
) -> Tensor:
    """Log-density of log-depth, conditional on the pixel's ray, (P,) nats.

    Along the ray ``o + d r`` each component is a one-dimensional Gaussian in d, so the mixture has a closed-form
    normaliser; d times the conditional density is the density of log d. Because the density is normalised along each
    ray, it gains nothing when depth and map shrink onto the cameras together. The density of
    :func:`volume_log_likelihood` does, without bound; there only the divergence from the original map prevents it.

        p(log d | o, r) = (1 - eps) d M(o + d r) / int_0^inf M(o + t r) dt + eps / range

    The range of the outliers' uniform density in log-depth is that of the localizer's likelihood,
    :data:`monoloc.map.rays.LOG_DEPTH_RANGE`.

    Args:
        log_depth: (P,) natural logarithm of depth along z.
        rays_world: (P, 3) ray directions r with camera z = 1, world frame.
        origins: (P, 3) camera centres o, world frame, metres.
        log_weights, means, covariances: the mixture, (K,), (K, 3), (K, 3, 3).
        outlier_share: eps, between 0 and 1.
    """
    lower = torch.linalg.cholesky(covariances)
    information = torch.cholesky_inverse(lower)
    # Along a ray the squared Mahalanobis distance is a d^2 - 2 b d + c, and a, b, c are linear in per-component
    # constants. Matrix products take half the time of whitened offsets, (P, K, 3).
    upper, of_means = _upper(information), (information @ means[..., None])[..., 0]
    a = _quadratic(rays_world, rays_world) @ upper
    b = rays_world @ of_means.T - _quadratic(rays_world, origins) @ upper
    c = _quadratic(origins, origins) @ upper - 2.0 * origins @ of_means.T + (of_means * means).sum(-1)
    best_depth = b / a
    # Log of weight times the component's peak along the ray; the common factor (2 pi)^(-3/2) cancels.
    log_peak = log_weights - _log_diagonal(lower) - 0.5 * (c - best_depth * b)
    log_joint = torch.logsumexp(log_peak - 0.5 * a * (log_depth.exp()[:, None] - best_depth).square(), dim=1)
    log_width = 0.5 * (math.log(2.0 * math.pi) - a.log())
    in_front = torch.special.log_ndtr(best_depth * a.sqrt())
    log_normaliser = torch.logsumexp(log_peak + log_width + in_front, dim=1)
    inlier = math.log1p(-outlier_share) + log_joint + log_depth - log_normaliser
    outlier = torch.full_like(inlier, math.log(outlier_share / LOG_DEPTH_RANGE))
    return torch.logaddexp(inlier, outlier)


def volume_log_likelihood(
    points: Tensor, log_weights: Tensor, means: Tensor, covariances: Tensor, outlier_share: float, volume_m3: float
) -> Tensor:
    """Log-density of points in the room, (P,) nats: ``log((1 - eps) M(x) + eps / V)``.

    The likelihood of Shukla et al. 2023, with the share of outliers of the localizer's
    :class:`monoloc.likelihood.volume.VolumeLikelihood`.

    Args:
        points: (P, 3) world frame, metres.
        log_weights, means, covariances: the mixture, (K,), (K, 3), (K, 3, 3).
        outlier_share: eps, between 0 and 1.
        volume_m3: V, in which outliers are uniformly distributed.
    """
    lower = torch.linalg.cholesky(covariances)
    upper, of_means = _upper(torch.cholesky_inverse(lower)), torch.cholesky_solve(means[..., None], lower)[..., 0]
    distance = _quadratic(points, points) @ upper - 2.0 * points @ of_means.T + (of_means * means).sum(-1)
    log_peak = log_weights - _log_diagonal(lower) - 1.5 * math.log(2.0 * math.pi)
    inlier = math.log1p(-outlier_share) + torch.logsumexp(log_peak - 0.5 * distance, dim=1)
    return torch.logaddexp(inlier, torch.full_like(inlier, math.log(outlier_share / volume_m3)))


def _upper(symmetric: Tensor) -> Tensor:
    """Upper-triangular entries of symmetric matrices, (K, 3, 3) -> (6, K)."""
    return torch.stack([symmetric[:, i, j] for i, j in UPPER])


def _quadratic(x: Tensor, y: Tensor) -> Tensor:
    """Factors (P, 6) that give ``x^T S y`` from the upper-triangular entries of a symmetric S; x, y are (P, 3)."""
    products = x[:, :, None] * y[:, None, :]
    folded = products + products.mT
    return torch.stack([folded[:, i, j] if i != j else products[:, i, i] for i, j in UPPER], dim=1)


def _log_diagonal(lower: Tensor) -> Tensor:
    return lower.diagonal(dim1=-2, dim2=-1).log().sum(-1)
