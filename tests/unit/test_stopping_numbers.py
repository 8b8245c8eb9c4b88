"""Tables and sentences of the drone that stops before obstacles are those of the kept data."""

from __future__ import annotations

from typing import Any

import pytest

from document_numbers import agree, agree_all, agree_sentence, json_of, tables_of

PAGE = "docs/how-to/avoid-obstacles.md"
FIGURES = json_of("stopping.json")
LIGHTS = FIGURES["lights"]
TABLES = [table.rows for table in tables_of(PAGE) if table.place[0] == "What was measured"]
KIND = {"in the map": "mapped", "new": "new"}


def test_stops() -> None:
    assert len(TABLES[0]) == 2 * len(LIGHTS)
    for obstacle, light, stopped, by_distance, left, why in TABLES[0]:
        figures = LIGHTS[light][KIND[obstacle]]
        agree(stopped, [figures["stops"], figures["approaches"]])
        agree(by_distance, [figures["stops_by_distance"], figures["approaches"]])
        gaps_cm = [100.0 * figures[f"gap_{name}_m"] for name in ("median", "least", "most")]
        agree(left.replace("−", "-").replace("-", ""), map(abs, gaps_cm))
        assert ("−" in left) == (gaps_cm[1] < 0.0)
        agree(why, sorted(figures["why"].values(), reverse=True))


def spread(errors: list[dict[str, Any]], source: str, name: str, factor: float = 1.0) -> list[float]:
    values = [factor * each[source][name] for each in errors]
    return [min(values), max(values)]


def test_distances() -> None:
    for obstacle, distance, sectors, *cells, within in TABLES[1]:
        bin_m = distance.removesuffix(" m").replace("–", "-")
        errors = [light[f"{KIND[obstacle]}_errors"][bin_m] for light in LIGHTS.values()]
        agree(sectors, [sum(each["sectors"] for each in errors)])
        for cell, source in zip(cells, ("frame", "live", "joined"), strict=True):
            medians, missed = cell.split(";")
            agree_all([medians.replace("−", "")], [[abs(each) for each in spread(errors, source, "median", 100.0)]])
            agree(missed, spread(errors, source, "missed_rate", 100.0))
        agree(within, spread(errors, "joined", "within_2_sd"))


def of_all(kind: str, name: str) -> int:
    return sum(light[kind][name] for light in LIGHTS.values())


BY_MAP = [of_all("mapped", name) for name in ("stops_by_distance", "approaches", "stops", "approaches")]


def test_sentence_of_the_decision() -> None:
    sentence = "before {} of {} mapped obstacles; with a brake on *uncertain* and *lost* it is {} of {}."
    agree_sentence("docs/decisions/map.md", sentence, BY_MAP)


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        (
            "before {} of {} mapped obstacles, and before {} of {} new ones.** By distances alone, it stopped before "
            "{} and {} of them",
            [
                *(of_all(kind, name) for kind in ("mapped", "new") for name in ("stops", "approaches")),
                *(of_all(kind, "stops_by_distance") for kind in ("mapped", "new")),
            ],
        ),
        ("The stated standard deviation is {} % of the distance", [100.0 * FIGURES["stated_relative_sd"]]),
        (
            "if the state were ignored: {} of {} before mapped obstacles, {} of {} before new ones",
            [of_all(kind, name) for kind in ("mapped", "new") for name in ("stops_by_distance", "approaches")],
        ),
        ("1 % of what they saw was nearer than {} m", [FIGURES["nearest_depth_m"]]),
    ],
)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)
