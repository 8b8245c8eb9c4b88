"""Expectation maximisation (EM): fits the map, a Gaussian mixture, to a cloud.

The E-step is native code (``cpp/src/kernels.cpp``). The fit starts from k-means++ and uses full covariances. The
covariance floor clamps eigenvalues: among all covariances with eigenvalues of at least ``floor_m ** 2``, the clamped
sample covariance maximises the objective of the M-step, so every iteration still increases the likelihood.

Sources: Dempster, Laird and Rubin 1977; Bishop, *Pattern Recognition and Machine Learning* (2006), section
9.2.2; Arthur and Vassilvitskii 2007 (k-means++); Schwarz 1978 (BIC).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

import monoloc._core as _core
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.kmeans import kmeans, nearest
from monoloc.map.mixture import GaussianMixture

Progress = Callable[[int, float], None]

FLOOR_M = 0.01
"""Smallest standard deviation of a component: without one, the covariances of planes would be singular."""

_TOLERANCE = 1e-4  # nats per point; the likelihood of a scan of 200 points gains 0.02 nats
_ALIVE = 1.0  # a component with a smaller mass, in points, is empty
_SPLIT = 0.8  # distance between the means of a half and of the whole, in standard deviations


@dataclass(frozen=True)
class FitResult:
    """Result of a fit.

    Attributes:
        mixture: the fitted mixture.
        log_likelihood_history: total log-likelihood of the points, nats, non-decreasing, one entry per iteration; the
            last entry is that of ``mixture``.
        iterations: number of E-steps.
        converged: whether the last gain was below the tolerance.
    """

    mixture: GaussianMixture
    log_likelihood_history: list[float]
    iterations: int
    converged: bool

    def bic(self, point_count: int) -> float:
        """Bayesian information criterion (Schwarz), ``parameters * log(N) - 2 log L``; lower is better."""
        parameters = 10 * len(self.mixture) - 1  # mean 3, covariance 6, weight 1; the weights sum to one
        return float(parameters * np.log(point_count) - 2.0 * self.log_likelihood_history[-1])


@dataclass(frozen=True)
class _Moments:
    """Unnormalised statistics of the E-step: mass (K,), sum of offsets (K, 3), second moment (K, 3, 3)."""

    mass: FloatArray
    first: FloatArray
    second: FloatArray
    log_likelihood: float


def fit_mixture(
    points: ArrayLike,
    components: int,
    rng: np.random.Generator,
    max_iterations: int = 100,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a mixture to a cloud.

    Args:
        points: (N, 3), world frame, metres.
        components: K.
        rng: random generator of the k-means++ start.
        max_iterations: largest number of E-steps; the fit stops before, when one gains less than 1e-4 nats per point.
        progress: called with (iteration, mean log-likelihood per point).

    Raises:
        ValueError: the points have a wrong shape or are not finite.
        SettingError: the number of components is not 1 to N.
    """
    cloud = float64("points", points, None, 3)
    if not 1 <= components <= len(cloud):
        raise SettingError(
            "components",
            f"is {components} for a cloud of {len(cloud)} points",
            "give at least 1 and no more than the cloud has points",
        )
    start = initial_mixture(cloud, components, rng, FLOOR_M)
    return maximise_likelihood(cloud, start, max_iterations=max_iterations, progress=progress)


def choose_components(
    points: ArrayLike, candidates: Sequence[int], rng: np.random.Generator
) -> tuple[FitResult, dict[int, float]]:
    """Choose K by BIC: fit ``candidates`` in ascending order until BIC increases.

    For a dense cloud BIC selects many components, because it ignores the size of the map and the correlation of
    neighbouring points. Set K if the map must be small.

    Returns:
        The best fit, and the BIC of every K that was tried.

    Raises:
        ValueError: see :func:`fit_mixture`.
        SettingError: all candidates exceed the number of points.
    """
    cloud = float64("points", points, None, 3)
    usable = sorted({k for k in candidates if k <= len(cloud)})
    if not usable:
        raise SettingError(
            "components",
            f"candidates {tuple(candidates)} exceed a cloud of {len(cloud)} points",
            "use a denser cloud",
        )
    best: FitResult | None = None
    scores: dict[int, float] = {}
    for count in usable:
        result = fit_mixture(cloud, count, rng)
        scores[count] = result.bic(len(cloud))
        if best is not None and scores[count] >= min(list(scores.values())[:-1]):
            break
        best = result
    assert best is not None
    return best, scores


def initial_mixture(points: FloatArray, components: int, rng: np.random.Generator, floor_m: float) -> GaussianMixture:
    """Mixture of the weights, means and clamped covariances of k-means clusters of points (N, 3)."""
    labels = kmeans(points, components, rng)
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(components))
    counts = np.bincount(labels, minlength=components)  # k-means leaves no cluster empty
    ordered = points[order]
    means = np.add.reduceat(ordered, starts, axis=0) / counts[:, None]
    offsets = ordered - np.repeat(means, counts, axis=0)
    second = np.add.reduceat(offsets[:, :, None] * offsets[:, None, :], starts, axis=0)
    return GaussianMixture(counts / len(points), means, clamp_covariances(second / counts[:, None, None], floor_m))


def maximise_likelihood(
    points: ArrayLike,
    start: GaussianMixture,
    floor_m: float = FLOOR_M,
    max_iterations: int = 100,
    tolerance: float = _TOLERANCE,
    progress: Progress | None = None,
) -> FitResult:
    """Run EM from a given start; see :func:`fit_mixture` for other arguments and errors.

    A component with a mass below one point is replaced by half of the heaviest component. If this lowers the
    likelihood, it is undone, and there are no further replacements.

    Args:
        floor_m: smallest standard deviation of a component in any direction.
        tolerance: gain of an iteration, nats per point, below which the fit stops.

    Raises:
        SettingError: the floor is not positive.
    """
    if not floor_m > 0.0:
        raise SettingError("floor_m", f"is {floor_m}", "give a positive standard deviation in metres")
    cloud = float64("points", points, None, 3)
    # Sorted by cluster, the points of one SIMD vector share their few active components.
    cloud = cloud[np.argsort(nearest(cloud, start.means), kind="stable")]
    mixture, fallback, reseeding, converged = start, None, True, False
    history: list[float] = []
    while len(history) < max_iterations:
        moments = _expectation(cloud, mixture)
        if fallback is not None and moments.log_likelihood < history[-1]:
            mixture, fallback, reseeding = fallback, None, False
            continue
        history.append(moments.log_likelihood)
        if progress is not None:
            progress(len(history), history[-1] / len(cloud))
        if fallback is None and len(history) > 1 and history[-1] - history[-2] < tolerance * len(cloud):
            converged = True
            break
        if len(history) == max_iterations:
            break
        mixture, fallback = _maximisation(mixture, moments, floor_m), None
        empty = np.flatnonzero(moments.mass < _ALIVE)
        if reseeding and len(empty):
            mixture, fallback = _with_halves(mixture, empty, floor_m), mixture
    return FitResult(mixture, history, len(history), converged)


def clamp_covariances(covariances: FloatArray, floor_m: float) -> FloatArray:
    """Raise eigenvalues to at least ``floor_m ** 2``: (K, 3, 3) m^2 -> (K, 3, 3)."""
    eigenvalues, axes = np.linalg.eigh(covariances)
    clamped = (axes * np.maximum(eigenvalues, floor_m**2)[:, None, :]) @ axes.swapaxes(-1, -2)
    return np.asarray(0.5 * (clamped + clamped.swapaxes(-1, -2)))


def _expectation(points: FloatArray, mixture: GaussianMixture) -> _Moments:
    mass, first, packed, log_likelihood = _core.expectation(
        points, mixture.weights, mixture.means, mixture.covariances
    )
    second = packed[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return _Moments(mass, first, second, log_likelihood)


def _maximisation(mixture: GaussianMixture, moments: _Moments, floor_m: float) -> GaussianMixture:
    """M-step (Bishop 9.24-9.26) from offsets to the previous means; empty components keep mean and covariance."""
    alive = moments.mass >= _ALIVE
    mass = moments.mass[alive, None]
    shift = moments.first[alive] / mass
    spread = moments.second[alive] / mass[..., None] - shift[:, :, None] * shift[:, None, :]
    means, covariances = mixture.means.copy(), mixture.covariances.copy()
    means[alive] += shift
    covariances[alive] = clamp_covariances(spread, floor_m)
    return GaussianMixture(moments.mass / moments.mass.sum(), means, covariances)


def _with_halves(mixture: GaussianMixture, empty: NDArray[np.intp], floor_m: float) -> GaussianMixture:
    """Split the heaviest components along their longest axes, and store one half of each in an empty component.

    The two halves together have the weight, the mean and, except for the floor, the covariance of the whole.
    """
    heaviest = np.argsort(-mixture.weights, kind="stable")[: min(len(empty), len(mixture) - len(empty))]
    empty = empty[: len(heaviest)]
    eigenvalues, axes = np.linalg.eigh(mixture.covariances[heaviest])
    step = _SPLIT * np.sqrt(eigenvalues[:, 2, None]) * axes[:, :, 2]
    weights, means, covariances = mixture.weights.copy(), mixture.means.copy(), mixture.covariances.copy()
    weights[empty] = weights[heaviest] = 0.5 * mixture.weights[heaviest]
    means[empty], means[heaviest] = means[heaviest] - step, means[heaviest] + step
    halves = clamp_covariances(covariances[heaviest] - step[:, :, None] * step[:, None, :], floor_m)
    covariances[empty] = covariances[heaviest] = halves
    return GaussianMixture(weights / weights.sum(), means, covariances)
