"""What weighing costs against particles, points and components, and against every dense form: the report's figures.

    OMP_NUM_THREADS=1 python benchmarks/speed.py --source 7scenes:../shared/data/7scenes/redkitchen --frames ::4 \
        --out benchmarks/reports/2026-11-22-speed.png

Processor time of one thread, the fastest of runs that take turns. ``monoloc bench`` has the other figures.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from numpy.typing import NDArray

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.room_map import fit_map
from monoloc.io.registry import open_recording, select_frames
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress
from monoloc_lab.bench.alternatives import DenseWeigher, sklearn_scorer
from monoloc_lab.bench.kernels import weigher
from monoloc_lab.bench.scenes import Weighing, building, weighing
from monoloc_lab.bench.timing import Work, fastest_s, one_thread

PARTICLES, POINTS, COMPONENTS = 1000, 200, 200
ROOM_COMPONENTS = (100, 200, 500, 1000, 2000)
BUILDING_COMPONENTS = (1_000, 10_000, 100_000)
ROUNDS = 15
BLOCK = 2000  # points of the tuned dense form at a time: their terms stay in the cache


def tuned(dense: DenseWeigher, given: Weighing) -> NDArray[np.float32]:
    """The dense form as fast as NumPy does it: single precision, in place, in blocks, components as rows."""
    monomials = np.ascontiguousarray(dense.monomials(given.points_world).T)
    coefficients = np.ascontiguousarray(dense.coefficients.T)
    out = np.empty(monomials.shape[1], np.float32)
    for first in range(0, len(out), BLOCK):
        terms = coefficients @ monomials[:, first : first + BLOCK]
        largest = terms.max(axis=0)
        terms -= largest
        np.exp(terms, out=terms)
        out[first : first + BLOCK] = largest + np.log(terms.sum(axis=0))
    return out


def in_torch(dense: DenseWeigher, given: Weighing) -> torch.Tensor:
    terms = torch.from_numpy(dense.monomials(given.points_world)) @ torch.from_numpy(dense.coefficients)
    return torch.logsumexp(terms, dim=1)


def dense_forms(mixture: GaussianMixture, given: Weighing) -> None:
    single, double = DenseWeigher(mixture, np.float32), DenseWeigher(mixture)
    scorer = sklearn_scorer(mixture)
    work: dict[str, Work] = {
        "monoloc": weigher(mixture.index(), given, mixture.volume_m3),
        "NumPy, double": lambda: double.log_density(given.points_world),
        "NumPy, single": lambda: single.log_density(given.points_world),
        "torch, double": lambda: in_torch(double, given),
        "torch, single": lambda: in_torch(single, given),
        "NumPy, single, in place, blocks in cache": lambda: tuned(single, given),
        "scikit-learn score_samples": lambda: scorer.score_samples(given.points_world),
    }
    times = fastest_s(work, 3)
    print("\n| form | ms | times monoloc's |\n|---|---|---|")
    for name, seconds in times.items():
        print(f"| {name} | {1e3 * seconds:.2f} | {seconds / times['monoloc']:.0f} |")


def milliseconds(work: dict[str, Work]) -> dict[str, float]:
    return {name: 1e3 * seconds for name, seconds in fastest_s(work, ROUNDS).items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", required=True)
    parser.add_argument("--frames", default="::4")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    recording = select_frames(open_recording(arguments.source), arguments.frames)
    cloud, mixture = fit_map(recording, None, BuildConfig(components=COMPONENTS), rng, NoProgress())
    given = weighing(cloud, PARTICLES, POINTS, rng)
    index, volume = mixture.index(), mixture.volume_m3
    with one_thread():
        dense_forms(mixture, given)
        by_particles = {
            str(n): weigher(index, weighing(cloud, n, POINTS, rng), volume) for n in (100, 300, 1000, 3000, 10_000)
        }
        by_points = {
            str(p): weigher(index, weighing(cloud, PARTICLES, p, rng), volume) for p in (25, 50, 100, 200, 400, 800)
        }
        fine, rooms = {}, {str(COMPONENTS): weigher(index, given, volume)}
        sizes = []
        for k in ROOM_COMPONENTS:
            indexed = fit_mixture(cloud, k, rng, max_iterations=20).mixture.index()
            fine[str(k)] = weigher(indexed, given, volume)
            sizes.append(("one room", k, indexed))
        for k in BUILDING_COMPONENTS:
            indexed = building(mixture, k, rng).index()
            rooms[str(k)] = weigher(indexed, given, volume)
            sizes.append(("rooms of 200", k, indexed))
        curves = [
            ("particles", {"200 points, K = 200": by_particles}),
            ("scan points", {"1000 particles, K = 200": by_points}),
            ("components", {"one room, ever finer": fine, "ever more rooms of 200": rooms}),
        ]
        figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), constrained_layout=True)
        for axis, (label, lines) in zip(axes, curves, strict=True):
            for name, work in lines.items():
                times = milliseconds(work)
                print(f"\n{label}, {name}: " + ", ".join(f"{at}: {ms:.2f} ms" for at, ms in times.items()))
                axis.plot([int(at) for at in times], list(times.values()), marker="o", label=name)
            axis.set(xscale="log", xlabel=label, ylabel="one weighing, ms")
            axis.grid(alpha=0.3)
            axis.legend(loc="best", frameon=False, fontsize=9)
        for axis, (_, lines) in zip(axes[:2], curves[:2], strict=True):
            values = [int(at) for work in lines.values() for at in work]
            axis.set(yscale="log")
            axis.set_xticks(values, [str(value) for value in values])
            axis.minorticks_off()
        axes[2].set(ylim=(0.0, 2.0))
        figure.savefig(arguments.out, dpi=110)
    print("\n| map | K | voxels | components a voxel | index, MB |\n|---|---|---|---|---|")
    for name, k, indexed in sizes:
        print(f"| {name} | {k} | {indexed.voxels} | {indexed.mean_candidates:.1f} | {indexed.nbytes / 1e6:.2f} |")


if __name__ == "__main__":
    main()
