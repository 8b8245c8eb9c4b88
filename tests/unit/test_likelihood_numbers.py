"""Either likelihood with a tuned network: the table and its sentences are those of the kept flights."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from document_numbers import (
    agree,
    agree_sentence,
    by_build,
    chosen,
    middle,
    spread,
    table_of,
    tables_of,
    tracking_percent,
)

PAGE, HEADING = "docs/beyond-the-paper.md", "Either likelihood, tuned as in the default"
FLIGHTS = table_of("likelihood.csv")
WITH = {"depth alone": "without", "landmarks": "with"}
ROWS = {row[0]: row[1:] for table in tables_of(PAGE) if table.place[0] == HEADING for row in table.rows}
CASES = [
    (room, split, name)
    for name in WITH
    for room in ("RedKitchen", "desk")
    for split in ("interpolation", "extrapolation")
]


def ratios_of(room: str, split: str, name: str) -> list[float]:
    """RMSE by the ray likelihood over that by the volume likelihood, build by build."""
    rows = chosen(FLIGHTS, room=room, split=split, landmarks=WITH[name])
    ray, volume = (by_build(chosen(rows, likelihood=kind), "rmse_cm") for kind in ("ray", "volume"))
    return [ray[build] / volume[build] for build in ray]


def verdict_of(ratios: list[float]) -> str:
    return "better" if max(ratios) < 1.0 else "worse" if min(ratios) > 1.0 else "undecided"


def test_every_case_was_flown_alike() -> None:
    flown = [
        (row["room"], row["split"], row["build"], row["start"], row["likelihood"], row["landmarks"])
        for row in FLIGHTS
    ]
    cases = product(
        ("RedKitchen", "desk"), ("interpolation", "extrapolation"), "01234", "01", ("ray", "volume"), WITH.values()
    )
    assert sorted(flown) == sorted(cases)
    assert all(row["silent_30cm"] == "0" for row in FLIGHTS)
    assert len(ROWS) == len(CASES)


@pytest.mark.parametrize(("room", "split", "name"), CASES)
def test_rows_are_those_of_the_flights(room: str, split: str, name: str) -> None:
    rows = chosen(FLIGHTS, room=room, split=split, landmarks=WITH[name])
    both = [chosen(rows, likelihood=kind) for kind in ("ray", "volume")]
    *rmse, medians, coverage, tracking, ratio = ROWS[f"{room}, {split}, {name}"]
    for cell, of in zip(rmse, both, strict=True):
        agree(cell, spread(by_build(of, "rmse_cm").values(), digits=3))
    agree(medians, [middle(of, "median_cm")[0] for of in both])
    agree(coverage, [middle(of, "coverage_95")[0] for of in both])
    agree(tracking, [tracking_percent(of) for of in both])
    ratios = ratios_of(room, split, name)
    agree(ratio, spread(ratios, digits=3))
    assert ratio.split()[-1] == verdict_of(ratios)


def test_sentences() -> None:
    verdicts = {case: verdict_of(ratios_of(*case)) for case in CASES}
    undecided = [case for case, verdict in verdicts.items() if verdict == "undecided"]
    assert undecided == [
        ("desk", "extrapolation", "depth alone"),
        *(case for case in CASES if case[0::2] == ("RedKitchen", "landmarks")),
    ]
    assert sorted(verdicts.values()) == ["better"] * 5 + ["undecided"] * 3
    assert sum(ratio < 1.0 for ratio in ratios_of(*undecided[0])) == 3
    best = float(np.median(ratios_of("RedKitchen", "interpolation", "depth alone")))
    agree_sentence(PAGE, "By depth alone in RedKitchen it has {} times the RMSE between", [best])
    desk = chosen(FLIGHTS, room="desk", split="interpolation", landmarks="with")
    ray, volume = (middle(chosen(desk, likelihood=kind), "rmse_cm")[0] for kind in ("ray", "volume"))
    agree_sentence(PAGE, "the gain at the desk is {} cm", [volume - ray])
    widths = {(row["room"], row["likelihood"]): float(row["width"]) for row in FLIGHTS}
    shown = [widths["desk", "ray"], widths["RedKitchen", "volume"], widths["desk", "volume"]]
    agree_sentence(
        PAGE,
        "{} of the depth for the ray likelihood, the smallest that is tried, and {} m in RedKitchen and {} m",
        shown,
    )
    assert len({(row["room"], row["likelihood"], row["width"]) for row in FLIGHTS}) == len(widths)
