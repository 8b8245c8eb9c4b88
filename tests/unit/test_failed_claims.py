"""Sentences under Failed of docs/results.md show numbers of the kept data, and the data says the verdicts."""

from __future__ import annotations

import numpy as np
import pytest

from document_numbers import (
    Sentence,
    agree_sentence,
    chosen,
    json_of,
    numbers,
    only,
    other_numbers,
    sections_of,
    table_of,
    three,
)
from kept_flights import DESK_BETWEEN, DESK_BEYOND, KITCHEN_BETWEEN, KITCHEN_BEYOND, of_network, over, over_untuned
from monoloc_lab.experiments.interval import Interval, interval_of, medians_of_builds, ratios_of_builds, step_of
from monoloc_lab.experiments.ladder import ratio

PAGE = "docs/results.md"
LOCALIZATION, BASELINES = table_of("localization.csv"), table_of("baselines.csv")
CLAIMS = json_of("claims-by-method.json")
LADDER, RENDERED = json_of("ladder.json"), json_of("ladder-rendered.json")
MEDIAN = ("median_cm", "median_min_cm", "median_max_cm")
SIZES = ("full", "two-thirds", "one-third", "tiny")
SPLITS = ("interpolation", "extrapolation")


def in_darkness(network: str) -> dict[str, str]:
    return only(LOCALIZATION, room="living room", light="L3", network=network, variant="adapted", landmarks="no")


def coverage_of_later_builds(light: str) -> list[float]:
    wanted = {"split": f"living room, {light}", "rung": "the default, depth alone"}
    return [*medians_of_builds(RENDERED, "coverage_95", **wanted).values()]


def over_unadapted(network: str, split: str) -> float:
    """Median without adaptation over that with it."""
    unadapted, adapted = (of_network(network, split, variant) for variant in ("unadapted", "adapted"))
    return float(unadapted["median_cm"]) / float(adapted["median_cm"])


def a_third_over_all(room: str) -> Interval:
    small, large = (
        medians_of_builds(
            [row for row in CLAIMS if row["room"] == room],
            "rmse_cm",
            method="the default, depth alone",
            tuned=True,
            size=size,
            light="as recorded",
        )
        for size in ("one-third", "full")
    )
    return interval_of(ratios_of_builds(small, large))


def a_third_larger_percent(column: str, builds: str) -> float:
    small, large = (of_network(size, "extrapolation", builds=builds)[column] for size in ("one-third", "full"))
    return 100.0 * (float(small) / float(large) - 1.0)


BASELINE_BETWEEN = chosen(BASELINES, room="RedKitchen", split="interpolation", light="as recorded")
SIFT_IN_THE_LIVING_ROOM = only(BASELINES, room="living room", light="L2", method="SIFT keypoints")
IN_THE_LIVING_ROOM = only(
    LOCALIZATION, room="living room", light="L2", network="full", variant="adapted", landmarks="yes"
)
AWAY_AT_THE_DESK, NEAR_AT_THE_DESK = (
    [build[part] for build in json_of("recovery-desk.json")] for part in ("away", "near")
)
FOUND_AWAY = sorted(build["kidnap_recovery_rate"] for build in AWAY_AT_THE_DESK)
STOPS = json_of("stopping.json")["lights"].values()


def stops_before(kind: str) -> list[float]:
    """Stops, approaches and stops by distances alone."""
    return [sum(light[kind][name] for light in STOPS) for name in ("stops", "approaches", "stops_by_distance")]


SENTENCES: tuple[Sentence, ...] = (
    (
        "the drone stopped in {} of {} approaches to mapped obstacles ({} in each of three lights): in {} by "
        "distances alone, in the rest because the state was *uncertain* or *lost*. It stopped in {} of {} approaches "
        "to new obstacles, never by distances alone.",
        [*stops_before("mapped")[:2], 20, *stops_before("mapped")[2:], *stops_before("new")[:2]],
    ),
    (
        "Two later builds had {} and {} in L3, and {} and {} in L1",
        [value for light in ("L3", "L1") for value in coverage_of_later_builds(light)],
    ),
    (
        "the ratio to the RMSE without scans is {} ({}–{}). They lower it in RedKitchen: {} ({}–{}) in "
        "interpolation, {} ({}–{}) in extrapolation. At the desk, extrapolation, it is undecided: {} ({}–{}).",
        [
            number
            for stretch in (DESK_BETWEEN, KITCHEN_BETWEEN, KITCHEN_BEYOND, DESK_BEYOND)
            for number in three(over("without scans", stretch))
        ],
    ),
    (
        "the default has {} ({}–{}) and {} ({}–{}) times the RMSE of untuned bundles in RedKitchen, interpolation "
        "and extrapolation, and {} ({}–{}) times at the desk, interpolation. At the desk, extrapolation, it is "
        "undecided, with {} ({}–{}) times, as in",
        [
            number
            for stretch in (KITCHEN_BETWEEN, KITCHEN_BEYOND, DESK_BETWEEN, DESK_BEYOND)
            for number in three(over_untuned(stretch))
        ],
    ),
    (
        "{} % (`full`) and {} % (`one-third`) of the frames lie inside the stated 95 % ellipsoid ({} builds, "
        "{} flights)",
        [
            *(100.0 * float(in_darkness(network)["coverage_95"]) for network in ("full", "one-third")),
            *numbers(in_darkness("full"), "builds", "flights"),
        ],
    ),
    (
        "the odometry ratio is {} (worst {}) and {} (worst {})",
        [
            number
            for network in ("full", "one-third")
            for number in numbers(in_darkness(network), "rmse_over_odometry_median", "rmse_over_odometry_worst")
        ],
    ),
    (
        "On the interpolation split the ratio of the median errors is {} (`full`), {} (`two-thirds`), {} "
        "(`one-third`) and {} (`tiny`). On the extrapolation split it is {}, {}, {} and {}. {} builds, "
        "{} flights each.",
        [
            *(over_unadapted(network, split) for split in SPLITS for network in SIZES),
            *numbers(of_network("full", "interpolation"), "builds", "flights"),
        ],
    ),
    (
        "the ratio of the RMSE is {} ({}–{}) at the desk and {} ({}–{}) in RedKitchen, both undecided",
        [*three(a_third_over_all("office desk")), *three(a_third_over_all("RedKitchen"))],
    ),
    (
        "was {} % larger than that of `full` in 3 builds with 6 flights, and {} % larger in 5 builds with 10 flights "
        "({} against {} cm; RMSE {} % larger)",
        [
            *(a_third_larger_percent("median_cm", builds) for builds in ("3", "5")),
            *(float(of_network(size, "extrapolation", builds="5")["median_cm"]) for size in ("one-third", "full")),
            a_third_larger_percent("rmse_cm", "5"),
        ],
    ),
    (
        "SIFT keypoints with PnP have {} cm (9.8 MB of descriptors) and PoseNet has {} cm ({}–{}, {} seeds). monoloc "
        "has {} cm with landmarks and {} cm with depth alone. In the living room in L2, SIFT has a median of {} cm "
        "(RMSE {}) and monoloc {} cm (RMSE {})",
        [
            *numbers(only(BASELINE_BETWEEN, method="SIFT keypoints"), "median_cm"),
            *numbers(only(BASELINE_BETWEEN, method="PoseNet", size="full"), *MEDIAN, "seeds"),
            *(float(of_network("full", "interpolation", landmarks=with_)["median_cm"]) for with_ in ("yes", "no")),
            *numbers(SIFT_IN_THE_LIVING_ROOM, "median_cm", "rmse_cm"),
            *numbers(IN_THE_LIVING_ROOM, "median_cm", "rmse_cm"),
        ],
    ),
    (
        "{} ({}–{}) of {} kidnaps away from the build's frames were found within 3 s, in [three builds]",
        [FOUND_AWAY[1], FOUND_AWAY[0], FOUND_AWAY[2], AWAY_AT_THE_DESK[0]["kidnaps"]],
    ),
    (
        "Near them it was {} of {}.",
        [
            float(np.median([build["kidnap_recovery_rate"] for build in NEAR_AT_THE_DESK])),
            NEAR_AT_THE_DESK[0]["kidnaps"],
        ],
    ),
)


def test_verdicts_under_failed() -> None:
    assert [step_of(over("without scans", stretch)) for stretch in range(4)] == [
        "better",
        "better",
        "worse",
        "undecided",
    ]
    tuning = [step_of(over_untuned(stretch)) for stretch in range(4)]
    assert tuning == ["better", "better", "better", "undecided"]
    at_the_desk = [row for row in LADDER if row["room"] == "office desk"]
    in_the_ladder = ratio(at_the_desk, "extrapolation", "the default", "untuned")
    assert in_the_ladder is not None and step_of(in_the_ladder) == "undecided"
    desk, kitchen = (three(a_third_over_all(room)) for room in ("office desk", "RedKitchen"))
    assert desk[1] < 1.15 < desk[2] and kitchen[1] < 1.15 < kitchen[2]
    assert len(FOUND_AWAY) == 3 and FOUND_AWAY[-1] < 0.95
    assert stops_before("new")[2] == 0


NOT_OF_THE_DATA: dict[str, str] = {
    "2 flights a light each": "of the ladder of the rendered rooms",
    "versions of 23 to 25 November 2026": "dates",
    "within 15 % of": "the claim",
    "the stated 95 % ellipsoid held 23 to 58 % of the poses": "not kept",
    "1 build, 3 flights, 57 frames each": "not kept",
    "outside 3.5 sigma. The runs were not kept": "not kept",
    "in 5 of 24 approaches": "not kept",
    "(1 build, three lights)": "not kept",
}


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    assert other_numbers(dict(sections_of(PAGE))["Failed"], SENTENCES, NOT_OF_THE_DATA) == []
