"""How the time of a weighing grows with particles, points and components, and the dense alternatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import Progress
from monoloc_lab.bench.alternatives import DenseWeigher, sklearn_scorer
from monoloc_lab.bench.kernels import weigher
from monoloc_lab.bench.scenes import Weighing, building, weighing
from monoloc_lab.bench.timing import Work, fastest_s, has_sklearn, one_thread

_BLOCK = 2000  # points at a time of the tuned dense form: its terms stay in the cache
_ITERATIONS = 20  # of the fits: the maps need to be realistic, not optimal


@dataclass(frozen=True)
class ScalingSizes:
    """Sizes that are measured.

    Attributes:
        particles, points, components: of the basic weighing.
        by_particles, by_points: numbers of particles and of scan points that are varied.
        by_components: components of ever finer maps of the room.
        by_rooms: components of buildings of such rooms.
        rounds, slow_rounds: runs of monoloc, and of the dense forms.
    """

    particles: int = 1000
    points: int = 200
    components: int = 200
    by_particles: tuple[int, ...] = (100, 300, 1000, 3000, 10_000)
    by_points: tuple[int, ...] = (25, 50, 100, 200, 400, 800)
    by_components: tuple[int, ...] = (100, 200, 500, 1000, 2000)
    by_rooms: tuple[int, ...] = (1_000, 10_000, 100_000)
    rounds: int = 15
    slow_rounds: int = 3


@dataclass(frozen=True)
class ScalingFigures:
    """JSON keys of ``monoloc bench scaling``: milliseconds of one weighing on one thread.

    Attributes:
        ms_by_particles, ms_by_points, ms_by_components, ms_by_rooms: by the number that varies.
        dense_ratios: time of each dense form, which evaluates every component at every point, over monoloc's.
        index_mb: of the index, by the components of the finer maps and of the buildings.
    """

    ms_by_particles: dict[int, float]
    ms_by_points: dict[int, float]
    ms_by_components: dict[int, float]
    ms_by_rooms: dict[int, float]
    dense_ratios: dict[str, float]
    index_mb: dict[int, float]


def bench_scaling(
    cloud: FloatArray, sizes: ScalingSizes, rng: np.random.Generator, progress: Progress
) -> ScalingFigures:
    """Measure the weighing kernel on maps fitted to a cloud (N, 3)."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with one_thread():
            return _measure(cloud, sizes, rng, progress)
    finally:
        torch.set_num_threads(threads)


def _measure(cloud: FloatArray, sizes: ScalingSizes, rng: np.random.Generator, progress: Progress) -> ScalingFigures:
    fitted = {
        k: fit_mixture(cloud, k, rng, max_iterations=_ITERATIONS).mixture
        for k in {*sizes.by_components, sizes.components}
    }
    mixture = fitted[sizes.components]
    given = weighing(cloud, sizes.particles, sizes.points, rng)
    index, volume = mixture.index(), mixture.volume_m3
    finer = {k: fitted[k].index() for k in sizes.by_components}
    rooms = {k: building(mixture, k, rng).index() for k in sizes.by_rooms}
    groups: dict[str, dict[int, Work]] = {
        "particles": {n: weigher(index, weighing(cloud, n, sizes.points, rng), volume) for n in sizes.by_particles},
        "points": {p: weigher(index, weighing(cloud, sizes.particles, p, rng), volume) for p in sizes.by_points},
        "components": {k: weigher(indexed, given, volume) for k, indexed in finer.items()},
        "rooms": {k: weigher(indexed, given, volume) for k, indexed in rooms.items()},
    }
    measured = {}
    with progress.task("weighing", len(groups) + 1) as done:
        for number, (name, work) in enumerate(groups.items()):
            measured[name] = _milliseconds(work, sizes.rounds)
            done(number + 1)
        forms = fastest_s(
            {"monoloc": weigher(index, given, volume), **_dense_forms(mixture, given)}, sizes.slow_rounds
        )
        done(len(groups) + 1)
    ours = forms.pop("monoloc")
    return ScalingFigures(
        ms_by_particles=measured["particles"],
        ms_by_points=measured["points"],
        ms_by_components=measured["components"],
        ms_by_rooms=measured["rooms"],
        dense_ratios={name: seconds / ours for name, seconds in forms.items()},
        index_mb={k: indexed.nbytes / 1e6 for k, indexed in (finer | rooms).items()},
    )


def _milliseconds(work: dict[int, Work], rounds: int) -> dict[int, float]:
    times = fastest_s({str(number): run for number, run in work.items()}, rounds)
    return {number: 1e3 * times[str(number)] for number in work}


def _dense_forms(mixture: GaussianMixture, given: Weighing) -> dict[str, Work]:
    single, double = DenseWeigher(mixture, np.float32), DenseWeigher(mixture)
    forms: dict[str, Work] = {
        "NumPy, double": lambda: double.log_density(given.points_world),
        "NumPy, single": lambda: single.log_density(given.points_world),
        "NumPy, single, in blocks": lambda: tuned_dense(single, given.points_world),
        "torch, double": lambda: _in_torch(double, given.points_world),
        "torch, single": lambda: _in_torch(single, given.points_world),
    }
    if has_sklearn():
        scorer = sklearn_scorer(mixture)
        forms["scikit-learn"] = lambda: scorer.score_samples(given.points_world)
    return forms


def tuned_dense(dense: DenseWeigher, points: FloatArray) -> NDArray[np.float32]:
    """The dense form tuned for NumPy: single precision, in place, in blocks, components as rows; (N, 3) -> (N,)."""
    monomials = np.ascontiguousarray(dense.monomials(points).T)
    coefficients = np.ascontiguousarray(dense.coefficients.T)
    out = np.empty(monomials.shape[1], np.float32)
    for first in range(0, len(out), _BLOCK):
        terms = coefficients @ monomials[:, first : first + _BLOCK]
        largest = terms.max(axis=0)
        terms -= largest
        np.exp(terms, out=terms)
        out[first : first + _BLOCK] = largest + np.log(terms.sum(axis=0))
    return out


def _in_torch(dense: DenseWeigher, points: FloatArray) -> torch.Tensor:
    terms = torch.from_numpy(dense.monomials(points)) @ torch.from_numpy(dense.coefficients)
    return torch.logsumexp(terms, dim=1)
