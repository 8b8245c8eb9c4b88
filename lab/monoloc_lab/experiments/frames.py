"""Position error by the number of build frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import BLUE, ORANGE, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    MEDIAN,
    RMSE,
    Spread,
    frames_of,
    network_of,
    spread_of,
    usual_recording,
)
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.sweep import draw_sweep, row_of
from monoloc_lab.experiments.task import Results, Task

_COUNTS = (5, 10, 25, 50, 100)
_VARIANTS = {"unadapted": ("unadapted", ORANGE), "joint": ("network and map", BLUE)}


def _counts(study: Study) -> list[int]:
    return [count for count in _COUNTS if count <= _available(study)]


def _available(study: Study) -> int:
    return len(frames_of(study.splits[0].source, study.splits[0].frames))


def _runs(study: Study, variant: str, count: int) -> list[Task]:
    split = study.splits[0]
    frames = None if count == _available(study) else count  # with all frames, the bundle of the other figures
    bundle = factories.bundle(study, split, network_of(study.sizes[0]), variant, frames=frames)
    return factories.run_seeds(study, bundle, usual_recording(split))


def tasks(study: Study) -> Sequence[Task] | None:
    if study.quick:
        return None
    return [task for variant in _VARIANTS for count in _counts(study) for task in _runs(study, variant, count)]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    rows = []
    errors: dict[str, dict[float, Spread]] = {}
    for variant, (name, _) in _VARIANTS.items():
        errors[variant], numbers[variant] = {}, {}
        for count in _counts(study):
            runs = _runs(study, variant, count)
            rmse, median = spread_of(results, runs, RMSE), spread_of(results, runs, MEDIAN)
            errors[variant][count] = rmse
            numbers[variant][str(count)] = {RMSE: rmse.numbers(), MEDIAN: median.numbers()}
            rows.append(row_of((name, str(count)), rmse, median))
    path = folder / "frames.png"
    with picture(path, 7.5, 4.6) as figure:
        axis = figure.subplots()
        for variant, (name, colour) in _VARIANTS.items():
            draw_sweep(axis, name, colour, errors[variant])
        axis.set_xticks(_counts(study), [str(count) for count in _counts(study)])
        axis.set(xlabel="build frames", ylabel="position RMSE (cm)")
        axis.set_title(f"Number of build frames, {study.splits[0].name}, {study.sizes[0]}")
        axis.legend(loc="best")
    return Drawn(
        numbers=numbers,
        pictures=[path],
        tables={
            "Errors by number of build frames (median over seeds; smallest to largest)": (
                ("tuned", "frames", "RMSE", "median"),
                rows,
            )
        },
        text=_text(errors["joint"]),
    )


def _text(errors: dict[float, Spread]) -> str:
    most = max(errors)
    enough = min(count for count, spread in errors.items() if spread.median <= 1.25 * errors[most].median)
    return (
        "Map and network from evenly spaced frames of the build recording, one build each. The RMSE is "
        f"{errors[most].centimetres()} with {most} frames, and {errors[enough].centimetres()} with {enough}, the "
        "smallest number within a quarter of that."
    )


FIGURE = Figure("frames", "Number of build frames", None, tasks, draw)
