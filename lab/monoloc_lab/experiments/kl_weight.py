"""Position error by lambda, the weight of the divergence from the original map, over five decades."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.adapt.settings import AdaptConfig
from monoloc.viz.picture import BLUE, GREEN, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.drawing import legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import RMSE, Spread, network_of, spread_of, usual_recording
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.sweep import draw_sweep, least, mark_default, row_of
from monoloc_lab.experiments.task import Results, Task

_LAMBDAS = (1e-3, 1e-2, 1e-1, 1.0, 10.0, 100.0)
_VARIANTS = {"last+map": ("last layer and map", GREEN), "joint": ("network and map", BLUE)}
_SHIFT = "shift_median_m"


def _bundle(study: Study, variant: str, value: float) -> Task:
    return factories.bundle(study, study.splits[0], network_of(study.sizes[0]), variant, lambda_kl=value)


def _runs(study: Study, variant: str, value: float) -> list[Task]:
    return factories.run_seeds(study, _bundle(study, variant, value), usual_recording(study.splits[0]))


def tasks(study: Study) -> Sequence[Task] | None:
    if study.quick:
        return None
    return [task for variant in _VARIANTS for value in _LAMBDAS for task in _runs(study, variant, value)]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {"default": AdaptConfig().lambda_kl}
    rows = []
    errors: dict[str, dict[float, Spread]] = {}
    shifts: dict[str, dict[float, Spread]] = {}
    for variant, (name, _) in _VARIANTS.items():
        errors[variant], shifts[variant], numbers[variant] = {}, {}, {}
        for value in _LAMBDAS:
            error = spread_of(results, _runs(study, variant, value), RMSE)
            shift = spread_of(results, [_bundle(study, variant, value)], _SHIFT)
            errors[variant][value], shifts[variant][value] = error, shift
            numbers[variant][f"{value:g}"] = {RMSE: error.numbers(), _SHIFT: shift.median}
            rows.append(row_of((name, f"{value:g}"), error, shift))
    path = folder / "lambda.png"
    with picture(path, 9.6, 4.4) as figure:
        axes = list(figure.subplots(1, 2))
        for variant, (name, colour) in _VARIANTS.items():
            draw_sweep(axes[0], name, colour, errors[variant])
            # A logarithmic axis has no zero.
            moved = {value: shift for value, shift in shifts[variant].items() if shift.median > 0.0}
            draw_sweep(axes[1], name, colour, moved)
        for axis in axes:
            mark_default(axis, numbers["default"])
            axis.set_xticks(_LAMBDAS, [f"{value:g}" for value in _LAMBDAS])
            axis.set_xlabel("lambda")
        axes[0].set(ylabel="position RMSE (cm)")
        axes[0].set_title("Position error")
        axes[1].set(ylabel="median shift of components (cm)")
        axes[1].set_title("Shift of the map")
        legend_below(figure, axes, 2)
    text = (
        "Lambda weighs the divergence between original and adapted map; one build each. The smallest RMSE is at "
        f"lambda {least(errors['last+map']):g} with the last layer tuned, and at {least(errors['joint']):g} with the "
        f"network tuned. The default is {numbers['default']:g}."
    )
    head = ("tuned", "lambda", "RMSE", "median shift")
    return Drawn(
        numbers=numbers,
        pictures=[path],
        tables={"Errors by lambda (median over seeds; smallest to largest)": (head, rows)},
        text=text,
    )


FIGURE = Figure("lambda", "Weight of the divergence", None, tasks, draw)
