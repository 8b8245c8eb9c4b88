"""Numbers of README are those of the kept data, to the digits that they show."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from document_numbers import (
    Rows,
    Sentence,
    agree,
    agree_sentence,
    by_build,
    chosen,
    json_of,
    middle,
    other_numbers,
    over_builds,
    page,
    table_of,
    tables_of,
    three,
    total,
    tracking_percent,
    values,
)
from kept_flights import DESK_BEYOND, KITCHEN_BETWEEN, flown, over, over_untuned, papers_rmse_cm

FLIGHTS = table_of("this-version.csv")
KITCHEN = json_of("reproduce-redkitchen.json")["figures"]

# --- The table ---

COLUMNS = (
    {"built_from": "RedKitchen 0:300:3", "flown": "0:300"},
    {"built_from": "RedKitchen 0:300:3", "flown": "300:400"},
    {"built_from": "desk 0:350:7", "flown": "0:350"},
    {"built_from": "desk 0:350:7", "flown": "350:500"},
)


def of_flights(method: str, column: dict[str, str]) -> list[float]:
    found = chosen(FLIGHTS, method=method, **column)
    return [*over_builds(found, "rmse_cm"), *middle(found, "median_cm")]


def of_odometry(column: dict[str, str]) -> list[float]:
    return over_builds(chosen(FLIGHTS, method="default", **column), "odometry_rmse_cm")


def of_sift(column: dict[str, str]) -> list[float]:
    return [sift_in_kitchen_cm("extrapolation")] if column["flown"] == "300:400" else []


def sift_in_kitchen_cm(split: str) -> float:
    return 100.0 * float(KITCHEN["fig5b"][split]["by light"]["SIFT keypoints"]["as recorded"]["median"])


def of_counts(column: dict[str, str]) -> list[float]:
    found = chosen(FLIGHTS, method="default", **column)
    return [len({row["build"] for row in found}), len(found)]


README_ROWS: tuple[tuple[str, Callable[[dict[str, str]], list[float]]], ...] = (
    ("monoloc (default)", partial(of_flights, "default")),
    ("landmarks and odometry, no depth scans", partial(of_flights, "without scans")),
    ("depth alone, no landmarks", partial(of_flights, "without landmarks")),
    ("untuned, with landmarks (3 builds)", partial(of_flights, "untuned")),
    ("visual odometry from the same start", of_odometry),
    ("SIFT keypoints and PnP, 9.8 MB", of_sift),
    ("builds, flights (SIFT: one run)", of_counts),
)


def test_table_of_readme() -> None:
    (rows,) = (table.rows for table in tables_of("README.md") if table.place == ("Accuracy", 0))
    assert [row[0] for row in rows] == [name for name, _ in README_ROWS]
    for (_, numbers), (_, *shown) in zip(README_ROWS, rows, strict=True):
        for text, column in zip(shown, COLUMNS, strict=True):
            agree(text, numbers(column))


# --- Sentences ---


def largest_over_smallest() -> float:
    builds = by_build(flown("default", DESK_BEYOND), "rmse_cm").values()
    return max(builds) / min(builds)


TUNED = chosen(table_of("many-rooms.csv"), bundle="tuned", without="")
ELSEWHERE = chosen(TUNED, flight="elsewhere")
NEAR = [row for row in ELSEWHERE if float(row["distance"]) < 1.2]
FAR = [row for row in ELSEWHERE if row not in NEAR]


def extremes(rows: Rows, column: str) -> list[float]:
    return [min(values(rows, column)), max(values(rows, column))]


def test_number_of_rooms_near_the_walk() -> None:
    assert (len(NEAR), len(ELSEWHERE)) == (5, 8)


def silent(rows: Rows) -> list[float]:
    """Frames, those that were silently wrong, and how many by each measure."""
    counts = [total(rows, "silent_30cm"), total(rows, "silent_3_5_sigma")]
    return [total(rows, "frames"), sum(counts), *counts]


SENTENCES: tuple[Sentence, ...] = (
    ("{} % of the frames are *tracking*", [tracking_percent(flown("default", DESK_BEYOND))]),
    (
        "of the {} of RedKitchen, interpolation, {} ({} over 30 cm off, {} beyond 3.5 sigma)",
        silent(flown("default", KITCHEN_BETWEEN)),
    ),
    ("Of the {} at the desk, extrapolation, {} are", silent(flown("default", DESK_BEYOND))[:2]),
    (
        "{} ({}–{}) and {} ({}–{}) in RedKitchen, interpolation and extrapolation, and by {} ({}–{}) and "
        "{} ({}–{}) at the desk",
        [number for stretch in range(4) for number in three(over("without scans", stretch))],
    ),
    (
        "more frames are *tracking* with them: {} instead of {} %",
        [tracking_percent(flown(method, DESK_BEYOND)) for method in ("default", "without scans")],
    ),
    (
        "the RMSE of tuned bundles is {} ({}–{}) and {} ({}–{}) times that of untuned ones in RedKitchen, "
        "interpolation and extrapolation, and {} ({}–{}) and {} ({}–{}) times at the desk (3 builds). At the desk, "
        "extrapolation, {} % of the frames of untuned bundles are *tracking*",
        [
            *(number for stretch in range(4) for number in three(over_untuned(stretch))),
            tracking_percent(flown("untuned", DESK_BEYOND)),
        ],
    ),
    (
        "has an RMSE of {} cm or more in all four",
        [min(papers_rmse_cm([*json_of("ladder.json"), *json_of("ladder-rendered.json")]))],
    ),
    ("the largest of the five builds is {} times the smallest", [largest_over_smallest()]),
    (
        "the RMSE of tuned bundles is {} to {} cm beside the walk that made the map, and {} to {} cm in the five "
        "rooms in which the flight is up to {} away from it (metres plus radians). In the other three, it is {} to "
        "{} cm, and {} to {} of 200 frames are *tracking*",
        [
            *extremes(chosen(TUNED, flight="beside the walk"), "rmse_cm"),
            *extremes(NEAR, "rmse_cm"),
            extremes(NEAR, "distance")[1],
            *extremes(FAR, "rmse_cm"),
            *extremes(FAR, "tracking"),
        ],
    ),
    (
        "Of {} frames, {} are silently more than 30 cm off",
        [total(TUNED, name) for name in ("frames", "silent_30cm")],
    ),
    ("SIFT is more accurate**: in RedKitchen, its RMSE is {} cm", [sift_in_kitchen_cm("interpolation")]),
    (
        "the network {} MB, landmarks 0.2 to 0.4 MB, the mixture {} kB",
        [
            KITCHEN["table1"]["depth networks"]["full"]["bytes"] / 1e6,
            KITCHEN["table1"]["map"]["bytes"] / 1e3,
        ],
    ),
)

NOT_OF_THE_DATA: dict[str, str] = {
    "200 Gaussians in 8 kB": "a definition: 40 bytes each",
    "arXiv 2210.15559": "a name",
    "ICASSP 2023": "a name",
    "Python 3.11": "what is required",
    "about 3 GB": "of the packages",
    "ROS 2": "a name",
    "7-Scenes": "a name",
    "takes about 2.3 MB": "the sum of what follows",
    "about 10 cm and 3°": "what a start must keep to",
    "400 frames of 7-Scenes": "of the recording",
    "500 frames of an office": "of the recording",
    "10 cm and 3° off": "the starts of the flights",
    "deviates from them by [4 cm": "a sentence of its page, checked there",
    "the extrapolation frames [by 3 cm": "on its page, without kept runs",
    "10 % longer than stated": "a name",
    "1.5 cm and 1.7°": "stated by those who recorded the desk",
    "15 to 20 cm": "measured elsewhere, without kept data",
    "(1 build a room, 6 flights)": "three flights, two starts",
    "7.9 cm, that of odometry alone 19.3 cm; both end 17 cm off": "the film, docs/pictures/flight.webp",
    "over 30 cm or 3.5 stated standard deviations": "a definition",
    "lie on both sides of 1": "a definition",
}


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence("README.md", sentence, expected)


def test_every_other_number_is_none_that_was_measured() -> None:
    assert other_numbers(page("README.md"), SENTENCES, NOT_OF_THE_DATA) == []
