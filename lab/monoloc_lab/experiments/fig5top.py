"""The room and its predicted depth in every light (figure 5 of the paper, top)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.viz.picture import picture
from monoloc_lab.experiments.drawing import show_image
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    DARK,
    and_list,
    depth_arrays,
    depth_task,
    frame_depth,
    mean_depth,
    network_of,
    shown_frames,
)
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task

_KINDS, _METRICS = ("unadapted", "adapted"), ("absrel", "delta1", "ssim")
_PLACE = 0  # the first of the plotted frames


def depths_in_light(study: Study) -> dict[str, tuple[Task, Task]]:
    """Unadapted and adapted depth of the largest network in the first split, by light."""
    split = study.splits[0]
    bundle = bundle_of(study, split, study.sizes[0], "joint")
    return {
        light: (depth_task(network_of(study.sizes[0]), recording), depth_task(bundle, recording))
        for light, recording in split.recordings.items()
    }


def tasks(study: Study) -> Sequence[Task]:
    return [task for pair in depths_in_light(study).values() for task in pair]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    split, pairs = study.splits[0], depths_in_light(study)
    numbers: dict[str, Any] = {}
    for light, pair in pairs.items():
        numbers[light] = {
            kind: {
                **{name: mean_depth(results[task], split, split.recordings[light], name) for name in _METRICS},
                "shown": frame_depth(results[task], shown_frames(split.recordings[light])[_PLACE]),
            }
            for kind, task in zip(_KINDS, pair, strict=True)
        }
    path = folder / "fig5top.png"
    files = {light: [depth_arrays(results[task]) for task in pair] for light, pair in pairs.items()}
    first = next(iter(files.values()))[0]
    truth = first["truth"][_PLACE]
    near_m, far_m = (float(value) for value in np.percentile(truth[truth > 0.0], [1.0, 99.0]))
    style: dict[str, Any] = {"cmap": "viridis", "vmin": near_m, "vmax": far_m}
    height, width = first["color"].shape[1:3]
    cell_in = min(3.2, 11.0 / len(pairs))
    with picture(path, cell_in * len(pairs), 3 * cell_in * height / width + 1.9) as figure:
        grid = figure.subplots(3, len(pairs), squeeze=False)
        for column, light in enumerate(pairs):
            dark = float(np.mean(files[light][0]["color"][_PLACE]))
            show_image(grid[0, column], files[light][0]["color"][_PLACE], f"{light}  (mean grey {dark:.0f} of 255)")
            for row, (kind, file) in enumerate(zip(_KINDS, files[light], strict=True), start=1):
                share = 100.0 * numbers[light][kind]["shown"]["absrel"]
                title = f"depth, {kind}: {share:.0f} % error"
                depth = show_image(grid[row, column], file["predicted"][_PLACE], title, **style)
        figure.colorbar(depth, ax=grid, location="bottom", label="depth (m)", extend="both", shrink=0.4, aspect=50)
    return Drawn(numbers=numbers, pictures=[path], text=_text(study, numbers))


def _text(study: Study, numbers: dict[str, Any]) -> str:
    listed = [
        f"{100.0 * kinds['unadapted']['absrel']:.0f} % and {100.0 * kinds['adapted']['absrel']:.0f} % ({light})"
        for light, kinds in numbers.items()
    ]
    rendered = all(recording.light is None for recording in study.splits[0].recordings.values())
    made = "rendered in that light" if rendered else "with that light simulated on the recorded image"
    return (
        f"One frame in every light, {made}; {DARK} is near darkness. Mean relative error of the depth of "
        f"{network_of(study.sizes[0])}, unadapted and adapted: {and_list(listed)}."
    )


FIGURE = Figure("fig5top", "The room in each light", "Figure 5, top", tasks, draw)
