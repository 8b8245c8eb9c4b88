"""What a setting of adaptation is worth, where ``monoloc reproduce`` has no figure of it.

    python benchmarks/adaptation.py --data ../shared/data --out runs/adaptation --study annealing rates
    python benchmarks/adaptation.py --out runs/adaptation --study variants --network full-0.35 one-third-0.35 \
        --motion visual random-walk --seeds 10
    python benchmarks/adaptation.py --out runs/adaptation --study default unadapted --builds 5 --seeds 5
    python benchmarks/adaptation.py --out runs/adaptation --study default --builtin --light L1 L2 L3

RedKitchen, or the rendered room that comes with monoloc. The splits are those of ``monoloc reproduce``, whose engine
does the work: what is there is not done again, and results of its own ``--out`` serve here too.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from monoloc.depth.models import DEFAULT
from monoloc.io.registry import absolute_source, open_recording
from monoloc.progress import ConsoleProgress
from monoloc_lab.experiments import tasks
from monoloc_lab.experiments.engine import carry_out
from monoloc_lab.experiments.fig4d import FROM_SAME_START
from monoloc_lab.experiments.gather import RMSE, ROTATION, depth_of_variant, mean_depth, usual_light
from monoloc_lab.experiments.study import Split, Study, Walk, builtin, recorded
from monoloc_lab.experiments.task import Results, Task

MOTIONS = ("visual", "random-walk")
_BOTH = ("last+map", "joint")
# By study and name: the variant, and what of adaptation, or of the map, is changed.
STUDIES: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {
    "default": {"joint, landmarks": ("joint", {"landmarks": True})},
    "depth alone": {"joint": ("joint", {})},
    "unadapted": {"unadapted": ("unadapted", {})},
    "landmarks alone": {"unadapted, landmarks": ("unadapted", {"landmarks": True})},
    "variants": {name: (name, {}) for name in tasks.VARIANTS if name != "network"},
    "pose steps": {f"joint, weight {value:g}": ("joint", {"pose_weight": value}) for value in (0.0, 1.0)},
    "components": {f"K {count}": ("joint", {"components": count}) for count in (50, 100, 200, 400, 800)},
    "annealing": {
        f"{variant}, {value:g} m at first": (variant, {"inflation_m": value})
        for variant in _BOTH
        for value in (0.0, 0.1, 0.3, 1.0)
    },
    "rates": {f"joint, rate {value:g}": ("joint", {"network_rate": value}) for value in (3e-4, 1e-3, 3e-3)},
}
_COLUMNS = (
    *("study", "network", "split", "light", "motion", "variant", "median (seeds)", "RMSE", "of odometry's"),
    *("rotation", "coverage", "AbsRel", "SSIM", "shift", "matches kept", "KL"),
)


@dataclass(frozen=True)
class Row:
    """One of the table: what it is of, and what has to be done for it.

    Attributes:
        labels: the first columns.
        bundles, depths: one a build, and its depth on the walk.
        runs: one a seed; that of seed s is in build s modulo their number.
    """

    labels: tuple[str, ...]
    split: Split
    walk: Walk
    bundles: list[Task]
    depths: list[Task]
    runs: list[Task]


def rows_of(study: Study, arguments: argparse.Namespace) -> list[Row]:
    rows = []
    for name, network, split, motion in product(arguments.study, arguments.network, study.splits, arguments.motion):
        for light, variant in product(arguments.light or [usual_light(split)], STUDIES[name]):
            walk, (tuned, changed) = split.walks[light], STUDIES[name][variant]
            bundles = [
                tasks.bundle(study, split, network, tuned, seed=build, **changed) for build in range(arguments.builds)
            ]
            depths = [depth_of_variant(tuned, bundle, walk) for bundle in bundles]
            runs = [tasks.run(bundles[seed % len(bundles)], walk, seed, motion) for seed in range(arguments.seeds)]
            labels = (name, network, split.name, light, motion, variant)
            rows.append(Row(labels, split, walk, bundles, depths, runs))
    return rows


def cells_of(row: Row, results: Results) -> list[str]:
    """Medians over seeds and builds; in brackets the least and largest position, the worst ratio to odometry."""
    figures = [results[run].figures for run in row.runs]
    position = [100.0 * figure["unseen_ate_median_m"] for figure in figures]
    absrel, ssim = (
        np.median([mean_depth(results[depth], row.split, row.walk, metric) for depth in row.depths])
        for metric in ("absrel", "ssim")
    )
    rmse, rotation, coverage = (
        np.median([figure[name] for figure in figures]) for name in (RMSE, ROTATION, "unseen_coverage_95")
    )
    shift, kept, kl = (
        np.median([results[bundle].figures[name] for bundle in row.bundles])
        for name in ("shift_median_m", "correspondence_kept", "kl")
    )
    # Without odometry there is nothing to compare with.
    ratios = [figure[RMSE] / figure[FROM_SAME_START] for figure in figures if figure.get(FROM_SAME_START)]
    return [
        *row.labels,
        f"{np.median(position):.1f} cm ({min(position):.1f}-{max(position):.1f})",
        f"{100.0 * rmse:.1f} cm",
        f"{np.median(ratios):.2f} ({max(ratios):.2f})" if ratios else "",
        f"{rotation:.1f}°",
        f"{coverage:.2f}",
        f"{100.0 * absrel:.1f} %",
        f"{ssim:.3f}",
        f"{100.0 * shift:.1f} cm",
        f"{kept:.3f}",
        f"{kl:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--builtin", action="store_true", help="the rendered room in place of RedKitchen")
    parser.add_argument("--out", type=Path, default=Path("runs/adaptation"))
    parser.add_argument("--study", nargs="+", choices=list(STUDIES), default=["annealing", "rates"])
    parser.add_argument("--network", nargs="+", default=[DEFAULT])
    parser.add_argument("--motion", nargs="+", choices=MOTIONS, default=["visual"])
    parser.add_argument("--light", nargs="+", help="as taken (RedKitchen), L1, L2, L3; the usual one if left out")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--builds", type=int, default=1)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    if arguments.builtin:
        study = builtin(quick=False)
    else:
        source = absolute_source(f"7scenes:{arguments.data}/7scenes/redkitchen")
        recording = open_recording(source)
        study = recorded(source, recording.name, len(recording), quick=False)
    rows = rows_of(study, arguments)
    wanted = [task for row in rows for task in (*row.runs, *row.depths)]
    arguments.out.mkdir(parents=True, exist_ok=True)
    progress = ConsoleProgress(Console(stderr=True))
    results = carry_out(wanted, arguments.out.resolve(), progress, arguments.workers)
    print("| " + " | ".join(_COLUMNS) + " |")
    print("|" + "---|" * len(_COLUMNS))
    for row in rows:
        print("| " + " | ".join(cells_of(row, results)) + " |")


if __name__ == "__main__":
    main()
