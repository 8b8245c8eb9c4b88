"""Sentences under Undecided of docs/results.md show numbers of the kept data, and the data says the verdicts."""

from __future__ import annotations

from typing import Any

import pytest

from document_numbers import (
    Sentence,
    agree_sentence,
    json_of,
    numbers,
    only,
    other_numbers,
    sections_of,
    table_of,
)
from kept_flights import of_network, papers_rmse_cm
from monoloc_lab.experiments.interval import Interval, step_of
from monoloc_lab.experiments.ladder import ratio

PAGE = "docs/results.md"
VARIANTS = table_of("adaptation-variants.csv")
KITCHEN, LIVING_ROOM = (json_of(f"reproduce-{room}.json")["figures"] for room in ("redkitchen", "living-room"))
FIVE_BUILDS = json_of("reproduce-redkitchen-five-builds.json")
LADDER = json_of("ladder.json")
MEDIAN = ("median_cm", "median_min_cm", "median_max_cm")
SIZES = ("full", "two-thirds", "one-third", "tiny")
SPLITS = ("interpolation", "extrapolation")


def percent_above(column: str, network: str) -> float:
    small, full = (float(of_network(size, "extrapolation", landmarks="yes")[column]) for size in (network, "full"))
    return 100.0 * (small / full - 1.0)


def of_five_builds(split: str) -> tuple[float, list[float]]:
    """By how many per cent a third of the parameters is above all, and the ratios of the builds."""
    runs = FIVE_BUILDS["figures"]["fig4d"][split]["network and map"]
    ratios = [small / full for small, full in zip(runs["one-third"]["runs"], runs["full"]["runs"], strict=True)]
    return 100.0 * (runs["one-third"]["median"] / runs["full"]["median"] - 1.0), [min(ratios), max(ratios)]


def tuned_last_layer(network: str) -> list[float]:
    return numbers(only(VARIANTS, network=network, split="interpolation", tuned="last layer and map"), *MEDIAN)


def of_another_build(variant: str) -> list[float]:
    error = KITCHEN["variants"]["interpolation"][variant]["full"]["unseen_ate_median_m"]
    return [100.0 * error[name] for name in ("median", "smallest", "largest")]


def over_lambdas(figures: dict[str, Any]) -> list[float]:
    errors = [100.0 * each["unseen_ate_rmse_m"]["median"] for each in figures["lambda"]["joint"].values()]
    return [min(errors), max(errors)]


def without_transform() -> list[Interval]:
    """RMSE with the map transform over that without it, of rooms and splits, with landmarks and by depth alone."""
    found = [
        ratio(
            [row for row in LADDER if row["room"] == room],
            split,
            f"the default{part}",
            f"network tuned, map as it is{part}",
        )
        for room in ("RedKitchen", "office desk")
        for split in SPLITS
        for part in ("", ", depth alone")
    ]
    return [each for each in found if each is not None]


LANDMARK_MEDIANS = {
    split: [float(of_network(size, split, landmarks="yes")["median_cm"]) for size in SIZES] for split in SPLITS
}
SENTENCES: tuple[Sentence, ...] = (
    (
        "On 300:400 the median with `full` is {} cm ({}–{}, {} builds, {} flights)",
        numbers(of_network("full", "extrapolation"), *MEDIAN, "builds", "flights"),
    ),
    (
        "the median on the interpolation split is {} cm ({}–{}) with `full` and {} cm ({}–{}) with `one-third`, "
        "against {} and {} cm with the untuned bundle",
        [
            *tuned_last_layer("full"),
            *tuned_last_layer("one-third"),
            *(
                float(only(VARIANTS, network=network, split="interpolation", tuned="nothing")["median_cm"])
                for network in ("full", "one-third")
            ),
        ],
    ),
    (
        "In another build it was {} cm ({}–{}) against {} cm ({}–{})",
        [*of_another_build("last+map"), *of_another_build("unadapted")],
    ),
    ("the RMSE of the paper's method is [{} to {} cm]", [bound(papers_rmse_cm(LADDER)) for bound in (min, max)]),
    (
        "{} to {} cm in RedKitchen (extrapolation, `full`), {} to {} cm in the living room (L2, `full`)",
        [*over_lambdas(KITCHEN), *over_lambdas(LIVING_ROOM)],
    ),
    (
        "do not separate them: {} cm on the interpolation split, {} to {} cm on the extrapolation split",
        [
            LANDMARK_MEDIANS["interpolation"][0],
            min(LANDMARK_MEDIANS["extrapolation"]),
            max(LANDMARK_MEDIANS["extrapolation"]),
        ],
    ),
    (
        "{}, {}, {} and {} cm, so `one-third` is {} % and `tiny` {} % above `full`",
        [
            *(float(of_network(size, "extrapolation", landmarks="yes")["rmse_cm"]) for size in SIZES),
            *(percent_above("rmse_cm", size) for size in ("one-third", "tiny")),
        ],
    ),
    (
        "had `one-third` {} % above `full` on the interpolation split and {} % on the extrapolation split",
        [of_five_builds(split)[0] for split in SPLITS],
    ),
    (
        "with ratios of {} to {} and {} to {} build by build",
        [number for split in SPLITS for number in of_five_builds(split)[1]],
    ),
    (
        "in one build the RMSE is {}, {}, {} and {} cm from `full` to `tiny`",
        [
            100.0 * LIVING_ROOM["fig5b"]["living room"]["in L3 by size"]["network and map"][size]["median"]
            for size in SIZES
        ],
    ),
)


def test_verdicts_under_undecided() -> None:
    assert len({*LANDMARK_MEDIANS["interpolation"]}) == 1
    steps = [step_of(each) for each in without_transform()]
    assert (len(steps), steps.count("undecided"), steps.count("worse")) == (8, 8, 0)


NOT_OF_THE_DATA: dict[str, str] = {
    "18 to 21 cm (2 to 4 builds, 2 to 4 starts)": "not kept",
    "measured 15 to 20 cm. The runs of these two were not kept": "not kept",
    "(1 build, 5 starts)": "the sum of the rows' flights",
    "1 build, 5 starts. A map": "one build in the file",
    "(5 builds each)": "of the ladder, checked there",
    "6 flights of one stretch": "checked in the table",
    "RMSE, 5 builds, one start each": "of the file",
    "15.4 to 7.5 cm on": "not kept",
    "(17.5 to 21.1 cm, ). The runs were not kept": "not kept",
}


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    assert other_numbers(dict(sections_of(PAGE))["Undecided"], SENTENCES, NOT_OF_THE_DATA) == []
