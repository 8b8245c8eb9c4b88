"""Errors by what adaptation tunes: every network, variant and split."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import BLUE, GREEN, ORANGE, PURPLE, SKY, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.drawing import Series, draw_ranges, legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    MEDIAN,
    RMSE,
    ROTATION,
    Spread,
    depth_of_variant,
    in_split,
    mean_depth,
    picture_path,
    size_labels,
    spread_of,
    usual_recording,
)
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_NAMES = {
    "unadapted": ("nothing", ORANGE),
    "last": ("last layer", PURPLE),
    "map": ("map", SKY),
    "last+map": ("last layer and map", GREEN),
    "joint": ("network and map", BLUE),
}


def _variants(study: Study) -> list[str]:
    """Variants; a quick study leaves out those that no other figure needs."""
    return [name for name in _NAMES if not study.quick or name in ("unadapted", "last+map", "joint")]


def _runs(study: Study, split: Split, size: str, variant: str) -> list[Task]:
    seeds, recording = range(study.seeds), usual_recording(split)
    return [factories.run(bundle_of(study, split, size, variant, seed), recording, seed) for seed in seeds]


def _depth(study: Study, split: Split, size: str, variant: str) -> Task:
    return depth_of_variant(variant, bundle_of(study, split, size, variant), usual_recording(split))


def tasks(study: Study) -> Sequence[Task]:
    each = [(split, size, name) for split in study.splits for size in study.sizes for name in _variants(study)]
    return [task for one in each for task in (*_runs(study, *one), _depth(study, *one))]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, rows, sentences = [], [], []
    for split in study.splits:
        medians: dict[str, dict[str, Spread]] = {name: {} for name in _variants(study)}
        numbers[split.name] = {name: {} for name in medians}
        recording = usual_recording(split)
        for size in study.sizes:
            for name in medians:
                runs = _runs(study, split, size, name)
                error, rmse, turn = (spread_of(results, runs, figure) for figure in (MEDIAN, RMSE, ROTATION))
                depth = results[_depth(study, split, size, name)]
                absrel, ssim = (mean_depth(depth, split, recording, metric) for metric in ("absrel", "ssim"))
                medians[name][size] = error
                numbers[split.name][name][size] = {
                    MEDIAN: error.numbers(),
                    RMSE: rmse.numbers(),
                    ROTATION: turn.numbers(),
                    "absrel": absrel,
                    "ssim": ssim,
                }
                angle = f"{turn.median:.1f}°"
                label = _NAMES[name][0]
                found = (error.centimetres(), rmse.centimetres(), angle, f"{absrel:.3f}", f"{ssim:.3f}")
                rows.append((split.name, size, label, *found))
        pictures.append(_draw(study, split, medians, folder))
        sentences.append(_sentence(study, split, medians))
    head = ("split", "size", "tuned", "median", "RMSE", "rotation", "AbsRel", "SSIM")
    return Drawn(
        numbers=numbers,
        pictures=pictures,
        tables={
            "Errors by what is tuned, in the light of the build frames (median over seeds; smallest to largest)": (
                head,
                rows,
            )
        },
        text=" ".join(sentences),
    )


def _draw(study: Study, split: Split, medians: dict[str, dict[str, Spread]], folder: Path) -> Path:
    path = picture_path(study, folder, "variants", split)
    series = [Series(*_NAMES[name], [sizes[size] for size in study.sizes]) for name, sizes in medians.items()]
    with picture(path, 3.5 + 1.8 * len(study.sizes), 4.8) as figure:
        axis = figure.subplots()
        draw_ranges(axis, size_labels(study), series)
        axis.set_ylabel("median position error (cm)")
        axis.set_title(f"Position error by what is tuned{in_split(study, split)}")
        legend_below(figure, [axis], 3)
    return path


def _sentence(study: Study, split: Split, medians: dict[str, dict[str, Spread]]) -> str:
    size = study.sizes[0]
    least = min(medians, key=lambda name: medians[name][size].median)
    return (
        f"{split.name.capitalize()}, {size}: the median error is {medians['unadapted'][size].centimetres()} with "
        f"the untuned bundle, {medians['last+map'][size].centimetres()} with the last layer and the map (the paper's "
        f"variant), and {medians['joint'][size].centimetres()} with network and map (monoloc's default). It is "
        f"smallest with {_NAMES[least][0]}."
    )


FIGURE = Figure("variants", "What is tuned", None, tasks, draw)
