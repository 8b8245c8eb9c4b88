"""Trajectories by network size, unadapted and adapted (figure 4 a and b of the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import picture
from monoloc_lab.experiments.drawing import SIZE_COLOURS, DrawnTrajectory, Views, draw_trajectories, legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import MEDIAN, RMSE, in_split, picture_path, room_map, trajectory, usual_recording
from monoloc_lab.experiments.methods import JOINT, UNADAPTED, bundle_of
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_METHODS = {"a": UNADAPTED, "b": JOINT}


def _runs(study: Study, split: Split) -> dict[tuple[str, str], Task]:
    """Runs of the first seed, by panel and size."""
    recording = usual_recording(split)
    return {
        (panel, size): method.task(study, split, size, recording, 0)
        for panel, method in _METHODS.items()
        for size in study.sizes
    }


def tasks(study: Study) -> Sequence[Task]:
    rooms = [bundle_of(study, split, study.sizes[0], "unadapted") for split in study.splits]
    return [*rooms, *(task for split in study.splits for task in _runs(study, split).values())]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, sentences = [], []
    for split in study.splits:
        runs = _runs(study, split)
        trajectories = {key: trajectory(results[task]) for key, task in runs.items()}
        truth = trajectories["a", study.sizes[0]]["truth"]
        panels = {
            f"{panel}  {method.name}{in_split(study, split)}": [
                DrawnTrajectory(size, colour, trajectories[panel, size]["poses"])
                for size, colour in zip(study.sizes, SIZE_COLOURS, strict=False)
            ]
            for panel, method in _METHODS.items()
        }
        path = picture_path(study, folder, "fig4ab", split)
        views = Views.of(truth, [arrays["poses"] for arrays in trajectories.values()])
        with picture(path, 9.6, 4.3 * views.shape + 1.4) as figure:
            room = room_map(results[bundle_of(study, split, study.sizes[0], "unadapted")])
            legend_below(figure, draw_trajectories(figure, panels, truth, views, room), 6)
        pictures.append(path)
        numbers[split.name] = {
            method.name: {size: _errors(results, runs[panel, size]) for size in study.sizes}
            for panel, method in _METHODS.items()
        }
        sentences.append(_sentence(study, split, numbers[split.name]))
    return Drawn(numbers=numbers, pictures=pictures, text=" ".join(sentences))


def _errors(results: Results, task: Task) -> dict[str, float]:
    return {name: results[task].figures[name] for name in (RMSE, MEDIAN)}


def _sentence(study: Study, split: Split, errors: dict[str, dict[str, dict[str, float]]]) -> str:
    def listed(name: str) -> str:
        return ", ".join(f"{100.0 * errors[name][size][RMSE]:.0f} cm ({size})" for size in study.sizes)

    return (
        "Trajectories from above and from the side, over the components of the map; first seed, light of the build "
        f"frames, {split.name}. Position RMSE: {UNADAPTED.name} {listed(UNADAPTED.name)}; {JOINT.name} "
        f"{listed(JOINT.name)}."
    )


FIGURE = Figure("fig4ab", "Trajectories by network size", "Figure 4 a, b", tasks, draw)
