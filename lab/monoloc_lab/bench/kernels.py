"""The weighing of particles: its time, alternatives, error, and growth with the map."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

import monoloc._core as _core
from monoloc.geometry import FloatArray
from monoloc.map.em import fit_mixture
from monoloc.map.index import MixtureIndex
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress
from monoloc_lab.bench.alternatives import DenseWeigher, sklearn_scorer
from monoloc_lab.bench.scenes import Weighing, building, near_surface, weighing
from monoloc_lab.bench.timing import Work, fastest_s, has_sklearn, one_thread

_OUTLIER_SHARE = 0.1
_NEAR_M = 0.1  # largest distance to the map at which the error of the index is measured
_ITERATIONS = 30  # of the fits: the maps need to be realistic, not optimal
# Additions and multiplications. Of a component at a point: 9 fused multiply-adds for log2 of its density, 5 and 3
# additions for the exponential, 1 for the sum. Of a point besides: transform 18, grid 6, logarithm 28.
_FLOPS_COMPONENT, _FLOPS_POINT = 32, 52
_PEAK_ROUNDS = 2_000_000


@dataclass(frozen=True)
class KernelSizes:
    """Sizes that are measured.

    Attributes:
        particles, points: N and P of one weighing.
        components: K of the map.
        more, most: K of a finer map of the same room, and of a building of such rooms.
        rounds, slow_rounds: runs of monoloc, and of the slow alternatives.
    """

    particles: int = 1000
    points: int = 200
    components: int = 200
    more: int = 2_000
    most: int = 100_000
    rounds: int = 30
    slow_rounds: int = 3


@dataclass(frozen=True)
class KernelFigures:
    """JSON keys of ``monoloc bench kernels``; ratios are times of alternatives, or of larger maps, over ``weigh_ms``.

    Attributes:
        weigh_ms: one call.
        weigh_ratio_dense: of :class:`DenseWeigher`.
        weigh_ratio_sklearn: of ``score_samples`` of the same points; None if scikit-learn is not installed.
        weigh_error_mean_nat, weigh_error_max_nat: of the log-likelihood of a point, up to 10 cm from the map.
        weigh_ratio_k2000, weigh_ratio_k100000: at K = 2000 and 100,000.
        index_bytes: of the index of the map.
        gflops, peak_gflops: of the weighing, and of multiplications and additions alone.
    """

    weigh_ms: float
    weigh_ratio_dense: float
    weigh_ratio_sklearn: float | None
    weigh_error_mean_nat: float
    weigh_error_max_nat: float
    weigh_ratio_k2000: float
    weigh_ratio_k100000: float
    index_bytes: int
    gflops: float
    peak_gflops: float


def bench_kernels(
    cloud: FloatArray, sizes: KernelSizes, rng: np.random.Generator, progress: Progress
) -> KernelFigures:
    """Measure the weighing kernel on one thread, on maps fitted to a cloud (N, 3)."""
    with progress.task("maps", 3) as done, one_thread():
        mixture = fit_mixture(cloud, sizes.components, rng, max_iterations=_ITERATIONS).mixture
        done(1)
        finer = fit_mixture(cloud, sizes.more, rng, max_iterations=_ITERATIONS).mixture
        done(2)
        index, finer_index = mixture.index(), finer.index()
        large_index = building(mixture, sizes.most, rng).index()
        done(3)
    given = weighing(cloud, sizes.particles, sizes.points, rng)
    volume = mixture.volume_m3
    dense = DenseWeigher(mixture)
    with progress.task("weighing", 3) as done, one_thread():
        ours = {
            "map": weigher(index, given, volume),
            "finer": weigher(finer_index, given, volume),
            "large": weigher(large_index, given, volume),
        }
        times = fastest_s(ours, sizes.rounds)
        done(1)
        slow: dict[str, Work] = {
            "map": ours["map"],
            "dense": lambda: dense.weigh(given.points_world, sizes.particles, _OUTLIER_SHARE, volume),
        }
        if has_sklearn():
            scorer = sklearn_scorer(mixture)
            slow["sklearn"] = lambda: scorer.score_samples(given.points_world)
        compared = fastest_s(slow, sizes.slow_rounds)
        done(2)
        peak = peak_gflops()
        error_mean, error_max = index_error(mixture, index, near_surface(cloud, _NEAR_M, rng), volume)
        done(3)
    return KernelFigures(
        weigh_ms=1e3 * times["map"],
        weigh_ratio_dense=compared["dense"] / compared["map"],
        weigh_ratio_sklearn=compared["sklearn"] / compared["map"] if "sklearn" in compared else None,
        weigh_error_mean_nat=error_mean,
        weigh_error_max_nat=error_max,
        weigh_ratio_k2000=times["finer"] / times["map"],
        weigh_ratio_k100000=times["large"] / times["map"],
        index_bytes=index.nbytes,
        gflops=weigh_flops(index, given) / times["map"] / 1e9,
        peak_gflops=peak,
    )


def weigher(index: MixtureIndex, given: Weighing, volume_m3: float) -> Work:
    """One weighing, as a function to be timed."""
    return lambda: index.weigh(
        given.poses,
        given.log_scales,
        given.scan,
        outlier_share=_OUTLIER_SHARE,
        volume_m3=volume_m3,
    )


def weigh_flops(index: MixtureIndex, given: Weighing) -> float:
    """Additions and multiplications of one weighing; only evaluated components count, not all as in a dense form."""
    return _FLOPS_COMPONENT * index.evaluations(given.points_world) + _FLOPS_POINT * len(given.points_world)


def peak_gflops() -> float:
    """Peak of the core in single precision, measured with multiplications and additions only."""
    best = 0.0
    for _ in range(5):
        started = time.process_time()
        operations = _core.multiply_add(_PEAK_ROUNDS)
        best = max(best, operations / (time.process_time() - started) / 1e9)
    return best


def index_error(
    mixture: GaussianMixture, index: MixtureIndex, points: FloatArray, volume_m3: float
) -> tuple[float, float]:
    """Mean and largest error of ``log((1 - eps) M + eps / V)`` at points (N, 3) with the index, nats."""
    exact, indexed = (
        np.log((1.0 - _OUTLIER_SHARE) * np.exp(log_density) + _OUTLIER_SHARE / volume_m3)
        for log_density in (mixture.log_density(points), index.log_density(points))
    )
    error = np.abs(indexed - exact)
    return float(error.mean()), float(error.max())
