"""What each part of adaptation is worth, and why its settings are as they are: named variants, a run a line.

    python benchmarks/adaptation.py --data ../shared/data --out runs/adaptation --study variants --seeds 10
    python benchmarks/adaptation.py --out runs/adaptation --study lambda frames --seeds 3 --motion visual
    python benchmarks/adaptation.py --out runs/adaptation --study components --only "K 50" --split away

Splits, starts and figures are those of ``redkitchen.py``. Results go to ``runs.jsonl`` in the output folder, one
JSON object a run with the build's figures beside it. What is there already is not done again, so a study can be cut
off and taken up, or widened by seeds, splits and networks. Variants with the same settings share a bundle.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby, product
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.adapt.settings import AdaptConfig
from monoloc.build import BuildConfig
from monoloc.bundle import read_bundle
from monoloc.config import override
from monoloc.datasets.registry import open_recording, select_frames
from monoloc.models import DEFAULT
from redkitchen import SPLITS, InMemory, build_once, run_once

NETWORKS = ("full-0.35", "two-thirds-0.35", "one-third-0.35", "tiny-0.35")
MOTIONS = ("visual", "random-walk")
_RESULTS = "runs.jsonl"

_BOTH = {"last": {"tune": "last", "map_transform": True}, "default": {"tune": "all", "map_transform": True}}
_FOUR = {
    "none": {"tune": "none", "map_transform": False},
    "last only": {"tune": "last", "map_transform": False},
    "map only": {"tune": "none", "map_transform": True},
    "last + map (paper)": _BOTH["last"],
    "all only": {"tune": "all", "map_transform": False},
    "all + map (default)": _BOTH["default"],
}


@dataclass(frozen=True)
class Variant:
    """A way to build.

    Attributes:
        name: in the table.
        adapt: settings of adaptation.
        components: of the map.
        frames: how many build frames, evenly out of the split's; None for all.
    """

    name: str
    adapt: dict[str, object] = field(default_factory=dict)
    components: int = 200
    frames: int | None = None

    def bundle(self, split: str, network: str) -> str:
        """Name of the bundle: its settings, so that equal ones are built once."""
        changed = AdaptConfig.model_validate(self.adapt).model_dump(exclude_defaults=True)
        settings = "".join(f"-{key}={value}" for key, value in changed.items())
        return f"{split}-{network}-k={self.components}-frames={self.frames or 'all'}{settings}.monoloc"


STUDIES = {
    "variants": [Variant(name, adapt) for name, adapt in _FOUR.items()],
    "lambda": [
        Variant(f"{tune}, lambda {value:g}", {**_BOTH[tune], "lambda_kl": value})
        for tune, value in product(_BOTH, (0.0, 1e-3, 1e-2, 0.1, 1.0, 10.0))
    ],
    "components": [Variant(f"K {count}", _BOTH["default"], components=count) for count in (50, 100, 200, 400, 800)],
    "frames": [Variant(f"{count} frames", _BOTH["default"], frames=count) for count in (5, 10, 25, 50, 100)],
    "annealing": [
        Variant(f"{tune}, {value:g} m at first", {**_BOTH[tune], "inflation_m": value})
        for tune, value in product(_BOTH, (0.0, 0.1, 0.3, 1.0))
    ],
    "rates": [
        Variant(f"default, rate {value:g}", {**_BOTH["default"], "network_rate": value})
        for value in (3e-4, 1e-3, 3e-3)
    ],
}


@dataclass(frozen=True)
class Job:
    """One bundle and the runs over it."""

    source: str
    out: Path
    study: str
    variant: Variant
    network: str
    split: str
    motions: tuple[str, ...]
    seeds: int


def work(job: Job) -> None:
    """Build, if need be, and append what runs are missing."""
    results = job.out / _RESULTS
    key = {"study": job.study, "variant": job.variant.name, "network": job.network, "split": job.split}
    done = {(row["motion"], row["seed"]) for row in read_rows(results) if key.items() <= row.items()}
    missing = [pair for pair in product(job.motions, range(job.seeds)) if pair not in done]
    if not missing:
        return
    build_frames, judged_frames = SPLITS[job.split]
    recording = open_recording(job.source)
    frames = select_frames(recording, build_frames)
    if job.variant.frames is not None:
        start, stop, _ = (int(part) for part in build_frames.split(":"))
        frames = select_frames(recording, f"{start}:{stop}:{(stop - start) // job.variant.frames}")
    config = override(BuildConfig(), components=job.variant.components, adapt=job.variant.adapt)
    path = job.out / job.variant.bundle(job.split, job.network)
    report = build_once(frames, path, config, job.network)
    bundle, walk = read_bundle(path), InMemory(select_frames(recording, judged_frames))
    for motion, seed in missing:
        row = {**key, "motion": motion, "seed": seed, "build": report, "run": run_once(bundle, walk, motion, seed)}
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Runs that are done; a last line that was cut off counts as not done."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def print_table(rows: Iterable[dict[str, Any]]) -> None:
    """Medians over seeds; position's smallest and largest in brackets."""
    print(
        "| study | variant | network | split | motion | seeds | median (seeds) | RMSE | rotation | AbsRel | SSIM",
        end="",
    )
    print(" | odometry alone RMSE | shift | matches kept | KL | build |")
    print("|" + "---|" * 16)
    columns = ("study", "variant", "network", "split", "motion")
    for names, group in groupby(rows, key=lambda row: [row[column] for column in columns]):
        runs = list(group)
        build, figures = runs[0]["build"], [row["run"] for row in runs]
        # Odometry has none in the random walk.
        median = {key: float(np.median([figure[key] for figure in figures])) for key in figures[0]}
        position = sorted(100.0 * figure["unseen_ate_median_m"] for figure in figures)
        alone = median.get("unseen_odometry_ate_rmse_m", np.nan)
        cells = [
            *names,
            len(runs),
            f"{np.median(position):.1f} cm ({position[0]:.1f}-{position[-1]:.1f})",
            f"{100.0 * median['unseen_ate_rmse_m']:.1f} cm",
            f"{median['unseen_rot_median_deg']:.1f}°",
            f"{100.0 * median['unseen_depth_absrel']:.1f} %",
            f"{median['unseen_depth_ssim']:.3f}",
            f"{100.0 * alone:.1f} cm" if np.isfinite(alone) else "",
            f"{100.0 * build['shift_median_m']:.1f} cm",
            f"{build['correspondence_kept']:.3f}",
            f"{build['kl']:.2f}",
            f"{build['seconds']:.0f} s",
        ]
        print("| " + " | ".join(map(str, cells)) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/adaptation"))
    parser.add_argument("--study", nargs="+", choices=list(STUDIES), default=["variants"])
    parser.add_argument("--only", nargs="+", default=[], metavar="VARIANT", help="names of variants")
    parser.add_argument("--network", nargs="+", choices=NETWORKS, default=[DEFAULT])
    parser.add_argument("--split", nargs="+", choices=list(SPLITS), default=list(SPLITS))
    parser.add_argument("--motion", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1, help="bundles at a time; set OMP_NUM_THREADS=1 for several")
    arguments = parser.parse_args()
    unknown = set(arguments.only) - {variant.name for study in arguments.study for variant in STUDIES[study]}
    if unknown:
        parser.error(f"no variant of these studies is called {sorted(unknown)[0]!r}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    source = f"7scenes:{arguments.data}/7scenes/redkitchen"
    jobs = [
        Job(source, arguments.out, study, variant, network, split, tuple(arguments.motion), arguments.seeds)
        for study, network, split in product(arguments.study, arguments.network, arguments.split)
        for variant in STUDIES[study]
        if not arguments.only or variant.name in arguments.only
    ]
    if arguments.workers == 1:
        for job in jobs:
            work(job)
    else:
        with ProcessPoolExecutor(arguments.workers) as pool:
            list(pool.map(work, jobs))
    wanted = {(job.study, job.variant.name, job.network, job.split): order for order, job in enumerate(jobs)}
    rows = [row for row in read_rows(arguments.out / _RESULTS) if _of(row) in wanted]
    print_table(sorted(rows, key=lambda row: (wanted[_of(row)], MOTIONS.index(str(row["motion"])))))


def _of(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return str(row["study"]), str(row["variant"]), str(row["network"]), str(row["split"])


if __name__ == "__main__":
    main()
