"""Trajectories in near darkness by PoseNet, unadapted and adapted (figure 5 a of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import picture
from monoloc_lab.experiments.drawing import DrawnTrajectory, Views, draw_trajectories, legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import DARK, MEDIAN, RMSE, and_list, in_split, picture_path, room_map, trajectory
from monoloc_lab.experiments.methods import JOINT, POSENET, UNADAPTED, bundle_of
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_METHODS = (POSENET, UNADAPTED, JOINT)


def _runs(study: Study, split: Split) -> list[Task]:
    """Runs of the largest network and the first seed."""
    return [method.task(study, split, study.sizes[0], split.recordings[DARK], 0) for method in _METHODS]


def tasks(study: Study) -> Sequence[Task]:
    rooms = [bundle_of(study, split, study.sizes[0], "unadapted") for split in study.splits]
    return [*rooms, *(task for split in study.splits for task in _runs(study, split))]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, sentences = [], []
    for split in study.splits:
        found = [results[task] for task in _runs(study, split)]
        trajectories = [trajectory(result) for result in found]
        truth = trajectories[0]["truth"]
        figures = {
            method.name: {name: result.figures.get(name) for name in (RMSE, MEDIAN)}
            for method, result in zip(_METHODS, found, strict=True)
        }
        panels = {
            f"{method.name}: {_cm(figures[method.name][RMSE])}": [
                DrawnTrajectory(method.name, method.colour, arrays["poses"], points=method is POSENET)
            ]
            for method, arrays in zip(_METHODS, trajectories, strict=True)
        }
        path = picture_path(study, folder, "fig5a", split)
        views = Views.of(truth, [arrays["poses"] for arrays in trajectories])
        with picture(path, 10.5, 3.1 * views.shape + 1.6) as figure:
            figure.suptitle(f"In {DARK}{in_split(study, split)}: position RMSE", x=0.01, ha="left")
            room = room_map(results[bundle_of(study, split, study.sizes[0], "unadapted")])
            legend_below(figure, draw_trajectories(figure, panels, truth, views, room), 5)
        pictures.append(path)
        numbers[split.name] = figures
        listed = [f"{name} {_cm(each[RMSE])}" for name, each in figures.items()]
        sentences.append(f"{split.name.capitalize()}: position RMSE {and_list(listed)}.")
    text = (
        f"Trajectories in {DARK} from above and from the side, first seed. PoseNet localises every frame on its own, "
        "so its poses are points."
    )
    return Drawn(numbers=numbers, pictures=pictures, text=" ".join([text, *sentences]))


def _cm(value: float | None) -> str:
    return "no pose" if value is None else f"{100.0 * value:.0f} cm"


FIGURE = Figure("fig5a", "Trajectories in near darkness", "Figure 5 a", tasks, draw)
