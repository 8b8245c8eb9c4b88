"""Position error by the bytes of the map: mixtures, voxels and points of one room, with one network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from monoloc.viz.picture import BLUE, ORANGE, VERMILION, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.drawing import legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import MEDIAN, RMSE, Spread, spread_of, usual_recording
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.sweep import draw_sweep, least
from monoloc_lab.experiments.task import Results, Task

_Kind = Literal["mixture", "voxels", "points"]
_SIZES: dict[_Kind, tuple[float, ...]] = {
    "mixture": (25, 50, 100, 200, 400, 800),
    "voxels": (0.4, 0.2, 0.1, 0.05),
    "points": (0.4, 0.2, 0.1, 0.05),
}
_STYLES: dict[_Kind, tuple[str, str, str]] = {
    "mixture": ("Gaussian mixture (K components)", BLUE, "o"),
    "voxels": ("occupied voxels, as an octree (edge)", ORANGE, "s"),
    "points": ("points (spacing)", VERMILION, "D"),
}
_LABELS: dict[_Kind, int] = {"mixture": 7, "voxels": -14, "points": 7}  # points above or below the bars


def _map(study: Study, kind: _Kind, size: float) -> Task:
    return factories.remapped(bundle_of(study, study.splits[0], study.sizes[0], "network"), kind, size)


def _runs(study: Study, kind: _Kind, size: float) -> list[Task]:
    return factories.run_seeds(study, _map(study, kind, size), usual_recording(study.splits[0]))


def tasks(study: Study) -> Sequence[Task] | None:
    if study.quick:
        return None
    return [task for kind, sizes in _SIZES.items() for size in sizes for task in _runs(study, kind, size)]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    rows = []
    points: dict[_Kind, dict[float, Spread]] = {}
    for kind, sizes in _SIZES.items():
        numbers[kind], points[kind] = [], {}
        for size in sizes:
            stored = results[_map(study, kind, size)].figures
            runs = _runs(study, kind, size)
            rmse, median = spread_of(results, runs, RMSE), spread_of(results, runs, MEDIAN)
            points[kind][stored["map_bytes"]] = rmse
            numbers[kind].append(
                {
                    "size": size,
                    "components": stored["components"],
                    "map_bytes": stored["map_bytes"],
                    RMSE: rmse.numbers(),
                    MEDIAN: median.numbers(),
                }
            )
            amount = f"{stored['map_bytes'] / 1e3:.1f} kB"
            found = (rmse.centimetres(), median.centimetres())
            rows.append((_STYLES[kind][0], _size_label(kind, size), f"{stored['components']:,}", amount, *found))
    path = folder / "map-size.png"
    with picture(path, 9.0, 5.0) as figure:
        axis = figure.subplots()
        for kind, (name, colour, marker) in _STYLES.items():
            by_size = {amount / 1e3: spread for amount, spread in points[kind].items()}
            draw_sweep(axis, name, colour, by_size, marker=marker)
            for size, (amount_kb, spread) in zip(_SIZES[kind], by_size.items(), strict=True):
                # At the end of the bar, off the lines.
                smallest, largest = spread.range
                at = (amount_kb, 100.0 * (largest if _LABELS[kind] > 0 else smallest))
                axis.annotate(
                    _size_label(kind, size),
                    at,
                    (0, _LABELS[kind]),
                    textcoords="offset points",
                    ha="center",
                    fontsize=8,
                    color=colour,
                )
        axis.margins(y=0.1)
        axis.set(xlabel="size of the map (kB)", ylabel="position RMSE (cm)")
        axis.set_title(f"Size of the map against accuracy, {study.splits[0].name}, {study.sizes[0]}")
        legend_below(figure, [axis], 3)
    head = ("map", "size", "components", "bytes", "RMSE", "median")
    return Drawn(
        numbers=numbers,
        pictures=[path],
        tables={"Maps of one room with one network (median over seeds; smallest to largest)": (head, rows)},
        text=_text(points),
    )


def _size_label(kind: _Kind, size: float) -> str:
    return f"K = {size:g}" if kind == "mixture" else f"{100.0 * size:g} cm"


def _text(points: dict[_Kind, dict[float, Spread]]) -> str:
    def best(kind: _Kind) -> str:
        amount = least(points[kind])
        return f"{points[kind][amount].centimetres()} with {amount / 1e3:.1f} kB"

    return (
        "The network of one build, tuned without changing the map, with maps of several kinds and sizes; the "
        "calibration is the same but for the bias at the reference poses. Smallest RMSE: mixture "
        f"{best('mixture')}, voxels {best('voxels')}, points {best('points')}."
    )


FIGURE = Figure("map-size", "Size of the map", None, tasks, draw)
