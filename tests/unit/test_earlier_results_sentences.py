"""Sentences of docs/results-of-earlier-versions.md show numbers of the kept data."""

from __future__ import annotations

import re
from collections.abc import Iterable

import pytest

from document_numbers import (
    Sentence,
    agree_sentence,
    chosen,
    json_of,
    median_of,
    numbers,
    only,
    other_numbers,
    sections_of,
    table_of,
    values,
)

PAGE = "docs/results-of-earlier-versions.md"
SPLITS = ("interpolation", "extrapolation")
LOCALIZATION = [row for row in table_of("localization.csv") if row["room"] == "RedKitchen" and row["builds"] == "3"]
BASELINES = chosen(table_of("baselines.csv"), room="RedKitchen", light="as recorded")
KITCHEN = json_of("reproduce-redkitchen.json")["figures"]
RELOCALISATION = table_of("relocalization.csv")
WITHOUT_ODOMETRY = table_of("without-odometry.csv")


def extremes(found: Iterable[float]) -> list[float]:
    found = list(found)
    return [min(found), max(found)]


# --- RedKitchen ---


def of_column(column: str, landmarks: str, variant: str, **labels: str) -> list[float]:
    return values(chosen(LOCALIZATION, landmarks=landmarks, variant=variant, **labels), column)


def by_split(column: str, landmarks: str) -> list[float]:
    """Smallest and largest of adapted networks, interpolation and extrapolation."""
    return [end for split in SPLITS for end in extremes(of_column(column, landmarks, "adapted", split=split))]


def worst_ratio(landmarks: str, **labels: str) -> float:
    return max(of_column("rmse_over_odometry_worst", landmarks, "adapted", **labels))


def rmse_of(method: str, size: str = "") -> list[float]:
    return [numbers(only(BASELINES, method=method, size=size, split=split), "rmse_cm")[0] for split in SPLITS]


IN_RED_KITCHEN: tuple[Sentence, ...] = (
    (
        "with landmarks, adapted, is {} to {} on the interpolation split, below the stated 0.95, and {} to {} on the "
        "extrapolation split. With adapted depth alone it is {} to {}; with unadapted depth alone {} to {}.",
        [
            *by_split("coverage_95", "yes"),
            *extremes(of_column("coverage_95", "no", "adapted")),
            *extremes(of_column("coverage_95", "no", "unadapted")),
        ],
    ),
    (
        "with landmarks, adapted: {} to {} on the interpolation split, {} to {} on the extrapolation split; worst "
        "of {} flights {}. With depth alone the worst flights reach {} as recorded and {} in L3.",
        [
            *by_split("rmse_over_odometry_median", "yes"),
            sum(of_column("flights", "yes", "adapted")),
            worst_ratio("yes"),
            *(worst_ratio("no", light=light) for light in ("as recorded", "L3")),
        ],
    ),
    (
        "adapted: {} to {} % on the interpolation split, {} to {} % on the extrapolation split. Unadapted: "
        "{} to {} %.",
        [
            *by_split("absrel_percent", "no"),
            *extremes(of_column("absrel_percent", "no", "unadapted")),
        ],
    ),
    (
        "SIFT {} and {} cm, ORB {} and {} cm, odometry alone from the same start {} and {} cm",
        [
            *rmse_of("SIFT keypoints"),
            *rmse_of("ORB keypoints"),
            *(100.0 * KITCHEN["fig4d"][split]["dead reckoning, same start"]["median"] for split in SPLITS),
        ],
    ),
    ("PoseNet {} and {} cm. With", rmse_of("PoseNet", "full")),
    (
        "the coverage on the extrapolation split is {}:",
        numbers(only(BASELINES, method="sensor depth", split="extrapolation"), "coverage_95"),
    ),
)


# --- Others ---

ADAPTED = "network and map"
WITHOUT = {
    split: [row for row in chosen(WITHOUT_ODOMETRY, split=split) if row["tuned"] == ADAPTED] for split in SPLITS
}
LOSING = [row for row in WITHOUT_ODOMETRY if row["tuned"] != ADAPTED]
BEYOND_200 = chosen(RELOCALISATION, frames="200:262", landmarks="no")
SHARE = "share_not_lost_and_more_than_40cm_off"
OTHERS: tuple[Sentence, ...] = (
    ("in which a result took {} s", extremes(values(RELOCALISATION, "seconds_to_result"))[:1]),
    (
        "{} to {} % of such frames were, with errors of {} cm in the median",
        [
            *(100.0 * share for share in extremes(values(BEYOND_200, SHARE))),
            median_of(BEYOND_200, "error_when_found_median_cm"),
        ],
    ),
    (
        "1 build, {} or {} starts) adapted networks have {} to {} cm on the interpolation split and {} to {} cm on "
        "the extrapolation split. Every other variant loses the camera ({} to {} cm).",
        [
            *extremes(values(WITHOUT_ODOMETRY, "no_odometry_starts")),
            *(number for split in SPLITS for number in extremes(values(WITHOUT[split], "no_odometry_median_cm"))),
            *extremes(values(LOSING, "no_odometry_median_cm")),
        ],
    ),
    (
        "gravity gains nothing: {} cm without, {} cm with",
        [
            float(only(table_of("gravity.csv"), room="RedKitchen", gravity_given=given)["median_cm"])
            for given in ("no", "yes")
        ],
    ),
)


def test_what_relocalisation_shows_without_a_number() -> None:
    assert {row["seconds_to_result"] for row in RELOCALISATION} == {"1.0"}
    assert {float(row[SHARE]) for row in RELOCALISATION if row["frames"] != "200:262"} == {0.0}


# --- All numbers ---

SENTENCES = (*IN_RED_KITCHEN, *OTHERS)
NOT_OF_THE_DATA: dict[str, str] = {
    "versions of 22 to 27 November 2026": "dates",
    "3 builds, 2 starts each, 6 flights": "checked in the table",
    "2 builds, 2 starts each, 4 flights": "checked in the table",
    "1 build or training per seed, 5 seeds": "of the file",
    "39 frames at 15 Hz": "of the recording",
    "more than 40 cm off": "a definition",
    "Depth alone, 1 build, 5 starts": "of the file",
    "depth alone, 1 build, 5 starts.": "of the file",
    "depth alone, 1 build, 5 starts, an earlier": "of the file",
    "0.5° per axis, constant in a flight, and 0.3° per frame": "what was simulated",
    "built from , 5 seeds": "of the file",
    "from 2 kB on": "a row",
    "voxels of 40 cm": "of the file",
    "K = 200, built": "a setting",
    "sensor depth, 5 seeds. Noise is 2 cm and 1° per axis": "what was simulated",
}
WITHOUT_KEPT_RUNS = (
    "Stopping before obstacles",
    "When the states were introduced",
    "A live flight beside other work",
    "Gyroscope",
    "Floor of a building",
)


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    sections = [text for heading, text in sections_of(PAGE) if heading not in WITHOUT_KEPT_RUNS]
    assert len(sections) == 9
    assert other_numbers("".join(sections), SENTENCES, NOT_OF_THE_DATA) == []


@pytest.mark.parametrize("heading", WITHOUT_KEPT_RUNS)
def test_section_says_that_its_runs_were_not_kept(heading: str) -> None:
    assert re.search(r"The runs .*were not kept", dict(sections_of(PAGE))[heading])
