"""What docs/beyond-the-paper.md says of the paper's claims is what the kept flights say."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest

from monoloc_lab.experiments.claims_by_method import Decided, decide
from monoloc_lab.experiments.interval import interval_of, medians_of_builds
from monoloc_lab.experiments.rungs import CLAIMED
from monoloc_lab.experiments.study import AS_RECORDED, EvalRecording, Split
from repository import REPOSITORY

DOCS = REPOSITORY / "docs"
ROWS: list[dict[str, Any]] = json.loads((DOCS / "results" / "claims-by-method.json").read_text())
ROOMS = {"RedKitchen": "RedKitchen", "desk": "office desk"}
SIZES = ("full", "one-third")
LIGHTS = (AS_RECORDED, "L1", "L3")
SPLIT = Split("extrapolation", "", "", {light: EvalRecording("", "", None) for light in LIGHTS})


def of_room(room: str) -> list[dict[str, Any]]:
    return [row for row in ROWS if row["room"] == ROOMS[room]]


def verdict_rows() -> list[list[str]]:
    """Rows of the table of verdicts."""
    decided = [decide(of_room(room), SPLIT, SIZES) for room in ROOMS]
    return [[first.claim, first.method, cell(first), cell(second)] for first, second in zip(*decided, strict=True)]


def cell(decided: Decided) -> str:
    return f"{'; '.join(decided.measured)}. **{decided.verdict}**"


def error_rows() -> list[list[str]]:
    """Rows of the table of errors."""
    return [
        [f"{room}, {size}, {light}", *(errors(of_room(room), method.name, size, light) for method in CLAIMED)]
        for room in ROOMS
        for size in SIZES
        for light in LIGHTS
    ]


def errors(rows: list[dict[str, Any]], method: str, size: str, light: str) -> str:
    return ", ".join(
        interval_of(
            list(medians_of_builds(rows, "rmse_cm", method=method, tuned=tuned, size=size, light=light).values())
        ).text()
        for tuned in (False, True)
    )


def test_tables_are_those_of_the_kept_flights() -> None:
    text = (DOCS / "beyond-the-paper.md").read_text(encoding="utf-8")
    section = text.split("\n## The claims\n")[1].partition("\n## ")[0]
    verdicts, shown = (
        [[part.strip() for part in line.split("|")[1:-1]] for line in table.splitlines()[2:]]
        for table in re.findall(r"(?:^\|.*\n)+", section, re.MULTILINE)
    )
    assert verdicts == verdict_rows() and shown == error_rows()


def rmse(room: str, column: str = "rmse_cm", **wanted: Any) -> dict[int, float]:
    return medians_of_builds(of_room(room), column, **{"light": AS_RECORDED, "size": "full", **wanted})


def median_ratio(errors: dict[int, float], others: dict[int, float]) -> float:
    return float(np.median([errors[build] / others[build] for build in errors]))


def test_sentences() -> None:
    text = (DOCS / "beyond-the-paper.md").read_text(encoding="utf-8")
    paper, alone, _ = (method.name for method in CLAIMED)
    small, large = (
        float(np.median([*rmse("RedKitchen", method=paper, tuned=True, size=size).values()])) for size in SIZES[::-1]
    )
    assert f"The tuned smaller one is better in RedKitchen ({small:.0f} after {large:.0f} cm)" in text
    smaller, larger = (rmse("desk", method=alone, tuned=True, size=size) for size in SIZES[::-1])
    assert f"has {median_ratio(smaller, larger):.1f} times the error at the desk" in text
    brighter = [
        median_ratio(*(rmse(room, method=method.name, tuned=False, light=light) for light in ("L1", "L3")))
        for room in ROOMS
        for method in CLAIMED
    ]
    dark = [each for room in ROOMS for each in decide(of_room(room), SPLIT, SIZES) if "dark" in each.claim]
    assert sum(each.measured[1].endswith("holds") for each in dark) == 1
    assert f"worse in simulated darkness in one of six cases, by {100.0 * (1.0 - min(brighter)):.0f} %" in text
    moved = [
        float(np.median([*rmse(room, column="map_moved_cm", method=m.name, tuned=True).values()]))
        for room in ROOMS
        for m in CLAIMED
    ]
    assert f"maps move by {min(moved):.1f} to {max(moved):.1f} cm" in text


def test_three_builds_of_every_method_network_and_light_by_a_known_commit() -> None:
    for room in ROOMS:
        for row in error_rows():
            assert row[0].startswith(tuple(ROOMS))
        flown = {
            tuple(row[name] for name in ("method", "tuned", "size", "light", "build_seed")) for row in of_room(room)
        }
        assert len(flown) == len(CLAIMED) * 2 * len(SIZES) * len(LIGHTS) * 3
    assert all(re.fullmatch("[0-9a-f]{12}", row["bundle_commit"]) for row in ROWS)


def flight(tuned: bool, size: str, light: str, build: int, rmse_cm: float) -> dict[str, Any]:
    return {
        "method": CLAIMED[-1].name,
        "tuned": tuned,
        "size": size,
        "light": light,
        "build_seed": build,
        "rmse_cm": rmse_cm,
        "map_moved_cm": 2.0,
    }


@pytest.mark.parametrize(
    ("untuned_dark_cm", "verdict"),
    [(40.0, "holds"), (15.0, "fails"), (20.0, "undecided")],
    ids=["darkness harms", "the gain is none of light", "half by some builds"],
)
def test_robust_in_the_dark_is_an_effect_of_light_and_a_half(untuned_dark_cm: float, verdict: str) -> None:
    rows = [
        flight(tuned, size, light, build, error)
        for build in range(3)
        for size in SIZES
        for tuned, light, error in (
            (True, "L3", 9.0 + build),
            (False, "L3", untuned_dark_cm),
            (False, "L1", 18.0),
            (True, AS_RECORDED, 4.0),
            (False, AS_RECORDED, 20.0),
        )
    ]
    found = {each.claim: each.verdict for each in decide(rows, SPLIT, SIZES) if each.method == CLAIMED[-1].name}
    assert found["more robust in the dark than nothing tuned"] == verdict
    assert found["a small change of the map is enough"] == "holds"
