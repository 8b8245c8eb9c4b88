"""Expectation maximisation: from a cloud to the mixture that is the map.

E-step in native code (``cpp/src/kernels.cpp``), k-means++ start, full covariances. The covariance floor is
an eigenvalue clamp: among all covariances with eigenvalues of at least ``floor_m ** 2``, the clamped sample
covariance maximises the M-step's objective, so the likelihood still rises in every iteration.

Sources: Dempster, Laird and Rubin 1977; Bishop, *Pattern Recognition and Machine Learning* (2006), section
9.2.2; Arthur and Vassilvitskii 2007 (k-means++); Schwarz 1978 (BIC).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from monoloc import _core
from monoloc.errors import SettingError
from monoloc.geometry import FloatArray
from monoloc.map.arguments import float64
from monoloc.map.kmeans import kmeans, nearest
from monoloc.map.mixture import GaussianMixture

Progress = Callable[[int, float], None]

_ALIVE = 1.0  # a component that holds less than one point is empty
_SPLIT = 0.8  # of a standard deviation: distance of the halves' means from the whole's


@dataclass(frozen=True)
class FitResult:
    """Attributes:
    mixture: what was fitted.
    log_likelihood_history: total log-likelihood of the points, nats, one entry an iteration, never
        falling; the last is that of ``mixture``.
    iterations: E-steps done.
    converged: whether the last gain was under the tolerance.
    """

    mixture: GaussianMixture
    log_likelihood_history: list[float]
    iterations: int
    converged: bool

    def bic(self, point_count: int) -> float:
        """Schwarz's criterion, to be minimised: ``parameters * log(N) - 2 log L``."""
        parameters = 10 * len(self.mixture) - 1  # mean 3, covariance 6, weight 1 (they sum to one)
        return float(parameters * np.log(point_count) - 2.0 * self.log_likelihood_history[-1])


@dataclass(frozen=True)
class _Moments:
    """Statistics of the E-step as (K,) mass, (K, 3) mean offset and (K, 3, 3) second moment, not divided."""

    mass: FloatArray
    first: FloatArray
    second: FloatArray
    log_likelihood: float


def fit_mixture(
    points: ArrayLike,
    components: int,
    rng: np.random.Generator,
    floor_m: float = 0.01,
    max_iterations: int = 100,
    tolerance: float = 1e-4,
    progress: Progress | None = None,
) -> FitResult:
    """Fit a mixture to a cloud.

    Args:
        points: (N, 3), world frame, metres.
        components: K.
        rng: source of the k-means++ start.
        floor_m: smallest standard deviation of a component in any direction.
        max_iterations: E-steps at most.
        tolerance: ends when an iteration gains less than this, nats a point.
        progress: called with (iteration, mean log-likelihood a point).

    Raises:
        ValueError: points of another shape or not finite.
        SettingError: a number of components that the cloud cannot carry, or a floor that is not positive.
    """
    cloud = float64("points", points, None, 3)
    if not 1 <= components <= len(cloud):
        raise SettingError(
            "components",
            f"is {components} for a cloud of {len(cloud)} points",
            "give at least 1 and no more than the cloud has points",
        )
    start = initial_mixture(cloud, components, rng, floor_m)
    return maximise_likelihood(cloud, start, floor_m, max_iterations, tolerance, progress)


def choose_components(
    points: ArrayLike, candidates: Sequence[int], rng: np.random.Generator
) -> tuple[FitResult, dict[int, float]]:
    """The fit of smallest BIC among ``candidates``, tried in rising order until BIC rises.

    A dense cloud of a room supports many components: BIC weighs fit against parameters and knows nothing
    of the map's size or of how correlated neighbouring points are. Give K when the map must stay small.

    Returns:
        The best fit, and the BIC of every K tried.
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
    """Weights, means and clamped covariances of k-means clusters: (N, 3) -> mixture."""
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
    floor_m: float = 0.01,
    max_iterations: int = 100,
    tolerance: float = 1e-4,
    progress: Progress | None = None,
) -> FitResult:
    """EM from a given start; arguments and errors as for :func:`fit_mixture`.

    A component left with less than one point takes over half of the heaviest one. If that lowers the
    likelihood it is undone, and no further one is tried.
    """
    if not floor_m > 0.0:
        raise SettingError("floor_m", f"is {floor_m}", "give a positive standard deviation in metres")
    cloud = float64("points", points, None, 3)
    # Neighbours in memory are neighbours in space, so a vector of points shares its few active components.
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
    """The M-step (Bishop 9.24-9.26), from offsets to the old means; empty components stay as they are."""
    alive = moments.mass >= _ALIVE
    mass = moments.mass[alive, None]
    shift = moments.first[alive] / mass
    spread = moments.second[alive] / mass[..., None] - shift[:, :, None] * shift[:, None, :]
    means, covariances = mixture.means.copy(), mixture.covariances.copy()
    means[alive] += shift
    covariances[alive] = clamp_covariances(spread, floor_m)
    return GaussianMixture(moments.mass / moments.mass.sum(), means, covariances)


def _with_halves(mixture: GaussianMixture, empty: NDArray[np.intp], floor_m: float) -> GaussianMixture:
    """``mixture`` with its empty components made halves of the heaviest ones, split along their longest axes.

    Weight, mean and (but for the floor) covariance of the two halves together are those of the whole.
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
