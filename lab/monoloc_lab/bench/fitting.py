"""Time of fitting a map, compared with scikit-learn."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray
from monoloc.map.em import initial_mixture, maximise_likelihood
from monoloc.progress import Progress
from monoloc_lab.bench.alternatives import sklearn_mixture
from monoloc_lab.bench.timing import has_sklearn, one_thread

_FLOOR_M = 0.01  # standard deviation of the covariance floor, and of what scikit-learn adds to every covariance
_ITERATIONS = 100


@dataclass(frozen=True)
class FitSizes:
    """Points and components of the map, and rounds of monoloc's fit, of which the fastest counts."""

    points: int = 40_000
    components: int = 200
    rounds: int = 3


@dataclass(frozen=True)
class FitFigures:
    """JSON keys of ``monoloc bench map``; those of scikit-learn are None if it is not installed.

    Attributes:
        fit_s: the whole fit, k-means++ start and EM.
        fit_ratio_sklearn: time of scikit-learn's EM over ``fit_s``; it is given the start, which does not count.
        loglik, loglik_sklearn: mean log-likelihood per point, nats.
    """

    fit_s: float
    fit_ratio_sklearn: float | None
    loglik: float
    loglik_sklearn: float | None


def bench_fit(cloud: FloatArray, sizes: FitSizes, seed: int, progress: Progress) -> FitFigures:
    """Fit a map to points of a cloud (N, 3) with monoloc and with scikit-learn, on one thread."""
    count = min(sizes.points, len(cloud))
    points = cloud[np.random.default_rng(seed).choice(len(cloud), count, replace=False)]
    seconds, theirs_s, theirs_loglik = float("inf"), None, None
    with progress.task("fits", sizes.rounds + 1) as done, one_thread():
        for number in range(sizes.rounds):
            started = time.process_time()
            start = initial_mixture(points, sizes.components, np.random.default_rng(seed), _FLOOR_M)
            result = maximise_likelihood(points, start, _FLOOR_M, _ITERATIONS)
            seconds = min(seconds, time.process_time() - started)
            done(number + 1)
        if has_sklearn():
            theirs = sklearn_mixture(start, _FLOOR_M, _ITERATIONS)
            started = time.process_time()
            theirs.fit(points)
            theirs_s = time.process_time() - started
            theirs_loglik = float(theirs.score(points))
        done(sizes.rounds + 1)
    return FitFigures(
        fit_s=seconds,
        fit_ratio_sklearn=None if theirs_s is None else theirs_s / seconds,
        loglik=result.log_likelihood_history[-1] / count,
        loglik_sklearn=theirs_loglik,
    )
