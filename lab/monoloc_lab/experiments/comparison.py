"""Figures that are one table: a row of errors per case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import FROM_SAME_START, MEDIAN, RMSE, ROTATION, Spread, spread_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task

COVERAGE, ABSREL, ODOMETRY_RATIO = "unseen_coverage_95", "unseen_depth_absrel", "odometry_ratio"
_COLUMNS = ("median", "RMSE", "odometry ratio", "rotation", "coverage", "AbsRel")


@dataclass(frozen=True)
class Case:
    """A row of the table.

    Attributes:
        labels: its first cells; the first is the split.
        runs: one per seed.
    """

    labels: tuple[str, ...]
    runs: Sequence[Task]


def comparison(
    name: str,
    title: str,
    head: Sequence[str],
    cases: Callable[[Study], Sequence[Case]],
    caption: Callable[[Study], str],
    text: str,
) -> Figure:
    """A figure, drawn on request, with medians over seeds of errors on unseen frames.

    The odometry ratio is the RMSE over that of odometry alone from the same start.

    Args:
        head: names of the labels.
        cases: rows of a study's table.
        caption: of that table.
        text: see :class:`monoloc_lab.experiments.figure.Drawn`.
    """

    def tasks(study: Study) -> Sequence[Task]:
        return [run for case in cases(study) for run in case.runs]

    def draw(study: Study, results: Results, folder: Path) -> Drawn:
        return _drawn(caption(study), head, cases(study), results, text)

    return Figure(name, title, None, tasks, draw, on_request=True)


def _drawn(caption: str, head: Sequence[str], cases: Sequence[Case], results: Results, text: str) -> Drawn:
    numbers, rows = [], []
    for case in cases:
        spreads = _spreads(results, case.runs)
        labels: dict[str, Any] = dict(zip(head, case.labels, strict=True))
        numbers.append(labels | {name: spread.numbers() for name, spread in spreads.items()})
        rows.append((*case.labels, *_cells(spreads)))
    return Drawn(numbers={"cases": numbers}, tables={caption: ((*head, *_COLUMNS), rows)}, text=text)


def _spreads(results: Results, runs: Sequence[Task]) -> dict[str, Spread]:
    spreads = {name: spread_of(results, runs, name) for name in (MEDIAN, RMSE, ROTATION, COVERAGE, ABSREL)}
    return spreads | {ODOMETRY_RATIO: spreads[RMSE] / spread_of(results, runs, FROM_SAME_START)}


def _cells(spreads: dict[str, Spread]) -> tuple[str, ...]:
    ratio = spreads[ODOMETRY_RATIO]
    return (
        spreads[MEDIAN].centimetres(),
        spreads[RMSE].centimetres(),
        f"{ratio.median:.2f} (worst {ratio.range[1]:.2f})" if ratio.values else "–",
        f"{spreads[ROTATION].median:.1f}°",
        f"{spreads[COVERAGE].median:.2f}",
        f"{100.0 * spreads[ABSREL].median:.1f} %" if spreads[ABSREL].values else "–",
    )
