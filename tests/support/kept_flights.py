"""Flights of this version with ratios of their errors, and rows of the networks of earlier versions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from document_numbers import Rows, by_build, chosen, middle, only, table_of, values
from monoloc.localizability import found_probability
from monoloc_lab.experiments.interval import Interval, interval_of, medians_of_builds

FLIGHTS = table_of("this-version.csv")
STRETCHES = (
    ("RedKitchen 0:300:3", "0:300"),
    ("RedKitchen 0:300:3", "300:400"),
    ("desk 0:350:7", "0:350"),
    ("desk 0:350:7", "350:500"),
)
KITCHEN_BETWEEN, KITCHEN_BEYOND, DESK_BETWEEN, DESK_BEYOND = range(4)


def flown(method: str, stretch: int) -> Rows:
    built_from, frames = STRETCHES[stretch]
    return chosen(FLIGHTS, method=method, built_from=built_from, flown=frames)


def over_builds_of(column: str, stretch: int, *methods: str) -> list[float]:
    """The median over builds, of each method."""
    return [middle(flown(method, stretch), column)[0] for method in methods]


def largest_over_smallest() -> float:
    """RMSE of the default at the desk, extrapolation, over builds."""
    builds = by_build(flown("default", DESK_BEYOND), "rmse_cm").values()
    return max(builds) / min(builds)


def over(other: str, stretch: int) -> Interval:
    """RMSE of the default over that of another method, build by build."""
    default, others = (by_build(flown(method, stretch), "rmse_cm") for method in ("default", other))
    return interval_of([default[build] / others[build] for build in default])


def over_untuned(stretch: int) -> Interval:
    """RMSE of the default over that of the untuned bundle of the same seed."""
    default, others = (by_build(flown(method, stretch), "rmse_cm") for method in ("default", "untuned"))
    return interval_of([default[seed] / others[seed] for seed in others])


FURTHER = table_of("further-recordings.csv")
TURNING, TURNING_BEYOND, WALK, WALK_BEYOND = (
    {"built_from": built_from, "flown": frames}
    for built_from, frames in (
        ("freiburg1/rpy 0:450:4", "0:450"),
        ("freiburg1/rpy 0:450:4", "450:671"),
        ("HoloLens walk 0:280:2", "0:280"),
        ("HoloLens walk 0:280:2", "280:373"),
    )
)


def further(method: str, stretch: Mapping[str, str]) -> Rows:
    """Flights over a recording that nobody had looked at."""
    return chosen(FURTHER, method=method, **stretch)


def further_over(other: str, stretch: Mapping[str, str]) -> Interval:
    """RMSE of the default over that of another method, build by build."""
    default, others = (by_build(further(method, stretch), "rmse_cm") for method in ("default", other))
    return interval_of([default[build] / others[build] for build in default])


def papers_rmse_cm(ladder: Sequence[Mapping[str, Any]]) -> list[float]:
    """RMSE of the paper's method in each room and split of a ladder, medians over builds."""
    rows = [row for row in ladder if row["rung"] == "the paper's method"]
    return [
        interval_of([*medians_of_builds(rows, "rmse_cm", room=room, split=split).values()]).median
        for room, split in dict.fromkeys((row["room"], row["split"]) for row in rows)
    ]


def of_network(
    network: str, split: str, variant: str = "adapted", landmarks: str = "no", builds: str = "3"
) -> dict[str, str]:
    """As recorded in RedKitchen."""
    return only(
        table_of("localization.csv"),
        room="RedKitchen",
        light="as recorded",
        network=network,
        split=split,
        variant=variant,
        landmarks=landmarks,
        builds=builds,
    )


def predicted_and_actual(frames: Rows) -> tuple[float, float]:
    """Share of the images that find a lost camera, as predicted by the expected landmarks, and as measured."""
    predicted = found_probability(np.array(values(frames, "expected")))
    return float(predicted.mean()), float(np.mean(values(frames, "localized")))
