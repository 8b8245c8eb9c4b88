"""What docs/beyond-the-paper.md says of the ladder is what the kept flights say."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from monoloc_lab.experiments.interval import interval_of
from monoloc_lab.experiments.ladder import ladder_table, of_builds, pairs_table
from monoloc_lab.experiments.rungs import all_rungs
from repository import REPOSITORY

DOCS = REPOSITORY / "docs"
ROWS: list[dict[str, Any]] = json.loads((DOCS / "results" / "ladder.json").read_text())
PAGE = (DOCS / "beyond-the-paper.md").read_text(encoding="utf-8")
ROOMS = {"RedKitchen": "RedKitchen", "Office desk": "office desk"}
SPLITS = ("between", "beyond")


def median_of(cell: str) -> str:
    return cell.partition(" (")[0]


def of_room(title: str) -> list[dict[str, Any]]:
    return [row for row in ROWS if row["room"] == ROOMS[title]]


def tables_of(title: str) -> list[list[list[str]]]:
    """The cells of each table in a room's section, without the head."""
    text = PAGE.split(f"\n### {title}\n")[1].partition("\n## ")[0].partition("\n### ")[0]
    tables = re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE)
    return [[[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()[2:]] for table in tables]


@pytest.mark.parametrize("title", ROOMS)
def test_tables_are_those_of_the_report(title: str) -> None:
    rows = of_room(title)
    *ladders, pairs = tables_of(title)
    for split, shown in zip(SPLITS, ladders, strict=True):
        expected = [
            [name, median_of(median), rmse, *map(median_of, others), f"{step} {verdict}".strip()]
            for name, median, rmse, *others, step, verdict, _ in ladder_table(rows, split)
        ]
        assert shown == expected
    between, beyond = (pairs_table(rows, split) for split in SPLITS)
    assert pairs == [
        [near[0], near[2], *(part for each in (near, far) for part in pair_cells(each))]
        for near, far in zip(between, beyond, strict=True)
    ]


def pair_cells(pair: tuple[str, ...]) -> tuple[str, str]:
    _, error, _, other, ratio, verdict, _ = pair
    return f"{median_of(error)}, {median_of(other)}", f"{ratio} {verdict}"


def test_errors_with_other_weights_of_the_divergence() -> None:
    for value in (1, 10):
        rung = f"the paper's method, lambda {value}"
        errors = [
            interval_of(list(of_builds(of_room(title), split, rung, "rmse_cm").values())).median
            for title in ROOMS
            for split in SPLITS
        ]
        assert "{:.0f}, {:.0f}, {:.0f} and {:.0f} cm".format(*errors) in PAGE


def test_every_method_was_built_and_flown_three_times_by_a_known_commit() -> None:
    flown = {(row["room"], row["rung"], row["build_seed"], row["flight"], row["split"]) for row in ROWS}
    assert len(flown) == len(ROWS) == len(ROOMS) * len(all_rungs()) * 3 * 2 * len(SPLITS)
    for row in ROWS:
        assert re.fullmatch("[0-9a-f]{12}", row["bundle_commit"])
        assert re.fullmatch("[0-9a-f]{12}", row["flight_commit"])
