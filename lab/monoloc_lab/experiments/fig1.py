"""Depth of every network size, unadapted and adapted (figure 1 of the paper, right)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.viz.picture import picture
from monoloc_lab.experiments.drawing import show_image
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    depth_arrays,
    depth_task,
    frame_depth,
    in_split,
    network_of,
    parameters_of,
    usual_recording,
)
from monoloc_lab.experiments.methods import bundle_of
from monoloc_lab.experiments.study import Study
from monoloc_lab.experiments.task import Results, Task


def _pairs(study: Study) -> list[tuple[Task, Task]]:
    """Unadapted and adapted depth of every size, in the first split."""
    split = study.splits[0]
    recording = usual_recording(split)
    return [
        (depth_task(network_of(size), recording), depth_task(bundle_of(study, split, size, "joint"), recording))
        for size in study.sizes
    ]


def tasks(study: Study) -> Sequence[Task]:
    return [task for pair in _pairs(study) for task in pair]


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    pairs = _pairs(study)
    files = [[depth_arrays(results[task]) for task in pair] for pair in pairs]
    first = files[0][0]
    shown = [int(index) for index in first["index"]]
    truth = np.where(first["truth"] > 0.0, first["truth"], np.nan)
    near_m, far_m = (float(value) for value in np.nanpercentile(truth, [1.0, 99.0]))
    style: dict[str, Any] = {"cmap": "viridis", "vmin": near_m, "vmax": far_m}

    numbers: dict[str, Any] = {"frames": shown, "depth_range_m": [near_m, far_m], "networks": {}}
    for size, pair in zip(study.sizes, pairs, strict=True):
        numbers["networks"][network_of(size)] = {
            kind: [frame_depth(results[task], index) for index in shown]
            for kind, task in zip(("unadapted", "adapted"), pair, strict=True)
        }

    height, width = first["color"].shape[1:3]
    columns = 1 + len(pairs)
    cell_in = min(2.8, 11.0 / columns)
    rows = 2 * len(shown)
    path = folder / "fig1.png"
    with picture(path, cell_in * columns, cell_in * height / width * rows + 0.26 * rows + 0.9) as figure:
        grid = figure.subplots(rows, columns, squeeze=False)
        for place, index in enumerate(shown):
            above, below = grid[2 * place : 2 * place + 2]
            show_image(above[0], first["color"][place], f"camera, frame {index}")
            depth = show_image(below[0], truth[place], "depth sensor", **style)
            for column, (size, pair_files) in enumerate(zip(study.sizes, files, strict=True), start=1):
                for row, name, file in zip((above, below), ("unadapted", "adapted"), pair_files, strict=True):
                    share = 100.0 * numbers["networks"][network_of(size)][name][place]["absrel"]
                    show_image(row[column], file["predicted"][place], f"{size}, {name}: {share:.0f} % error", **style)
        figure.colorbar(depth, ax=grid, location="bottom", label="depth (m)", extend="both", shrink=0.4, aspect=50)
    return Drawn(numbers=numbers, pictures=[path], text=_text(study, numbers))


def _text(study: Study, numbers: dict[str, Any]) -> str:
    def mean(size: str, kind: str) -> float:
        return 100.0 * float(np.mean([frame["absrel"] for frame in numbers["networks"][network_of(size)][kind]]))

    large, small = study.sizes[0], study.sizes[-1]
    split = study.splits[0]
    return (
        f"Two frames{in_split(study, split)} in the light of the build frames; no network was tuned on them. The "
        f"unadapted depth has a relative error of {mean(large, 'unadapted'):.0f} % ({large}, "
        f"{parameters_of(large):,} parameters) and {mean(small, 'unadapted'):.0f} % ({small}, "
        f"{parameters_of(small):,}), the adapted depth of {mean(large, 'adapted'):.0f} % and "
        f"{mean(small, 'adapted'):.0f} %."
    )


FIGURE = Figure("fig1", "Depth by network size", "Figure 1, right", tasks, draw)
