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
    chosen,
    extremes,
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
)
from kept_flights import (
    DESK_BETWEEN,
    DESK_BEYOND,
    FURTHER,
    KITCHEN_BETWEEN,
    KITCHEN_BEYOND,
    TURNING,
    TURNING_BEYOND,
    WALK,
    WALK_BEYOND,
    flown,
    further,
    further_over,
    largest_over_smallest,
    over,
    over_builds_of,
    over_untuned,
    papers_rmse_cm,
)

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


def of_odometry(name: str, column: dict[str, str]) -> list[float]:
    return over_builds(chosen(FLIGHTS, method="default", **column), name)


def of_sift(column: dict[str, str]) -> list[float]:
    return [sift_in_kitchen_cm("extrapolation")] if column["flown"] == "300:400" else []


def sift_in_kitchen_cm(split: str) -> float:
    return 100.0 * float(KITCHEN["fig5b"][split]["by light"]["SIFT keypoints"]["as recorded"]["median"])


README_ROWS: tuple[tuple[str, Callable[[dict[str, str]], list[float]]], ...] = (
    ("monoloc (default)", partial(of_flights, "default")),
    ("landmarks and odometry, no depth scans", partial(of_flights, "without scans")),
    ("depth alone, no landmarks", partial(of_flights, "without landmarks")),
    ("untuned, with landmarks", partial(of_flights, "untuned")),
    ("odometry alone, from the same start", partial(of_odometry, "odometry_rmse_cm")),
    ("odometry alone, from the true start", partial(of_odometry, "odometry_from_truth_rmse_cm")),
    ("SIFT keypoints and PnP, 9.8 MB, one run", of_sift),
)


def test_number_of_builds_and_flights() -> None:
    assert "medians over **five builds with two flights each**" in page("README.md")
    for method in ("default", "without scans", "without landmarks", "untuned"):
        for column in COLUMNS:
            found = chosen(FLIGHTS, method=method, **column)
            assert (len({row["build"] for row in found}), len(found)) == (5, 10)


def test_table_of_readme() -> None:
    (rows,) = (table.rows for table in tables_of("README.md") if table.place == ("Accuracy", 0))
    assert [row[0] for row in rows] == [name for name, _ in README_ROWS]
    for (_, numbers), (_, *shown) in zip(README_ROWS, rows, strict=True):
        for text, column in zip(shown, COLUMNS, strict=True):
            agree(text, numbers(column))


# --- Sentences ---


TUNED = chosen(table_of("many-rooms.csv"), bundle="tuned", without="")
LOOKED_AT_BY_NOBODY = table_of("unseen-rooms.csv")


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
        "odometry that starts at the true pose has {} cm, and less than monoloc in four of the five builds. Its "
        "scale comes from the tuned depth; with the untuned network it has {} cm",
        over_builds_of("odometry_from_truth_rmse_cm", KITCHEN_BEYOND, "default", "untuned"),
    ),
    (
        "they multiply it by {} ({}–{}) and {} ({}–{}) in RedKitchen, interpolation and extrapolation, and by {} "
        "({}–{}) at the desk, interpolation",
        [
            number
            for stretch in (KITCHEN_BETWEEN, KITCHEN_BEYOND, DESK_BETWEEN)
            for number in three(over("without scans", stretch))
        ],
    ),
    (
        "to {} ({}–{}), {} ({}–{}) and {} ({}–{}) times that of untuned bundles",
        [
            number
            for stretch in (KITCHEN_BETWEEN, KITCHEN_BEYOND, DESK_BETWEEN)
            for number in three(over_untuned(stretch))
        ],
    ),
    (
        "has an RMSE of {} cm or more in the four rooms",
        [min(papers_rmse_cm([*json_of("ladder.json"), *json_of("ladder-rendered.json")]))],
    ),
    ("the largest of the five builds is {} times the smallest", [largest_over_smallest()]),
    (
        "the RMSE is {} to {} cm beside the walk that made the map. On another path through the room it is {} to {} "
        "cm in normal light, and {} to {} cm in near darkness",
        [
            number
            for flight in ("beside the walk", "elsewhere", "elsewhere, near darkness")
            for number in extremes(chosen(TUNED, flight=flight), "rmse_cm")
        ],
    ),
    (
        "Of these {} frames, {} are silently more than 30 cm off, and {} beyond 3.5 sigma",
        [total(TUNED, name) for name in ("frames", "silent_30cm", "silent_3_5_sigma")],
    ),
    (
        "which nobody had looked at before, {} of {} frames are silently wrong",
        [total(LOOKED_AT_BY_NOBODY, "silent_3_5_sigma"), total(LOOKED_AT_BY_NOBODY, "frames")],
    ),
    (
        "the RMSE is {} cm in interpolation and {} cm in extrapolation; depth scans raise it to {} and {} times, "
        "tuning to {} and {} times. On a walk through an office it is {} cm in interpolation. In extrapolation, "
        "mostly of what was never mapped, it is {} cm, and only {} % of its frames are tracked. Of all {} frames, {} "
        "are silently wrong",
        [
            *(middle(further("default", stretch), "rmse_cm")[0] for stretch in (TURNING, TURNING_BEYOND)),
            *(further_over("without scans", stretch).median for stretch in (TURNING, TURNING_BEYOND)),
            *(further_over("untuned", stretch).median for stretch in (TURNING, TURNING_BEYOND)),
            *(middle(further("default", stretch), "rmse_cm")[0] for stretch in (WALK, WALK_BEYOND)),
            tracking_percent(further("default", WALK_BEYOND)),
            total(chosen(FURTHER, method="default"), "frames"),
            sum(total(chosen(FURTHER, method="default"), name) for name in ("silent_30cm", "silent_3_5_sigma")),
        ],
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
    "RedKitchen, extrapolation, 100 frames": "of the recording",
    "1 tuned build each": "counted",
    "(untuned, 1 build each)": "counted",
    "1.5 cm and 1.7°": "stated by those who recorded the desk",
    "15 to 20 cm": "measured elsewhere, without kept data",
    "7.9 cm, that of odometry alone 19.3 cm; both end 17 cm off": "the film, docs/pictures/flight.webp",
    "over 30 cm or 3.5 stated standard deviations": "a definition",
    "lie on both sides of 1": "a definition",
}


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence("README.md", sentence, expected)


def test_the_first_page_states_what_is_not_solved() -> None:
    share = tracking_percent(flown("default", DESK_BEYOND))
    agree_sentence("docs/index.md", "beyond the frames of the build, {} % of the frames are *tracking*", [share])


def test_every_other_number_is_none_that_was_measured() -> None:
    assert other_numbers(page("README.md"), SENTENCES, NOT_OF_THE_DATA) == []
