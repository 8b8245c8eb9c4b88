"""Position errors of all methods in every light (figure 5 b of the paper), and the claim about them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from monoloc.viz.picture import GREY, picture
from monoloc_lab.experiments.claims import Dark, half_in_the_dark
from monoloc_lab.experiments.drawing import Series, draw_bound, draw_ranges, legend_below
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import (
    BRIGHT,
    DARK,
    DEAD_RECKONING,
    MEDIAN,
    Spread,
    and_list,
    depth_task,
    in_split,
    mean_depth,
    nearest_build_m,
    network_of,
    picture_path,
    size_labels,
    spread_of,
)
from monoloc_lab.experiments.methods import (
    BY_SIZE,
    FILTERED,
    JOINT,
    POSENET,
    POSENET_WITH_VIEWS,
    SENSOR,
    UNADAPTED,
    Method,
    bundle_of,
    keypoint_methods,
)
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_BY_SIZE_IN_THE_DARK = (POSENET, FILTERED, UNADAPTED, JOINT)


def _methods(study: Study) -> tuple[Method, ...]:
    """Methods compared at the largest size. A quick study trains no PoseNet on synthesised views."""
    further = () if study.quick else (POSENET_WITH_VIEWS,)
    return (POSENET, *further, *BY_SIZE[1:], *keypoint_methods(study), SENSOR)


def _by_light(study: Study, split: Split, results: Results) -> dict[str, dict[str, Spread]]:
    size = study.sizes[0]
    return {
        method.name: {
            light: method.rmse(study, results, split, size, recording)
            for light, recording in split.recordings.items()
        }
        for method in _methods(study)
    }


def _depths(study: Study, split: Split) -> tuple[Task, Task]:
    """Unadapted and adapted depth in near darkness."""
    bundle = bundle_of(study, split, study.sizes[0], "joint")
    recording = split.recordings[DARK]
    return depth_task(network_of(study.sizes[0]), recording), depth_task(bundle, recording)


def tasks(study: Study) -> Sequence[Task]:
    found: list[Task] = []
    for split in study.splits:
        found += _depths(study, split)
        for recording in split.recordings.values():
            found += [
                task for method in _methods(study) for task in method.runs(study, split, study.sizes[0], recording)
            ]
        for size in study.sizes[1:]:
            for method in _BY_SIZE_IN_THE_DARK:
                found += method.runs(study, split, size, split.recordings[DARK])
    return found


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    numbers: dict[str, Any] = {}
    pictures, rows, claims, sentences = [], [], [], []
    for split in study.splits:
        errors = _by_light(study, split, results)
        dark = {
            method.name: {
                size: method.rmse(study, results, split, size, split.recordings[DARK]) for size in study.sizes
            }
            for method in _BY_SIZE_IN_THE_DARK
        }
        joint = JOINT.runs(study, split, study.sizes[0], split.recordings[DARK])
        drift = spread_of(results, joint, DEAD_RECKONING)
        numbers[split.name] = {
            "by light": {
                name: {light: each.numbers() for light, each in lights.items()} for name, lights in errors.items()
            },
            f"in {DARK} by size": {
                name: {size: each.numbers() for size, each in sizes.items()} for name, sizes in dark.items()
            },
            f"dead reckoning in {DARK}": drift.numbers(),
            "nearest_build_frame_m": nearest_build_m(split, split.recordings[DARK]),
        }
        pictures.append(_draw_lights(study, split, errors, folder))
        pictures.append(_draw_sizes(study, split, dark, drift, folder))
        rows += [
            row for method in _methods(study) for row in _rows(study, results, split, method, errors[method.name])
        ]
        claims.append(half_in_the_dark(_measured(study, results, split, errors)))
        few = (JOINT, UNADAPTED, POSENET)
        listed = [f"{method.name} {errors[method.name][DARK].centimetres()}" for method in few]
        listed.append(f"dead reckoning {drift.centimetres()}")
        sentences.append(f"{split.name.capitalize()}, RMSE in {DARK}: {and_list(listed)}.")
    head = ("split", "method", "light", "RMSE", "median", "frames without a pose")
    return Drawn(
        numbers=numbers,
        pictures=pictures,
        tables={f"Errors in each light with {study.sizes[0]} (median over seeds; smallest to largest)": (head, rows)},
        text=" ".join(sentences),
        claims=claims,
    )


def _draw_lights(study: Study, split: Split, errors: dict[str, dict[str, Spread]], folder: Path) -> Path:
    path = picture_path(study, folder, "fig5b", split)
    lights = list(split.recordings)
    series = [
        Series(method.name, method.colour, [errors[method.name][light] for light in lights])
        for method in _methods(study)
    ]
    with picture(path, 1.5 + 2.7 * len(lights), 5.2) as figure:
        axis = figure.subplots()
        draw_ranges(axis, [_light_label(light) for light in lights], series)
        axis.set_ylabel("position RMSE (cm)")
        axis.set_title(f"Position error in each light, {study.sizes[0]}{in_split(study, split)}")
        legend_below(figure, [axis], 4)
    return path


def _draw_sizes(study: Study, split: Split, dark: dict[str, dict[str, Spread]], drift: Spread, folder: Path) -> Path:
    path = picture_path(study, folder, "fig5b-sizes", split)
    series = [
        Series(method.name, method.colour, [dark[method.name][size] for size in study.sizes])
        for method in _BY_SIZE_IN_THE_DARK
    ]
    with picture(path, 4.0 + 1.6 * len(study.sizes), 4.6) as figure:
        axis = figure.subplots()
        draw_bound(axis, "dead reckoning, true start", drift, GREY, (0, (4, 2)))
        draw_ranges(axis, size_labels(study), series)
        axis.set_ylabel("position RMSE (cm)")
        axis.set_title(f"Position error by network size in {DARK}{in_split(study, split)}")
        legend_below(figure, [axis], 3)
    return path


def _light_label(light: str) -> str:
    return {"L1": "L1\nbright", "L2": "L2\nmedium", DARK: f"{DARK}\nnear darkness"}.get(light, light)


def _rows(
    study: Study, results: Results, split: Split, method: Method, errors: dict[str, Spread]
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for light, recording in split.recordings.items():
        runs = method.runs(study, split, study.sizes[0], recording)
        median = spread_of(results, runs, MEDIAN)
        failed, evaluated = (
            spread_of(results, runs, "unseen_failed_frames"),
            spread_of(results, runs, "unseen_frames"),
        )
        lost = f"{failed.median:.0f} of {evaluated.median:.0f}" if failed.values and failed.median else "none"
        rows.append((split.name, method.name, light, errors[light].centimetres(), median.centimetres(), lost))
    return rows


def _measured(study: Study, results: Results, split: Split, errors: dict[str, dict[str, Spread]]) -> Dark:
    recording = split.recordings[DARK]
    before, after = (mean_depth(results[task], split, recording, "absrel") for task in _depths(study, split))
    return Dark(
        split=split.name,
        light=DARK,
        size=study.sizes[0],
        joint=errors[JOINT.name][DARK],
        posenet=errors[POSENET.name][DARK],
        unadapted=errors[UNADAPTED.name][DARK],
        unadapted_drift=spread_of(results, UNADAPTED.runs(study, split, study.sizes[0], recording), DEAD_RECKONING),
        nearest_m=nearest_build_m(split, recording),
        absrel=(before, after),
        bright=(errors[POSENET.name][BRIGHT], errors[UNADAPTED.name][BRIGHT]),
        builds=study.builds,
    )


FIGURE = Figure("fig5b", "Position error in each light", "Figure 5 b", tasks, draw)
