"""Pose error on a real room, over variants, motion models and seeds: the table of ``benchmarks/reports``.

    python benchmarks/redkitchen.py --data ../shared/data --out runs/redkitchen

Two splits of 7-Scenes RedKitchen (positions among its frames): ``between`` builds from 0:400:4 and localises on
0:400, judged on the frames that did not build; ``away`` builds from 0:300:3 and localises on 300:400, whose
viewpoints the build never saw. Every run starts 10 cm and 3 degrees off. Bundles that are there are used again.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.build import BuildConfig, build_bundle
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.config import override
from monoloc.datasets.base import Recording
from monoloc.datasets.registry import open_recording, select_frames
from monoloc.geometry import FloatArray
from monoloc.models import DEFAULT
from monoloc.progress import NoProgress
from monoloc.runs import Start, disturbed, localize

SPLITS = {"between": ("0:400:4", "0:400"), "away": ("0:300:3", "300:400")}
VARIANTS = {
    "unadapted": {"tune": "none", "map_transform": False},
    "last layer + map (paper)": {"tune": "last", "map_transform": True},
    "all + map (default)": {"tune": "all", "map_transform": True},
}
SENSOR = "sensor depth"


class InMemory:
    """A recording read once, for many runs over it."""

    def __init__(self, source: Recording) -> None:
        self.name, self.camera, self.frame_names = source.name, source.camera, source.frame_names
        self.timestamps_s, self.poses, self.has_depth = source.timestamps_s, source.poses, source.has_depth
        self._colors = [source.color(index) for index in range(len(source))]
        self._depths = [source.depth(index) for index in range(len(source))]

    def __len__(self) -> int:
        return len(self._colors)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._colors[index]

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._depths[index]


def bundle_path(out: Path, split: str, variant: str) -> Path:
    return out / f"{split}-{variant.split()[0]}.monoloc"


def build_once(
    recording: Recording, path: Path, config: BuildConfig, network: str = DEFAULT, cloud: FloatArray | None = None
) -> dict[str, object]:
    """Build a bundle, unless it is there; returns the build's report, which lies beside it."""
    report_file = path.with_suffix(".json")
    if not report_file.exists():
        bundle, report = build_bundle(recording, config, 0, NoProgress(), cloud, network)
        write_bundle(path, bundle)
        report_file.write_text(json.dumps(asdict(report), indent=1))
        print(f"built {path.name} in {report.seconds:.0f} s", flush=True)
    return dict(json.loads(report_file.read_text()))


def run_once(
    bundle: Bundle, recording: Recording, motion: str, seed: int, use_sensor: bool = False
) -> dict[str, float]:
    """Figures of one run from a start that is 10 cm and 3 degrees off."""
    assert recording.poses is not None
    rng = np.random.default_rng(seed)
    start = Start(disturbed(recording.poses[0], 0.10, np.deg2rad(3.0), rng))
    config = override(bundle.settings, motion=motion)
    metrics = localize(bundle, recording, start, config, rng, NoProgress(), use_sensor).metrics()
    return {key: value for key, value in metrics.items() if isinstance(value, float)}


def build(source: str, out: Path, split: str, variant: str) -> None:
    recording = select_frames(open_recording(source), SPLITS[split][0])
    build_once(recording, bundle_path(out, split, variant), override(BuildConfig(), adapt=VARIANTS[variant]))


def run(source: str, out: Path, split: str, variant: str, motion: str, seeds: range) -> dict[str, object]:
    """Median over seeds of every figure of one row, with the spread of the position error."""
    recording = InMemory(select_frames(open_recording(source), SPLITS[split][1]))
    use_sensor = variant == SENSOR
    bundle = read_bundle(bundle_path(out, split, "unadapted" if use_sensor else variant))
    rows = [run_once(bundle, recording, motion, seed, use_sensor) for seed in seeds]
    figures: dict[str, object] = {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
    medians = [row["unseen_ate_median_m"] for row in rows]
    return {
        "split": split,
        "depth": variant,
        "motion": motion,
        "seeds": len(seeds),
        "unseen_ate_median_m_min": min(medians),
        "unseen_ate_median_m_max": max(medians),
        **figures,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("runs/redkitchen"))
    parser.add_argument("--seeds", type=int, default=10)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    source = f"7scenes:{arguments.data}/7scenes/redkitchen"
    builds = [(source, arguments.out, split, variant) for variant in reversed(VARIANTS) for split in SPLITS]
    with ProcessPoolExecutor(2) as pool:
        list(pool.map(build, *zip(*builds, strict=True)))
    jobs = [
        (source, arguments.out, split, variant, motion, range(arguments.seeds))
        for split in SPLITS
        for variant in (SENSOR, *VARIANTS)
        for motion in ("visual", "random-walk")
    ]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(run, *zip(*jobs, strict=True)))
    (arguments.out / "table.json").write_text(json.dumps(rows, indent=1))
    print("| split | depth | motion | median (seeds) | RMSE | rotation | AbsRel | odometry alone RMSE | ms |")
    print("|---|---|---|---|---|---|---|---|---|")
    for row in rows:
        cm = {key: 100.0 * value for key, value in row.items() if isinstance(value, float)}
        alone = f"{cm['unseen_odometry_ate_rmse_m']:.1f} cm" if "unseen_odometry_ate_rmse_m" in row else ""
        print(
            f"| {row['split']} | {row['depth']} | {row['motion']} | {cm['unseen_ate_median_m']:.1f} cm "
            f"({cm['unseen_ate_median_m_min']:.1f}-{cm['unseen_ate_median_m_max']:.1f}) "
            f"| {cm['unseen_ate_rmse_m']:.1f} cm | {row['unseen_rot_median_deg']:.1f}° "
            f"| {cm['unseen_depth_absrel']:.1f} % | {alone} | {row['step_ms_median']:.1f} |"
        )


if __name__ == "__main__":
    main()
