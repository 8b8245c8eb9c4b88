"""The map before and after adaptation: clouds, boxes, distances (figure 3 of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.evaluation.cloud_metrics import MapClouds
from monoloc.viz.map_drawing import plot_map_change
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.claims import map_moves_little
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    RMSE,
    Spread,
    in_split,
    network_of,
    picture_path,
    spread_of,
    usual_recording,
)
from monoloc_lab.experiments.methods import JOINT, UNADAPTED
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_VARIANTS = {"joint": "network and map", "last+map": "last layer and map"}
_MEDIAN, _P95 = "c2c_median_m", "c2c_p95_m"


def _bundles(study: Study, split: Split, variant: str) -> list[Task]:
    """Bundles of the largest network, one per build."""
    network = network_of(study.sizes[0])
    return [factories.bundle(study, split, network, variant, seed=seed) for seed in range(study.builds)]


def _clouds(study: Study, split: Split, variant: str) -> list[Task]:
    return [factories.clouds(bundle) for bundle in _bundles(study, split, variant)]


def tasks(study: Study) -> Sequence[Task]:
    each = [(split, variant) for split in study.splits for variant in _VARIANTS]
    clouds = [task for pair in each for task in (*_bundles(study, *pair), *_clouds(study, *pair))]
    return [*clouds, *(task for split in study.splits for runs in _runs(study, split) for task in runs)]


def _runs(study: Study, split: Split) -> list[list[Task]]:
    """Of the default and of the unadapted method, with the largest network."""
    recording = usual_recording(split)
    return [method.runs(study, split, study.sizes[0], recording) for method in (JOINT, UNADAPTED)]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, rows, claims, sentences = [], [], [], []
    for split in study.splits:
        numbers[split.name] = {}
        for variant, name in _VARIANTS.items():
            clouds, built = _clouds(study, split, variant), _bundles(study, split, variant)
            median, p95 = spread_of(results, clouds, _MEDIAN), spread_of(results, clouds, _P95)
            before = spread_of(results, built, "depth_absrel_before")
            unchanged = spread_of(results, clouds, "correspondence_share")
            numbers[split.name][variant] = {
                _MEDIAN: median.numbers(),
                _P95: p95.numbers(),
                "depth_absrel_before": before.numbers(),
                "correspondence_share": unchanged.numbers(),
            }
            share = f"{100.0 * unchanged.median:.0f} %"
            rows.append((split.name, name, median.centimetres(), p95.centimetres(), share, str(len(clouds))))
            if variant == "joint":
                title = f"Original and adapted map{in_split(study, split)}: {name}"
                pictures.append(_draw(study, results[clouds[0]].folder, folder, split, title))
                adapted, unadapted = (spread_of(results, runs, RMSE) for runs in _runs(study, split))
                network, gain = network_of(study.sizes[0]), adapted / unadapted
                claims.append(map_moves_little(split.name, network, median, before, gain, study.builds))
                sentences.append(_sentence(split, median, p95))
    head = ("split", "tuned", "median C2C", "95th percentile", "unchanged correspondence", "builds")
    return Drawn(
        numbers=numbers,
        pictures=pictures,
        tables={"Distance between original and adapted map (median over builds; smallest to largest)": (head, rows)},
        text=" ".join(sentences),
        claims=claims,
    )


def _draw(study: Study, source: Path, folder: Path, split: Split, title: str) -> Path:
    path = picture_path(study, folder, "fig3", split)
    with np.load(source / "clouds.npz") as arrays:
        original, adapted, distances_m, down = (
            np.asarray(arrays[name], dtype=np.float64)
            for name in ("original", "adapted", "distances_m", "down_world")
        )
    plot_map_change(path, MapClouds(original, adapted, distances_m), down, title)
    return path


def _sentence(split: Split, median: Spread, p95: Spread) -> str:
    return (
        f"{split.name.capitalize()}: half of the points of the original map lie within "
        f"{100.0 * median.median:.1f} cm of the adapted cloud, and 95 % within {100.0 * p95.median:.1f} cm."
    )


FIGURE = Figure("fig3", "The map before and after adaptation", "Figure 3", tasks, draw)
