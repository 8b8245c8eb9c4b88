"""Alternatives to monoloc's kernels, for comparison."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.map.mixture import GaussianMixture

Floats = NDArray[np.floating[Any]]


class DenseWeigher:
    """The dense form in NumPy: log-densities are a matrix product of monomials and coefficients, then logsumexp.

    Args:
        dtype: of the matrices; single precision is about three times as fast as double.
    """

    def __init__(self, mixture: GaussianMixture, dtype: type[np.floating[Any]] = np.float64) -> None:
        self._dtype = dtype
        self._centre = mixture.means.mean(axis=0)
        precision = np.linalg.inv(mixture.covariances)
        means = mixture.means - self._centre
        linear = np.einsum("kij,kj->ki", precision, means)
        log_determinant = np.linalg.slogdet(mixture.covariances)[1]
        constant = np.log(mixture.weights) - 0.5 * (
            3.0 * np.log(2.0 * np.pi) + log_determinant + np.einsum("ki,ki->k", means, linear)
        )
        squares = -0.5 * precision[:, [0, 1, 2], [0, 1, 2]]
        products = -precision[:, [0, 0, 1], [1, 2, 2]]
        #: (10, K): coefficient of each monomial in each component.
        coefficients = np.concatenate([squares, products, linear, constant[:, None]], axis=1)
        self.coefficients = coefficients.T.astype(dtype)

    def log_density(self, points: FloatArray) -> Floats:
        """``log M(x)``: (N, 3) -> (N,)."""
        terms = self.monomials(points) @ self.coefficients
        largest = terms.max(axis=1)
        return np.asarray(largest + np.log(np.exp(terms - largest[:, None]).sum(axis=1)))

    def weigh(self, points_world: FloatArray, particles: int, outlier_share: float, volume_m3: float) -> Floats:
        """Log-likelihood of a scan for every particle, from its points in the world frame, (N * P, 3) -> (N,)."""
        density = np.exp(self.log_density(points_world))
        mixed = np.log((1.0 - outlier_share) * density + outlier_share / volume_m3)
        return np.asarray(mixed.reshape(particles, -1).sum(axis=1))

    def monomials(self, points: FloatArray) -> Floats:
        """Squares, products, coordinates and 1 of points relative to the centre of the map: (N, 3) -> (N, 10)."""
        x, y, z = (points - self._centre).T.astype(self._dtype)
        return np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones_like(x)], axis=1)


def sklearn_mixture(start: GaussianMixture, floor_m: float, max_iterations: int) -> Any:
    """A ``sklearn.mixture.GaussianMixture`` that starts from ``start`` with the same variance floor."""
    from sklearn.mixture import GaussianMixture as SklearnMixture

    return SklearnMixture(
        len(start),
        covariance_type="full",
        weights_init=start.weights,
        means_init=start.means,
        precisions_init=np.linalg.inv(start.covariances),
        reg_covar=floor_m**2,
        max_iter=max_iterations,
        init_params="random",  # all three are given, so its k-means would be wasted time
    )


def sklearn_scorer(mixture: GaussianMixture) -> Any:
    """``mixture`` as a ``sklearn.mixture.GaussianMixture``, to score points."""
    from sklearn.mixture import GaussianMixture as SklearnMixture

    scorer = SklearnMixture(len(mixture), covariance_type="full")
    scorer.weights_, scorer.means_, scorer.covariances_ = mixture.weights, mixture.means, mixture.covariances
    lower = np.linalg.cholesky(mixture.covariances)
    scorer.precisions_cholesky_ = np.linalg.inv(lower).swapaxes(-1, -2)
    return scorer
