"""Tables and sentences of days of moved furniture are those of the kept data."""

from __future__ import annotations

from typing import Any

import pytest

from document_numbers import agree_all, agree_sentence, json_of, tables_of

PAGE = "docs/how-to/map-that-ages.md"
ROOMS = sorted({found["room"] for found in json_of("ageing.json")})
ONE, TWO = (
    [
        found
        for room in ROOMS
        for found in json_of("ageing.json")
        if (found["room"], found["flights_a_day"]) == (room, count)
    ]
    for count in (1, 2)
)
OFFICE = json_of("ageing-office.json")


def last_flight(found: dict[str, Any], name: str) -> list[float]:
    """Median and RMSE in cm, frames that are vouched for, and those of them that are more than 30 cm off."""
    figures = found[name]
    return [100.0 * figures["median_m"], 100.0 * figures["rmse_m"], figures["vouched_for"], figures["silent"]]


def test_maps_after_the_last_day() -> None:
    (table,) = (table.rows for table in tables_of(PAGE) if table.place[0] == "Ten days of moved furniture")
    assert [int(row[0]) for row in table] == ROOMS
    for (_, *cells), one, two in zip(table, ONE, TWO, strict=True):
        maps = ((one, "fresh"), (one, "never_updated"), (one, "updated"), (two, "updated"))
        agree_all(cells, [last_flight(found, name) for found, name in maps])


def test_no_flight_of_another_room_changed_a_map() -> None:
    assert all(found["poisoned"] and not found["poison_changed"] for found in (*ONE, *TWO, OFFICE))


def extremes_of(values: list[float]) -> list[float]:
    return [min(values), max(values)]


def silent(name: str) -> list[float]:
    """Frames more than 30 cm off, and all that are vouched for, over the days of all rooms."""
    days = [day[name] for found in ONE for day in found["days"]]
    return [sum(day["silent"] for day in days), sum(day["vouched_for"] for day in days)]


def refusals(rooms: list[dict[str, Any]]) -> list[str]:
    """Of each day, why flights were refused; empty where none was."""
    return [day["refusal"] or "" for found in rooms for day in found["days"]]


def refused(rooms: list[dict[str, Any]], why: str = "") -> int:
    """Days on which a flight was refused, for a reason."""
    return sum(bool(refusal) and why in refusal for refusal in refusals(rooms))


def applied(kind: str) -> int:
    return sum(day["applied"].get(kind, 0) for day in OFFICE["days"])


UNDO_KB = [day["undo_bytes"] / 1000.0 for found in ONE for day in found["days"] if day["undo_bytes"]]
SENTENCES = [
    (
        "Its median error is {} to {} times as large with one flight a day, and {} to {} times with two.",
        [end for rooms in (ONE, TWO) for end in extremes_of([found["median_ratio"] for found in rooms])],
    ),
    (
        "**On {} of the {} days, the day's flight is refused**: on {} since fewer than half of its frames are "
        "*tracking*, on {} since landmarks fit another focal length, although the camera is the one of the build, "
        "and on {} since fewer than five of its frames are usable.",
        [
            refused(ONE),
            len(refusals(ONE)),
            refused(ONE, "tracking, fewer"),
            refused(ONE, "another focal length"),
            refused(ONE, "are usable"),
        ],
    ),
    ("With two flights a day, one or both are refused on {} of the {} days.", [refused(TWO), len(refusals(TWO))]),
    (
        "over all days and rooms, {} of the {} frames that are *tracking* or *map-changed* on the map that was never "
        "updated are more than 30 cm off, and {} of {} on the updated one.",
        [*silent("never_updated"), *silent("updated")],
    ),
    ("A day's edits take {} to {} kB", extremes_of(UNDO_KB)),
    (
        "Fresh build {}, {} cm; {}, {}; never updated {}, {} cm; {}, {}; updated {}, {} cm; {}, {}.",
        [number for name in ("fresh", "never_updated", "updated") for number in last_flight(OFFICE, name)],
    ),
    (
        "it has {} times the median error of a fresh build, and the one that was never updated {} times",
        [OFFICE["median_ratio"], OFFICE["never_updated"]["median_m"] / OFFICE["fresh"]["median_m"]],
    ),
    ("frames a day, {} to {} are usable", extremes_of([day["usable_frames"] for day in OFFICE["days"]])),
    ("{} landmarks are retired and {} added.", [applied("retire landmarks"), applied("add landmarks")]),
]


def test_sentence_of_whom_it_is_not_for() -> None:
    medians_cm = (
        [100.0 * found[name]["median_m"] for found in ONE] for name in ("never_updated", "updated", "fresh")
    )
    days = [day["never_updated"] for found in ONE for day in found["days"]]
    worst = max((day["silent"], day["vouched_for"]) for day in days)
    sentence = (
        "the maps that were never updated had a median error of {} to {} cm, the updated ones {} to {} cm, and fresh "
        "builds {} to {} cm. On the worst day, {} of the {} frames"
    )
    expected = [end for values in medians_cm for end in extremes_of(values)]
    agree_sentence("docs/is-it-for-me.md", sentence, [*expected, *worst])


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)
