"""What docs/beyond-the-paper.md says of the ladder is what the kept flights say."""

from __future__ import annotations

import json
import re
from statistics import fmean
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
SPLITS = ("interpolation", "extrapolation")


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
    near_pairs, far_pairs = (pairs_table(rows, split) for split in SPLITS)
    assert pairs == [
        [near[0], near[2], *(part for each in (near, far) for part in pair_cells(each))]
        for near, far in zip(near_pairs, far_pairs, strict=True)
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
    """Medians over builds: RedKitchen, interpolation and extrapolation; the same of the desk."""
    return [
        interval_of(list(medians_of_builds(of_room(title), column, split=split, rung=method).values())).median
        for title in ROOMS
        for split in SPLITS
    ]


def ratios(method: str, other: str) -> list[float]:
    found = [ratio(of_room(title), split, method, other) for title in ROOMS for split in SPLITS]
    return [each.median for each in found if each is not None]


TUNED, UNTUNED = each_row("the default"), each_row("untuned")
BY_DEPTH = ratios("the default, depth alone", "untuned, depth alone")
DESK_BEYOND = medians_of_builds(of_room("Office desk"), "rmse_cm", split="extrapolation", rung="the default")
DESK_FLIGHTS = [row for row in of_room("Office desk") if (row["split"], row["rung"]) == (SPLITS[1], RUNGS[-1].name)]
WITHOUT_SEARCH = medians_of_builds(of_room("Office desk"), "rmse_cm", split="extrapolation", rung="+ landmarks")
SENTENCES: tuple[tuple[str, list[float]], ...] = (
    (
        r"Its RMSE is (\d+) cm \(interpolation\) and (\d+) cm \(extrapolation\) in RedKitchen, and (\d+) and (\d+)",
        each_row("the paper's method"),
    ),
    (
        r"The RMSE falls to ([\d.]+) of that of the row above, in both rooms; it is then ([\d.]+) times that of the "
        r"paper's method in RedKitchen and ([\d.]+) times at the desk. Beyond the build frames it falls to ([\d.]+) "
        r"in Red",
        [
            max(ratios("+ decoder", "+ pose-step loss")[::2]),
            *ratios("+ decoder", "the paper's method")[::2],
            ratios("+ decoder", "+ pose-step loss")[1],
        ],
    ),
    (
        r"RedKitchen stays at (\d+) to (\d+) cm. At the desk, the five additions raise the RMSE from (\d+) to "
        r"(\d+) cm \(interpolation\) and from (\d+) to (\d+) cm",
        [
            min(error for rung in RUNGS[:6] for error in each_row(rung.name)[:2]),
            max(error for rung in RUNGS[:6] for error in each_row(rung.name)[:2]),
            *(each_row(rung.name)[row] for row in (2, 3) for rung in (RUNGS[0], RUNGS[5])),
        ],
    ),
    (
        r"The ray likelihood is worse at the desk in both rows \(([\d.]+) and ([\d.]+) times the RMSE\)",
        ratios(RUNGS[2].name, RUNGS[1].name)[2:],
    ),
    (
        r"give ([\d.]+) and ([\d.]+) cm by depth alone in RedKitchen, and (\d+) and (\d+) cm at the desk",
        each_row("all layers tuned, by likelihood alone, depth alone"),
    ),
    (
        r"depth alone stays at (\d+) and (\d+) cm in RedKitchen and (\d+) and (\d+) cm at the desk",
        each_row("last layer tuned, losses of the default, depth alone"),
    ),
    (r"the default has ([\d.]+) to ([\d.]+) of the RMSE of an untuned bundle", [min(BY_DEPTH), max(BY_DEPTH)]),
    (
        r"lowers the RMSE from ([\d.]+) to ([\d.]+) cm and from ([\d.]+) to ([\d.]+) cm between the build frames, "
        r"and from ([\d.]+) to ([\d.]+) cm in",
        [UNTUNED[0], TUNED[0], UNTUNED[2], TUNED[2], UNTUNED[1], TUNED[1]],
    ),
    (r"untuned bundles have ([\d.]+) cm and tuned ones ([\d.]+) cm, which is undecided", [UNTUNED[3], TUNED[3]]),
    (
        r"coverage is ([\d.]+) to ([\d.]+) without it and (\d.\d+) with it",
        [
            min(each_row("+ scale and tilt", "coverage_95")),
            max(each_row("+ scale and tilt", "coverage_95")),
            min(each_row("+ bias filter", "coverage_95")),
        ],
    ),
    (
        r"Two of five builds have an RMSE of (\d+) and (\d+) cm, with errors of up to (\d+) cm; the others have "
        r"(\d+) to (\d+) cm. The search by scans caused one of the two, which has ([\d.]+) cm without any search. "
        r"The other has (\d+) cm without a search, too. Of (\d+) frames (\d+) were silently",
        [
            *sorted(DESK_BEYOND.values())[3:],
            max(row["largest_cm"] for row in DESK_FLIGHTS),
            *sorted(DESK_BEYOND.values())[0:3:2],
            WITHOUT_SEARCH[0],
            WITHOUT_SEARCH[1],
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


def test_number_of_steps_that_are_decided() -> None:
    verdicts = [row[-2] for title in ROOMS for split in SPLITS for row in ladder_table(of_room(title), split)[1:]]
    decided = len(verdicts) - verdicts.count("undecided")
    assert (
        f"Of the {len(verdicts)} steps of the ladder {decided} are decided; chance alone would decide 3 or 4" in PAGE
    )


LIGHTS = ("L1", "L2", "L3")
LIVING, DINING = "living room", "dining room"
MAP_AS_IT_IS = "network tuned, map as it is"


def in_light(room: str, method: str, light: str, column: str) -> float:
    """Of the builds of a rendered room, their mean: there are two."""
    return fmean(of_builds(room, method, light, column))


def of_builds(room: str, method: str, light: str, column: str) -> list[float]:
    rows = [row for row in RENDERED if row["room"] == f"rendered {room}"]
    return [*medians_of_builds(rows, column, split=f"{room}, {light}", rung=method).values()]


def test_number_of_builds_of_the_rendered_rooms() -> None:
    for room in (LIVING, DINING):
        assert all(len(of_builds(room, rung.name, light, "rmse_cm")) == 2 for rung in all_rungs() for light in LIGHTS)
    assert "[rendered rooms](#rendered-rooms) have two builds each." in PAGE
    assert "**Two builds a room**" in PAGE


def test_table_of_the_rendered_rooms() -> None:
    (shown,) = tables_of("Rendered rooms")
    assert [row[0] for row in shown] == [rung.name for rung in all_rungs()]
    for name, *cells in shown:
        expected: list[str] = []
        for room in (LIVING, DINING):
            expected.append(", ".join(f"{in_light(room, name, light, 'rmse_cm'):.1f}" for light in LIGHTS))
            expected.append(f"{100.0 * in_light(room, name, 'L2', 'depth_absrel'):.1f}")
            expected.append(", ".join(f"{in_light(room, name, light, 'coverage_95'):.2f}" for light in LIGHTS))
        assert cells == expected


@pytest.mark.parametrize(
    ("words", "digits", "of"),
    [
        (
            "{} in L1, L2 and L3 of the living room, and {} in the dining",
            0,
            ["the paper's method", "the paper's method"],
        ),
        ("changes {} to {} in the living", 0, [(LIVING, "+ pose-step loss"), (LIVING, "+ decoder")]),
        ("and {} to {} in the dining room. All", 0, [(DINING, "+ pose-step loss"), (DINING, "+ decoder")]),
        ("All layers leave {}, and {}.", 0, ["+ all layers", "+ all layers"]),
        ("Odometry brings them to {}, and {};", 0, ["+ odometry", "+ odometry"]),
        ("landmarks to {}, and {}.", 1, ["+ landmarks", "+ landmarks"]),
        ("lower the RMSE from {} to {}", 0, [(LIVING, "+ scale and tilt"), (LIVING, "+ known bias")]),
        ("it is {} untuned and {} with the default", 1, [(LIVING, "untuned"), (LIVING, "the default")]),
        ("in the dining room {} and {}.", 1, [(DINING, "untuned"), (DINING, "the default")]),
        ("the map as it is, the RMSE is {}.", 1, [(DINING, MAP_AS_IT_IS)]),
        ("it is {} with landmarks", 1, [(LIVING, MAP_AS_IT_IS)]),
    ],
)
def test_sentence_on_the_rendered_rooms(words: str, digits: int, of: list[str | tuple[str, str]]) -> None:
    """Of one method in both rooms, or of methods in one room."""
    pairs = [
        each if isinstance(each, tuple) else (room, each) for room, each in zip((LIVING, DINING), of, strict=False)
    ]
    errors = [
        "{}, {} and {} cm".format(*(f"{in_light(*pair, light, 'rmse_cm'):.{digits}f}" for light in LIGHTS))
        for pair in pairs
    ]
    assert words.format(*errors) in PAGE


@pytest.mark.parametrize(
    ("words", "first", "second"),
    [
        ("in one build its RMSE goes from {} to {}. In the other", "+ scale and tilt", "+ known bias"),
        ("first, {} in place of {}, and", f"{MAP_AS_IT_IS}, depth alone", "the default, depth alone"),
    ],
)
def test_sentence_on_each_build_of_the_dining_room(words: str, first: str, second: str) -> None:
    ours, theirs = (
        [
            "{:.0f}, {:.0f} and {:.0f} cm".format(
                *(of_builds(DINING, rung, light, "rmse_cm")[build] for light in LIGHTS)
            )
            for rung in (first, second)
        ]
        for build in (0, 1)
    )
    assert words.format(*ours) in PAGE
    assert "from {} to {}; this".format(*theirs) in PAGE or "second, {} in place of {}.".format(*theirs) in PAGE


def test_all_layers_by_likelihood_alone_in_the_rendered_rooms() -> None:
    method = "all layers tuned, by likelihood alone"
    ruined, kept, *in_dining = (
        f"{100.0 * value:.0f}" for room in (LIVING, DINING) for value in of_builds(room, method, "L2", "depth_absrel")
    )
    ((share,),) = {tuple(in_dining[:1]), tuple(in_dining[1:])}
    assert f"{ruined} and {kept} % in the living room, and {share} % in both builds of the dining room." in PAGE
    of_kept = {
        rung.name: [of_builds(LIVING, rung.name, light, "rmse_cm")[1] for light in LIGHTS] for rung in all_rungs()
    }
    assert min(of_kept, key=lambda name: fmean(of_kept[name])) == method
    assert "{:.1f}, {:.1f} and {:.1f} cm.".format(*of_kept[method]) in PAGE


def test_in_how_many_cases_tuning_lowers_the_rmse_with_landmarks() -> None:
    lower = sum(
        in_light(room, "the default", light, "rmse_cm") < in_light(room, "untuned", light, "rmse_cm")
        for room in (LIVING, DINING)
        for light in LIGHTS
    )
    assert lower == 4 and "tuning lowers the RMSE in four of six cases" in PAGE


def test_frames_that_were_silently_wrong_in_the_dining_room() -> None:
    (l1, l2, l3), untuned = (
        [
            tuple(
                sum(row[name] for row in RENDERED if (row["split"], row["rung"]) == (f"dining room, {light}", rung))
                for name in ("silent_30cm", "frames")
            )
            for light in LIGHTS
        ]
        for rung in ("the default", "untuned")
    )
    assert l1[0] == l3[0] == 0
    assert f"in {l2[0]} of {l2[1]} frames in L2, and in none in L1 and L3." in PAGE
    assert untuned[1][0] == 0
    assert f"The untuned bundles were in {untuned[2][0]} of {untuned[2][1]} frames in L3, and in none in L2." in PAGE


def test_every_method_was_built_five_times_and_flown_by_a_known_commit() -> None:
    flown = {(row["room"], row["rung"], row["build_seed"], row["flight"], row["split"]) for row in ROWS}
    assert len(flown) == len(ROWS) == len(ROOMS) * len(all_rungs()) * 5 * 2 * len(SPLITS)
    for row in ROWS:
        assert re.fullmatch("[0-9a-f]{12}", row["bundle_commit"])
        assert re.fullmatch("[0-9a-f]{12}", row["flight_commit"])
