"""Position errors of every method by network size (figure 4 d of the paper), and the claim about them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import GREY, picture
from monoloc_lab.experiments.claims import Smaller, smaller_is_as_accurate
from monoloc_lab.experiments.drawing import Series, draw_bound, draw_ranges, legend_below
from monoloc_lab.experiments.fig4c import depth_tasks
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    DEAD_RECKONING,
    FROM_SAME_START,
    MEDIAN,
    ROTATION,
    Spread,
    in_split,
    mean_depth,
    picture_path,
    size_labels,
    spread_of,
    usual_light,
    usual_recording,
)
from monoloc_lab.experiments.methods import BY_SIZE, JOINT, SENSOR, UNADAPTED
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_SMALLER = "one-third"


def tasks(study: Study) -> Sequence[Task]:
    found: list[Task] = []
    for split in study.splits:
        recording = usual_recording(split)
        found += SENSOR.runs(study, split, study.sizes[0], recording)
        for size in study.sizes:
            found += [task for method in BY_SIZE for task in method.runs(study, split, size, recording)]
            found += depth_tasks(study, split, size).values()
    return found


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, rows, claims, sentences = [], [], [], []
    for split in study.splits:
        recording = usual_recording(split)
        errors = {
            method.name: {size: method.rmse(study, results, split, size, recording) for size in study.sizes}
            for method in BY_SIZE
        }
        runs = JOINT.runs(study, split, study.sizes[0], recording)
        drift, same_start = (spread_of(results, runs, figure) for figure in (DEAD_RECKONING, FROM_SAME_START))
        sensor = SENSOR.rmse(study, results, split, study.sizes[0], recording)
        numbers[split.name] = {
            "light": usual_light(split),
            **{name: {size: each.numbers() for size, each in sizes.items()} for name, sizes in errors.items()},
            "dead reckoning": drift.numbers(),
            "dead reckoning, same start": same_start.numbers(),
            SENSOR.name: sensor.numbers(),
        }
        pictures.append(_draw(study, split, errors, (same_start, drift), sensor, folder))
        for method in BY_SIZE:
            for size in study.sizes:
                runs = method.runs(study, split, size, recording)
                median, turn = (spread_of(results, runs, name) for name in (MEDIAN, ROTATION))
                angle = f"{turn.median:.1f}°"
                rmse = errors[method.name][size].centimetres()
                rows.append((split.name, method.name, size, rmse, median.centimetres(), angle))
        rows.append((split.name, SENSOR.name, "", sensor.centimetres(), "", ""))
        rows.append((split.name, "dead reckoning, same start", "", same_start.centimetres(), "", ""))
        rows.append((split.name, "dead reckoning, true start", "", drift.centimetres(), "", ""))
        sentences.append(_sentence(study, split, errors))
        if _SMALLER in study.sizes:
            claims.append(smaller_is_as_accurate(_measured(study, results, split, errors, drift)))
    head = ("split", "method", "size", "RMSE", "median", "rotation")
    return Drawn(
        numbers=numbers,
        pictures=pictures,
        tables={"Errors in the light of the build frames (median over seeds; smallest to largest)": (head, rows)},
        text=" ".join(sentences),
        claims=claims,
    )


def _draw(
    study: Study,
    split: Split,
    errors: dict[str, dict[str, Spread]],
    dead_reckoning: tuple[Spread, Spread],
    sensor: Spread,
    folder: Path,
) -> Path:
    path = picture_path(study, folder, "fig4d", split)
    series = [
        Series(method.name, method.colour, [errors[method.name][size] for size in study.sizes]) for method in BY_SIZE
    ]
    with picture(path, 3.5 + 1.8 * len(study.sizes), 5.0) as figure:
        axis = figure.subplots()
        draw_bound(axis, "dead reckoning, same start", dead_reckoning[0], GREY, "-")
        draw_bound(axis, "dead reckoning, true start", dead_reckoning[1], GREY, (0, (4, 2)))
        draw_bound(axis, SENSOR.name, sensor, SENSOR.colour, ":")
        draw_ranges(axis, size_labels(study), series)
        axis.set_ylabel("position RMSE (cm)")
        axis.set_title(f"Position error by network size{in_split(study, split)}")
        legend_below(figure, [axis], 3)
    return path


def _measured(
    study: Study, results: Results, split: Split, errors: dict[str, dict[str, Spread]], drift: Spread
) -> Smaller:
    recording = usual_recording(split)
    pair = (study.sizes[0], _SMALLER)
    plain, ours = ([list(depth_tasks(study, split, size).values())[place] for size in pair] for place in (0, -1))
    ssim = [mean_depth(results[task], split, recording, "ssim") for task in plain]
    absrel = [mean_depth(results[task], split, recording, "absrel") for task in ours]
    joint, unadapted = ([errors[name][size] for size in pair] for name in (JOINT.name, UNADAPTED.name))
    return Smaller(
        split=split.name,
        light=usual_light(split),
        sizes=pair,
        joint=(joint[0], joint[1]),
        unadapted=(unadapted[0], unadapted[1]),
        ssim=(ssim[0], ssim[1]),
        absrel=(absrel[0], absrel[1]),
        drift=drift,
        builds=study.builds,
    )


def _sentence(study: Study, split: Split, errors: dict[str, dict[str, Spread]]) -> str:
    best = {size: min(errors, key=lambda name: _nan_last(errors[name][size].median)) for size in study.sizes}
    listed = [
        f"{name} ({', '.join(size for size in study.sizes if best[size] == name)})"
        for name in dict.fromkeys(best.values())
    ]
    return f"{split.name.capitalize()}: smallest RMSE with {', '.join(listed)}."


def _nan_last(value: float) -> float:
    return value if value == value else float("inf")


FIGURE = Figure("fig4d", "Position error by network size", "Figure 4 d", tasks, draw)
