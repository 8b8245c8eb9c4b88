"""The paper's claims, decided for the paper's method and for the default by the same rules, side by side.

The rules are those of ``docs/beyond-the-paper.md``. Each method is compared with no tuning in its own filter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from monoloc.viz.picture import BLUE, GREY, picture
from monoloc_lab.experiments import tasks as factories
from monoloc_lab.experiments.claims import DARK_BOUND, MOVED_BOUND_M, SMALLER_BOUND
from monoloc_lab.experiments.drawing import draw_points, legend_below, logarithmic
from monoloc_lab.experiments.figure import Drawn, Figure
from monoloc_lab.experiments.gather import BRIGHT, DARK, MEDIAN, RMSE, compared_lights, network_of, usual_light
from monoloc_lab.experiments.interval import (
    CONFIDENCE,
    Interval,
    Verdict,
    all_of,
    interval_of,
    is_below,
    medians_of_builds,
    ratios_of_builds,
)
from monoloc_lab.experiments.ladder import FLIGHTS
from monoloc_lab.experiments.rungs import CLAIMED, Claimed
from monoloc_lab.experiments.study import Split, Study
from monoloc_lab.experiments.task import Results, Task

_SMALLER = "one-third"

Row = dict[str, Any]
"""One flight: ``room``, ``method``, ``tuned``, ``size``, ``light``, ``build_seed``, ``flight``, errors, commits."""


@dataclass(frozen=True)
class _Flight:
    method: str
    tuned: bool
    size: str
    light: str
    build_seed: int
    flight: int
    task: Task


def tasks(study: Study) -> Sequence[Task]:
    return [flight.task for flight in _flights(study)]


def _flights(study: Study) -> Iterator[_Flight]:
    """Of the first split: by the method and by the untuned bundle, in the usual light, L1 and L3."""
    split = study.splits[0]
    for build in range(study.builds):
        for size in _sizes(study):
            for method, tuned in ((method, tuned) for method in CLAIMED for tuned in (True, False)):
                rung = method.tuned if tuned else method.untuned
                bundle = factories.built(split, network_of(size), rung.build, build)
                for light in compared_lights(split):
                    for flight in range(FLIGHTS):
                        task = factories.run(bundle, split.recordings[light], flight, without=rung.without)
                        yield _Flight(method.name, tuned, size, light, build, flight, task)


def _sizes(study: Study) -> tuple[str, ...]:
    """The largest network, and a third of its parameters where the study has it."""
    return tuple(dict.fromkeys([study.sizes[0], *(size for size in study.sizes if size == _SMALLER)]))


def rows_of(study: Study, results: Results) -> list[Row]:
    """Of the flights that have a result."""
    rows = []
    for flight in _flights(study):
        if flight.task not in results:
            continue
        run, bundle = results[flight.task], results[flight.task.needs[0]]
        errors = {
            name: None if (value := run.figures.get(figure)) is None else round(100.0 * value, 4)
            for name, figure in (("rmse_cm", RMSE), ("median_cm", MEDIAN))
        }
        rows.append(
            {
                "room": study.title,
                "method": flight.method,
                "tuned": flight.tuned,
                "size": flight.size,
                "light": flight.light,
                "build_seed": flight.build_seed,
                "flight": flight.flight,
                **errors,
                "map_moved_cm": round(100.0 * bundle.figures["shift_median_m"], 4),
                "bundle_commit": bundle.commit,
                "flight_commit": run.commit,
            }
        )
    return rows


@dataclass(frozen=True)
class Decided:
    """A claim about a method: what its conditions apply to, in words with intervals, and the verdict."""

    claim: str
    method: str
    measured: tuple[str, ...]
    verdict: Verdict


def decide(rows: Sequence[Row], split: Split, sizes: Sequence[str]) -> list[Decided]:
    """Every claim for every method, by rules 3 to 5.

    Args:
        rows: of one room.
        sizes: of the networks, largest first; the first claim needs two.
    """
    light, large = usual_light(split), sizes[0]
    found = []
    if len(sizes) > 1:
        found += [_smaller(rows, method, (large, sizes[1]), light) for method in CLAIMED]
    found += [_dark(rows, method, large) for method in CLAIMED]
    return found + [_small_change(rows, method, large, light) for method in CLAIMED]


def _smaller(rows: Sequence[Row], method: Claimed, sizes: tuple[str, str], light: str) -> Decided:
    large, small = ({tuned: _errors(rows, method, tuned, size, light) for tuned in (True, False)} for size in sizes)
    return _decided(
        "a third of the parameters is as accurate",
        method,
        ("tuned, smaller over larger", ratios_of_builds(small[True], large[True]), SMALLER_BOUND),
        ("untuned, larger over smaller", ratios_of_builds(large[False], small[False]), 1.0),
    )


def _dark(rows: Sequence[Row], method: Claimed, size: str) -> Decided:
    adapted, dark, bright = (
        _errors(rows, method, tuned, size, light) for tuned, light in ((True, DARK), (False, DARK), (False, BRIGHT))
    )
    return _decided(
        "more robust in the dark than untuned",
        method,
        (f"in {DARK}, tuned over untuned", ratios_of_builds(adapted, dark), DARK_BOUND),
        (f"untuned, {BRIGHT} over {DARK}", ratios_of_builds(bright, dark), 1.0),
    )


def _small_change(rows: Sequence[Row], method: Claimed, size: str, light: str) -> Decided:
    tuned, untuned = (_errors(rows, method, tuned, size, light) for tuned in (True, False))
    moved = medians_of_builds(rows, "map_moved_cm", method=method.name, tuned=True, size=size, light=light)
    return _decided(
        "a small change of the map is enough",
        method,
        ("map moved, cm", list(moved.values()), 100.0 * MOVED_BOUND_M),
        ("tuned over untuned", ratios_of_builds(tuned, untuned), 1.0),
    )


def _errors(rows: Sequence[Row], method: Claimed, tuned: bool, size: str, light: str) -> dict[int, float]:
    """Position RMSE of each build, cm."""
    return medians_of_builds(rows, "rmse_cm", method=method.name, tuned=tuned, size=size, light=light)


def _decided(claim: str, method: Claimed, *conditions: tuple[str, Sequence[float], float]) -> Decided:
    """By conditions: what is measured, its value in every build, and the bound that it must lie below."""
    texts, verdicts = [], []
    for name, values, bound in conditions:
        interval = interval_of(values) if values else Interval(float("nan"), 0)
        texts.append(f"{name}: {interval.text(digits=2)}, below {bound:g}: {is_below(interval, bound)}")
        verdicts.append(is_below(interval, bound))
    return Decided(claim, method.name, tuple(texts), all_of(*verdicts))


def draw(study: Study, results: Results, folder: Path) -> Drawn:
    rows, split, sizes = rows_of(study, results), study.splits[0], _sizes(study)
    decided = decide(rows, split, sizes)
    errors = [
        (size, light, method.name, *(_error(rows, method, tuned, size, light) for tuned in (False, True)))
        for size in sizes
        for light in compared_lights(split)
        for method in CLAIMED
    ]
    text = (
        f"{study.builds} builds, {FLIGHTS} flights each, {split.name}. Medians over builds of the median over "
        f"flights, with the {100 * CONFIDENCE:.0f} % bootstrap interval over builds. A claim holds where all of its "
        "conditions hold, and fails where one fails. Each method is compared with the untuned bundle in the same "
        "filter."
    )
    return Drawn(
        numbers={"rows": rows, "decided": [vars(each) for each in decided]},
        pictures=[_draw(study, rows, folder)],
        tables={
            "Claims, by method": (
                ("claim", "method", "measured", "verdict"),
                [(each.claim, each.method, "; ".join(each.measured), each.verdict) for each in decided],
            ),
            "RMSE, cm": (("size", "light", "method", "untuned", "tuned"), errors),
        },
        text=text,
    )


def _error(rows: Sequence[Row], method: Claimed, tuned: bool, size: str, light: str) -> str:
    values = list(_errors(rows, method, tuned, size, light).values())
    return interval_of(values).text() if values else "–"


def _draw(study: Study, rows: Sequence[Row], folder: Path) -> Path:
    """RMSE in every light by the largest network, a point a build: a panel a method."""
    path, lights, size = folder / "claims-by-method.png", compared_lights(study.splits[0]), study.sizes[0]
    with picture(path, 3.6 * len(CLAIMED), 3.6) as figure:
        axes = figure.subplots(1, len(CLAIMED), sharey=True)
        for axis, method in zip(axes, CLAIMED, strict=True):
            untuned, tuned = (
                [list(_errors(rows, method, is_tuned, size, light).values()) for light in lights]
                for is_tuned in (False, True)
            )
            draw_points(axis, method.name, lights, {"untuned": (GREY, untuned), "tuned": (BLUE, tuned)})
        logarithmic(axes[0].yaxis)
        axes[0].set_ylabel("position RMSE (cm), a point a build")
        legend_below(figure, list(axes), 2)
    return path


FIGURE = Figure("claims-by-method", "The claims, by method", None, tasks, draw, on_request=True)
