"""What a setting of adaptation is worth on RedKitchen, where ``monoloc reproduce`` has no figure of it.

    python benchmarks/adaptation.py --data ../shared/data --out runs/adaptation --study annealing rates
    python benchmarks/adaptation.py --out runs/adaptation --study variants --motion random-walk --seeds 10

The splits are those of ``monoloc reproduce``, whose engine does the work: what is there is not done again, and
results of its own ``--out`` serve here too.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from monoloc.datasets.registry import absolute_source, open_recording
from monoloc.experiments import tasks
from monoloc.experiments.engine import carry_out
from monoloc.experiments.study import Study, recorded
from monoloc.experiments.task import Results, Task
from monoloc.models import DEFAULT
from monoloc.progress import ConsoleProgress

MOTIONS = ("visual", "random-walk")
_BOTH = ("last+map", "joint")
# By study and name: the variant, and what of adaptation, or of the map, is changed.
STUDIES: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {
    "variants": {name: (name, {}) for name in tasks.VARIANTS},
    "components": {f"K {count}": ("joint", {"components": count}) for count in (50, 100, 200, 400, 800)},
    "annealing": {
        f"{variant}, {value:g} m at first": (variant, {"inflation_m": value})
        for variant in _BOTH
        for value in (0.0, 0.1, 0.3, 1.0)
    },
    "rates": {f"joint, rate {value:g}": ("joint", {"network_rate": value}) for value in (3e-4, 1e-3, 3e-3)},
}
_COLUMNS = ("split", "motion", "median (seeds)", "RMSE", "rotation", "AbsRel", "shift", "matches kept", "KL")


def runs_of(study: Study, arguments: argparse.Namespace) -> dict[tuple[str, str, str, str], tuple[Task, list[Task]]]:
    """By study, variant, split and motion: the bundle, and a run a seed."""
    return {
        (name, variant, split.name, motion): (bundle, runs)
        for name in arguments.study
        for variant, (tuned, changed) in STUDIES[name].items()
        for split in study.splits
        for motion in arguments.motion
        for bundle in [tasks.bundle(study, split, arguments.network, tuned, **changed)]
        for runs in [[tasks.run(bundle, split.walks["as taken"], seed, motion) for seed in range(arguments.seeds)]]
    }


def row_of(bundle: Task, runs: list[Task], results: Results) -> list[str]:
    """Medians over seeds; position's smallest and largest in brackets."""
    build, figures = results[bundle].figures, [results[run].figures for run in runs]
    position = [100.0 * figure["unseen_ate_median_m"] for figure in figures]

    def median(name: str) -> float:
        return float(np.median([figure[f"unseen_{name}"] for figure in figures]))

    return [
        f"{np.median(position):.1f} cm ({min(position):.1f}-{max(position):.1f})",
        f"{100.0 * median('ate_rmse_m'):.1f} cm",
        f"{median('rot_median_deg'):.1f}°",
        f"{100.0 * median('depth_absrel'):.1f} %",
        f"{100.0 * build['shift_median_m']:.1f} cm",
        f"{build['correspondence_kept']:.3f}",
        f"{build['kl']:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/adaptation"))
    parser.add_argument("--study", nargs="+", choices=list(STUDIES), default=["annealing", "rates"])
    parser.add_argument("--network", default=DEFAULT)
    parser.add_argument("--motion", nargs="+", choices=MOTIONS, default=["visual"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    source = absolute_source(f"7scenes:{arguments.data}/7scenes/redkitchen")
    recording = open_recording(source)
    rows = runs_of(recorded(source, recording.name, len(recording), quick=False), arguments)
    wanted = [run for _, runs in rows.values() for run in runs]
    arguments.out.mkdir(parents=True, exist_ok=True)
    progress = ConsoleProgress(Console(stderr=True))
    results = carry_out(wanted, arguments.out.resolve(), progress, arguments.workers)
    print("| study | variant | " + " | ".join(_COLUMNS) + " |")
    print("|" + "---|" * (len(_COLUMNS) + 2))
    for names, (bundle, runs) in rows.items():
        print("| " + " | ".join([*names, *row_of(bundle, runs, results)]) + " |")


if __name__ == "__main__":
    main()
