"""Tables and sentences of days of moved furniture are those of the kept data."""

from __future__ import annotations

from typing import Any

import pytest

from document_numbers import agree, agree_all, agree_sentence, json_of, tables_of

PAGE = "docs/how-to/map-that-ages.md"
ROOM, AGAIN, OFFICE = (json_of(f"{name}.json") for name in ("ageing", "ageing-again", "ageing-office"))
TABLES = [table.rows for table in tables_of(PAGE) if table.place[0] == "Ten days of moved furniture"]
MAPS = ("never_updated", "updated", "fresh")


def centimetres(figures: dict[str, float]) -> list[float]:
    return [100.0 * figures["median_m"], 100.0 * figures["rmse_m"]]


def of_last_flight(found: dict[str, Any], name: str) -> list[list[float]]:
    figures = found[name]
    return [*([value] for value in centimetres(figures)), [figures["vouched_for"]], [figures["silent"]]]


def test_maps_after_the_last_day() -> None:
    for (_, *cells), name, landmarks in zip(TABLES[0], MAPS, ROOM["landmarks"], strict=True):
        agree_all(cells, [*of_last_flight(ROOM, name), [landmarks]])
    for (_, *cells), name in zip(TABLES[2], MAPS, strict=True):
        agree_all(cells, of_last_flight(OFFICE, name))


def test_days() -> None:
    for (number, moved, never, updated, usable, then), day in zip(TABLES[1], ROOM["days"], strict=True):
        assert moved == ", ".join(day["moved"]) and ROOM["days"][int(number) - 1] is day
        agree(never, centimetres(day["never_updated"]))
        agree(updated, centimetres(day["updated"]))
        agree(usable, [day["usable_frames"]])
        agree(then, day["applied"].values())


def extremes_of(values: list[float]) -> list[float]:
    return [min(values), max(values)]


def applied(kind: str) -> int:
    return sum(day["applied"].get(kind, 0) for day in OFFICE["days"])


LAST_DAY = ROOM["days"][-1]["updated"]
UNDO_KB = [day["undo_bytes"] / 1000.0 for day in ROOM["days"] if day["undo_bytes"]]
SENTENCES = [
    (
        "has {} times the median error of the fresh build and {} times its RMSE",
        [ROOM["median_ratio"], ROOM["rmse_ratio"]],
    ),
    (
        "and {} of its {} frames that are *tracking* or *map-changed* are more",
        [LAST_DAY["silent"], LAST_DAY["vouched_for"]],
    ),
    (
        "a fresh build has a median error of {} cm, the updated map {} cm and the one that was never updated {} cm, "
        "so the updated one has {} times the error of the fresh one. Of the frames that are *tracking* or "
        "*map-changed*, {} of {} and {} of {} are more than 30 cm off.",
        [
            *(100.0 * AGAIN[name]["median_m"] for name in ("fresh", "updated", "never_updated")),
            AGAIN["median_ratio"],
            *(AGAIN[name][count] for name in ("updated", "never_updated") for count in ("silent", "vouched_for")),
        ],
    ),
    ("frames are too few: {} to {} of", extremes_of([day["usable_frames"] for day in ROOM["days"][1:]])),
    ("A day's edits take {} to {} kB", extremes_of(UNDO_KB)),
    (
        "has {} times the median error and {} times the RMSE of a fresh build",
        [OFFICE["median_ratio"], OFFICE["rmse_ratio"]],
    ),
    (
        "the one that was never updated {} and {} times",
        [OFFICE["never_updated"][name] / OFFICE["fresh"][name] for name in ("median_m", "rmse_m")],
    ),
    ("frames a day, {} to {} are usable", extremes_of([day["usable_frames"] for day in OFFICE["days"]])),
    ("{} landmarks are retired and {} added.", [applied("retire landmarks"), applied("add landmarks")]),
]


def test_sentence_of_whom_it_is_not_for() -> None:
    days = [day["never_updated"] for day in AGAIN["days"]]
    silent, vouched_for = max((day["silent"], day["vouched_for"]) for day in days)
    last = AGAIN["never_updated"]
    medians_cm = [100.0 * AGAIN[name]["median_m"] for name in ("never_updated", "updated", "fresh")]
    expected = [*medians_cm, last["silent"], last["vouched_for"], silent, vouched_for]
    sentence = (
        "had a median error of {} cm, the updated one {} cm, and a fresh build {} cm. With the one that was never "
        "updated, {} of the {} frames that were *tracking* or *map-changed* were more than 30 cm off; on the worst "
        "day, {} of {} were (1 build)."
    )
    agree_sentence("docs/is-it-for-me.md", sentence, expected)


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)
