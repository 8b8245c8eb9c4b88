"""What docs/beyond-the-paper.md says of the ladder is what the kept flights say."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from monoloc_lab.experiments.interval import interval_of, medians_of_builds
from monoloc_lab.experiments.ladder import ladder_table, pairs_table, ratio
from monoloc_lab.experiments.rungs import RUNGS, all_rungs
from repository import REPOSITORY

DOCS = REPOSITORY / "docs"
ROWS: list[dict[str, Any]] = json.loads((DOCS / "results" / "ladder.json").read_text())
RENDERED: list[dict[str, Any]] = json.loads((DOCS / "results" / "ladder-rendered.json").read_text())
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
            interval_of(list(medians_of_builds(of_room(title), "rmse_cm", split=split, rung=rung).values())).median
            for title in ROOMS
            for split in SPLITS
        ]
        assert "{:.0f}, {:.0f}, {:.0f} and {:.0f} cm".format(*errors) in PAGE


def each_row(method: str, column: str = "rmse_cm") -> list[float]:
    """Medians over builds: RedKitchen between and beyond, the desk between and beyond."""
    return [
        interval_of(list(medians_of_builds(of_room(title), column, split=split, rung=method).values())).median
        for title in ROOMS
        for split in SPLITS
    ]


def ratios(method: str, other: str) -> list[float]:
    found = [ratio(of_room(title), split, method, other) for title in ROOMS for split in SPLITS]
    return [each.median for each in found if each is not None]


TUNED, UNTUNED = each_row("the default"), each_row("nothing tuned")
BY_DEPTH = ratios("the default, depth alone", "nothing tuned, depth alone")
DESK_BEYOND = medians_of_builds(of_room("Office desk"), "rmse_cm", split="beyond", rung="the default")
DESK_FLIGHTS = [row for row in of_room("Office desk") if (row["split"], row["rung"]) == ("beyond", RUNGS[-1].name)]
SENTENCES: tuple[tuple[str, list[float]], ...] = (
    (
        r"Its RMSE is (\d+) cm between and (\d+) cm beyond the build frames in RedKitchen, and (\d+) and (\d+) cm at",
        each_row("the paper's method"),
    ),
    (
        r"the RMSE falls to ([\d.]+) of what it was, in both rooms",
        [max(ratios("+ decoder", "+ pose-step loss")[::2])],
    ),
    (
        r"depth alone stays at (\d+) and (\d+) cm in RedKitchen and (\d+) and (\d+) cm at the desk",
        each_row("last layer tuned, losses of the default, depth alone"),
    ),
    (r"the default has ([\d.]+) to ([\d.]+) of the RMSE of a bundle that nothing", [min(BY_DEPTH), max(BY_DEPTH)]),
    (
        r"it is ([\d.]+) to ([\d.]+) cm and ([\d.]+) to ([\d.]+) cm between the build frames, "
        r"and ([\d.]+) to ([\d.]+) cm in",
        [UNTUNED[0], TUNED[0], UNTUNED[2], TUNED[2], UNTUNED[1], TUNED[1]],
    ),
    (r"builds is worse, (\d+) after (\d+) cm", [TUNED[3], UNTUNED[3]]),
    (
        r"coverage rises from ([\d.]+) to ([\d.]+) to (\d.\d+)",
        [
            min(each_row("+ scale and tilt", "coverage_95")),
            max(each_row("+ scale and tilt", "coverage_95")),
            min(each_row("+ bias filter", "coverage_95")),
        ],
    ),
    (
        r"Two of three builds end it (\d+) to (\d+) cm off, the third (\d+) cm. Of (\d+) frames (\d+) were silently",
        [
            *sorted(DESK_BEYOND.values())[1:],
            min(DESK_BEYOND.values()),
            sum(row["frames"] for row in DESK_FLIGHTS),
            sum(row["silent_30cm"] for row in DESK_FLIGHTS),
        ],
    ),
)


@pytest.mark.parametrize(("pattern", "expected"), SENTENCES)
def test_sentence(pattern: str, expected: list[float]) -> None:
    (found,) = re.findall(pattern, PAGE)
    shown = found if isinstance(found, tuple) else (found,)
    assert [*shown] == [
        f"{value:.{len(text.partition('.')[2])}f}" for text, value in zip(shown, expected, strict=True)
    ]


LIGHTS = ("L1", "L2", "L3")


def in_light(method: str, light: str, column: str) -> float:
    """Of the build of the rendered room."""
    rows = [row for row in RENDERED if row["split"] == f"living room, {light}"]
    (value,) = medians_of_builds(rows, column, split=f"living room, {light}", rung=method).values()
    return value


def test_table_of_the_rendered_room() -> None:
    (shown,) = tables_of("Rendered living room")
    assert [row[0] for row in shown] == [rung.name for rung in all_rungs()]
    for name, *errors, depth, coverage in shown:
        assert errors == [f"{in_light(name, light, 'rmse_cm'):.1f}" for light in LIGHTS]
        assert depth == f"{100.0 * in_light(name, 'L2', 'depth_absrel'):.1f}"
        assert coverage == ", ".join(f"{in_light(name, light, 'coverage_95'):.2f}" for light in LIGHTS)


@pytest.mark.parametrize(
    ("words", "method"),
    [
        ("its RMSE is {:.0f}, {:.0f} and {:.0f} cm in L1, L2 and L3", "the paper's method"),
        ("changes {:.0f}, {:.0f} and {:.0f} cm to", "+ pose-step loss"),
        ("to {:.0f}, {:.0f} and {:.0f} cm; all layers", "+ decoder"),
        ("all layers leave {:.0f}, {:.0f} and {:.0f} cm", "+ all layers"),
        ("odometry, to {:.0f}, {:.0f} and {:.0f} cm", "+ odometry"),
        ("{:.1f}, {:.1f} and {:.1f} cm with nothing tuned", "nothing tuned"),
        ("{:.1f}, {:.1f} and {:.1f} cm with the default", "the default"),
        ("With the map as it is, they are {:.1f}, {:.1f} and {:.1f} cm", "network tuned, map as it is"),
        ("with the last layer alone, {:.1f}, {:.1f} and {:.1f} cm", "last layer tuned, losses of the default"),
    ],
)
def test_sentence_on_the_rendered_room(words: str, method: str) -> None:
    assert words.format(*(in_light(method, light, "rmse_cm") for light in LIGHTS)) in PAGE


def test_every_method_was_built_and_flown_three_times_by_a_known_commit() -> None:
    flown = {(row["room"], row["rung"], row["build_seed"], row["flight"], row["split"]) for row in ROWS}
    assert len(flown) == len(ROWS) == len(ROOMS) * len(all_rungs()) * 3 * 2 * len(SPLITS)
    for row in ROWS:
        assert re.fullmatch("[0-9a-f]{12}", row["bundle_commit"])
        assert re.fullmatch("[0-9a-f]{12}", row["flight_commit"])
