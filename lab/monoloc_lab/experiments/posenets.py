"""PoseNets that were trained with and without darkened images, in every light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.viz.picture import GREY, VERMILION, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.drawing import draw_points, legend_below, logarithmic
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import BRIGHT, DARK, MEDIAN, RMSE, ROTATION, compared_lights
from monoloc_lab.experiments.interval import CONFIDENCE, Interval, interval_of, ratios_of_builds
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task

_TRAINED = {True: "with darkened images", False: "without darkened images"}

Row = dict[str, Any]
"""One flight: ``room``, ``darkened``, ``size``, ``light``, ``seed``, its errors, and the commits of both."""


@dataclass(frozen=True)
class _Flight:
    darkened: bool
    size: str
    light: str
    seed: int
    task: Task


def tasks(study: Study) -> Sequence[Task]:
    return [flight.task for flight in _flights(study)]


def _flights(study: Study) -> Iterator[_Flight]:
    """Of the first split, in the usual light, L1 and L3."""
    split = study.splits[0]
    for seed in range(study.seeds):
        for size in study.sizes:
            for darkened in _TRAINED:
                posenet = factories.posenet(study, split, size, seed, darkened=darkened)
                for light in compared_lights(split):
                    task = factories.posenet_run(posenet, split.recordings[light])
                    yield _Flight(darkened, size, light, seed, task)


def rows_of(study: Study, results: Results) -> list[Row]:
    """Of the flights that have a result."""
    rows = []
    for flight in _flights(study):
        if flight.task not in results:
            continue
        run = results[flight.task]
        rows.append(
            {
                "room": study.title,
                "darkened": flight.darkened,
                "size": flight.size,
                "light": flight.light,
                "seed": flight.seed,
                "rmse_cm": round(100.0 * run.figures[RMSE], 4),
                "median_cm": round(100.0 * run.figures[MEDIAN], 4),
                "rotation_median_deg": round(run.figures[ROTATION], 4),
                "training_commit": results[flight.task.needs[0]].commit,
                "flight_commit": run.commit,
            }
        )
    return rows


def in_the_dark(rows: Sequence[Row], darkened: bool, size: str) -> Interval:
    """RMSE in L3 over that in L1, seed by seed, of the rows of one room."""
    dark, bright = (_errors(rows, darkened, size, light) for light in (DARK, BRIGHT))
    return interval_of(ratios_of_builds(dark, bright))


def _errors(rows: Sequence[Row], darkened: bool, size: str, light: str) -> dict[int, float]:
    """Position RMSE of each seed, cm."""
    wanted = {"darkened": darkened, "size": size, "light": light}
    return {row["seed"]: row["rmse_cm"] for row in rows if wanted.items() <= row.items()}


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    rows, split = rows_of(study, results), study.splits[0]
    table = [
        (
            size,
            text,
            *(
                interval_of(list(_errors(rows, darkened, size, light).values())).text()
                for light in compared_lights(split)
            ),
            in_the_dark(rows, darkened, size).text(digits=2),
        )
        for size in study.sizes
        for darkened, text in _TRAINED.items()
    ]
    return Drawn(
        numbers={"rows": rows},
        pictures=[_draw(study, rows, folder)],
        tables={
            "PoseNet, RMSE in cm": (("size", "trained", *compared_lights(split), f"{DARK} over {BRIGHT}"), table)
        },
        text=(
            f"{study.seeds} trainings, {split.name}, every frame by itself. Medians over trainings with the "
            f"{100 * CONFIDENCE:.0f} % bootstrap interval."
        ),
    )


def _draw(study: Study, rows: Sequence[Row], folder: Path) -> Path:
    """RMSE in every light, a point a training: a panel a size."""
    path, lights = folder / "posenets.png", compared_lights(study.splits[0])
    with picture(path, max(5.0, 3.6 * len(study.sizes)), 3.6) as figure:
        axes = figure.subplots(1, len(study.sizes), sharey=True, squeeze=False)[0]
        for axis, size in zip(axes, study.sizes, strict=True):
            series = {
                _TRAINED[darkened]: (
                    colour,
                    [list(_errors(rows, darkened, size, light).values()) for light in lights],
                )
                for darkened, colour in ((False, GREY), (True, VERMILION))
            }
            draw_points(axis, size, lights, series)
        logarithmic(axes[0].yaxis)
        axes[0].set_ylabel("position RMSE (cm), a point a training")
        legend_below(figure, list(axes), 2)
    return path


FIGURE = Figure("posenets", "PoseNet, with and without darkened images", None, tasks, draw, on_request=True)
