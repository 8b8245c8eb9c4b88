"""From the paper's method to the default, one addition a step: errors of every rung, and the gain of each step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.viz.picture import BLUE, GREEN, ORANGE, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.drawing import legend_below, logarithmic
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import FROM_SAME_START, MEDIAN, RMSE, ROTATION, network_of
from monoloc_lab.experiments.interval import (
    CONFIDENCE,
    Interval,
    interval_of,
    medians_of_builds,
    ratios_of_builds,
    step_of,
)
from monoloc_lab.experiments.rungs import PAIRS, RUNGS, Rung, all_rungs
from monoloc_lab.experiments.study import AS_RECORDED, EvalRecording, Study
from monoloc_lab.experiments.task import Result, Results, Task

FLIGHTS = 2
"""Flights of a build; they differ in the start, by seed."""

Row = dict[str, Any]
"""One flight: ``room``, ``split``, ``rung``, ``build_seed``, ``flight``, errors in centimetres, and commits."""

# Columns: the figure of a run, and the factor to the column's unit.
_COLUMNS = {
    "frames": ("unseen_frames", 1),
    "median_cm": (MEDIAN, 100.0),
    "rmse_cm": (RMSE, 100.0),
    "largest_cm": ("unseen_ate_max_m", 100.0),
    "rotation_median_deg": (ROTATION, 1.0),
    "coverage_95": ("unseen_coverage_95", 1.0),
    "odometry_rmse_cm": (FROM_SAME_START, 100.0),
    "silent_30cm": ("unseen_silent_frames_30cm", 1),
    "silent_3_5_sigma": ("unseen_silent_frames_3_5_sigma", 1),
    "depth_absrel": ("unseen_depth_absrel", 1.0),
}


@dataclass(frozen=True)
class _Flight:
    split: str
    rung: Rung
    build_seed: int
    flight: int
    task: Task


def stretches(study: Study) -> dict[str, EvalRecording]:
    """What a room built from the first split is flown on, by name.

    A recording: the frames between those of the build, and those after them. The rendered room: a second flight in
    every light.
    """
    split = study.splits[0]
    if AS_RECORDED not in split.recordings:
        return {f"{split.name}, {light}": recording for light, recording in split.recordings.items()}
    start, stop, _ = split.frames.split(":")
    return {
        "interpolation": EvalRecording(split.source, f"{start}:{stop}", None),
        "extrapolation": split.recordings[AS_RECORDED],
    }


def _flights(study: Study) -> Iterator[_Flight]:
    split, network = study.splits[0], network_of(study.sizes[0])
    for build in range(study.builds):
        for rung in all_rungs():
            bundle = factories.built(split, network, rung.build, build)
            for name, recording in stretches(study).items():
                for flight in range(FLIGHTS):
                    task = factories.run(bundle, recording, flight, without=rung.without)
                    yield _Flight(name, rung, build, flight, task)


def tasks(study: Study) -> Sequence[Task]:
    return [flight.task for flight in _flights(study)]


def rows_of(study: Study, results: Results) -> list[Row]:
    """Of the flights that have a result."""
    return [
        _row(study, flight, results[flight.task], results[flight.task.needs[0]])
        for flight in _flights(study)
        if flight.task in results
    ]


def _row(study: Study, flight: _Flight, run: Result, bundle: Result) -> Row:
    figures = {name: run.figures.get(figure) for name, (figure, _) in _COLUMNS.items()}
    return {
        "room": study.title,
        "split": flight.split,
        "rung": flight.rung.name,
        "build_seed": flight.build_seed,
        "flight": flight.flight,
        **{name: None if value is None else round(_COLUMNS[name][1] * value, 4) for name, value in figures.items()},
        "tracking": round(run.figures["states"].get("tracking", 0) / run.figures["frames"], 4),
        "known_bias_used": bundle.figures["known_bias_used"],
        "bundle_commit": bundle.commit,
        "flight_commit": run.commit,
    }


def ratio(rows: Sequence[Row], split: str, rung: str, other: str) -> Interval | None:
    """RMSE of a method over that of another, build by build; None without a build that both have."""
    shared = ratios_of_builds(*(medians_of_builds(rows, "rmse_cm", split=split, rung=name) for name in (rung, other)))
    return interval_of(shared) if shared else None


_APART = 0.26  # of the splits' points, in rows of the picture


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    rows = rows_of(study, results)
    tables: dict[str, tuple[Sequence[str], Sequence[Sequence[str]]]] = {}
    for split in stretches(study):
        tables[f"The ladder, {split}"] = (LADDER_HEAD, ladder_table(rows, split))
        tables[f"Pairs that differ in one thing, {split}"] = (PAIRS_HEAD, pairs_table(rows, split))
    text = (
        f"{study.builds} builds, {FLIGHTS} flights each, starts 10 cm and 3° off; frames of the build are left "
        f"out. Medians over builds of the median over flights, with the {100 * CONFIDENCE:.0f} % bootstrap interval "
        "over builds; fewer than three builds have none, and decide nothing. The step is the RMSE over that of the "
        "row above."
    )
    return Drawn(numbers={"rows": rows}, pictures=[_draw(study, rows, folder)], tables=tables, text=text)


def _draw(study: Study, rows: Sequence[Row], folder: Path) -> Path:
    """RMSE of every rung, a point a build; rungs go down, splits are colours."""
    path = folder / "ladder.png"
    with picture(path, 8.0, 0.9 + 0.34 * len(RUNGS)) as figure:
        axis = figure.subplots()
        for number, (split, colour) in enumerate(zip(stretches(study), (BLUE, ORANGE, GREEN), strict=False)):
            shift = _APART * (number - 0.5)  # so that no point hides another
            found = [
                (index + shift, medians_of_builds(rows, "rmse_cm", split=split, rung=rung.name))
                for index, rung in enumerate(RUNGS)
            ]
            line = [(float(np.median([*each.values()])), index) for index, each in found if each]
            axis.plot(*np.transpose(line), color=colour, linewidth=1.0, alpha=0.5)
            points = [(value, index) for index, each in found for value in each.values()]
            axis.plot(*np.transpose(points), "o", color=colour, markeredgecolor="white", markersize=7, label=split)
        axis.set_yticks(range(len(RUNGS)), [rung.name for rung in RUNGS])
        axis.invert_yaxis()
        axis.grid(axis="x", alpha=0.3)
        axis.set(xscale="log", xlabel="position RMSE (cm), a point a build")
        logarithmic(axis.xaxis)
        axis.set_title(f"{study.title}: from the paper's method to the default")
        legend_below(figure, [axis], 3)
    return path


LADDER_HEAD = ("method", "median cm", "RMSE cm", "rotation °", "AbsRel %", "coverage 95 %", "step", "", "builds")
PAIRS_HEAD = ("first", "RMSE cm", "second", "RMSE cm", "second / first", "", "builds")


# Columns of the table: the factor to its unit, and digits.
_SHOWN = {
    "median_cm": (1.0, 1),
    "rmse_cm": (1.0, 1),
    "rotation_median_deg": (1.0, 1),
    "depth_absrel": (100.0, 1),
    "coverage_95": (1.0, 2),
}


def _cells(rows: Sequence[Row], split: str, rung: str) -> list[str]:
    cells = []
    for column, (factor, digits) in _SHOWN.items():
        values = list(medians_of_builds(rows, column, split=split, rung=rung).values())
        cells.append(interval_of(values).text(factor, digits) if values else "–")
    return cells


def ladder_table(rows: Sequence[Row], split: str) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    for index, rung in enumerate(RUNGS):
        step = ratio(rows, split, rung.name, RUNGS[index - 1].name) if index else None
        decided = ("", "") if step is None else (step.text(digits=2), step_of(step))
        builds = len(medians_of_builds(rows, "rmse_cm", split=split, rung=rung.name))
        found.append((rung.name, *_cells(rows, split, rung.name), *decided, str(builds)))
    return found


def pairs_table(rows: Sequence[Row], split: str) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = []
    for first, second in PAIRS:
        compared = ratio(rows, split, second.name, first.name)
        if compared is None:
            continue
        errors = [_cells(rows, split, rung.name)[1] for rung in (first, second)]
        decided = compared.text(digits=2), step_of(compared), str(compared.builds)
        found.append((first.name, errors[0], second.name, errors[1], *decided))
    return found


FIGURE = Figure("ladder", "From the paper's method to the default", None, tasks, draw, on_request=True)
