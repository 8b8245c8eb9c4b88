"""Numbers of README and of the results' tables are those of the kept data, to the digits that they show."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from monoloc_lab.experiments.interval import interval_of
from repository import REPOSITORY

DATA = REPOSITORY / "docs" / "results"
ROUNDING = 0.005  # of the kept data, in the data's units
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?")

Rows = Sequence[dict[str, str]]


def table_of(name: str) -> Rows:
    with (DATA / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


FLIGHTS = table_of("this-version.csv")
RENDERED_FLIGHTS = table_of("rendered-rooms.csv")
KITCHEN = json.loads((DATA / "reproduce-redkitchen.json").read_text())["figures"]
LIVING_ROOM = json.loads((DATA / "reproduce-living-room.json").read_text())["figures"]


def chosen(rows: Rows, **labels: str) -> Rows:
    found = [row for row in rows if all(row[name] == value for name, value in labels.items())]
    assert found, labels
    return found


def values(rows: Rows, column: str) -> list[float]:
    return [float(row[column]) for row in rows]


def over_builds(rows: Rows, column: str) -> list[float]:
    """Median over builds of the median over flights, and the interval over builds."""
    builds = sorted({row["build"] for row in rows})
    interval = interval_of([float(np.median(values(chosen(rows, build=build), column))) for build in builds])
    assert interval.low is not None and interval.high is not None
    return [interval.median, interval.low, interval.high]


def middle(rows: Rows, column: str) -> list[float]:
    return over_builds(rows, column)[:1]


def total(rows: Rows, column: str) -> float:
    return sum(values(rows, column))


def tracking_percent(rows: Rows) -> float:
    return 100.0 * float(np.average(values(rows, "tracking"), weights=values(rows, "frames")))


def agree(text: str, expected: Iterable[float]) -> None:
    """The numbers in a text are the expected ones, in order, to the digits that they show."""
    shown = NUMBER.findall(text)
    expected = list(expected)
    assert len(shown) == len(expected), (text, expected)
    for number, value in zip(shown, expected, strict=True):
        digits = len(number.partition(".")[2])
        assert abs(float(number) - value) <= 0.5 * 10.0**-digits + ROUNDING, (text, expected)


def section(document: str, heading: str) -> str:
    text = (REPOSITORY / document).read_text(encoding="utf-8")
    return re.split(r"\n##? ", text.split(f"\n## {heading}\n")[1])[0]


def cells_of(text: str) -> list[list[str]]:
    """Rows of the first table, without its head."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip().replace("**", "") for cell in line.strip("|").split("|")] for line in lines[2:]]


# --- Tables ---


def test_table_of_this_version() -> None:
    rows = cells_of(section("docs/results.md", "This version"))
    assert len(rows) == len({(row["built_from"], row["flown"], row["method"]) for row in FLIGHTS})
    for where, method, *shown in rows:
        built_from, flown = where.split(", ")
        found = chosen(FLIGHTS, built_from=built_from, flown=flown, method=method)
        expected = [
            over_builds(found, "median_cm"),
            over_builds(found, "rmse_cm"),
            middle(found, "rotation_median_deg"),
            [*middle(found, "coverage_95"), *middle(found, "coverage_99")],
            [tracking_percent(found)],
            [total(found, name) for name in ("silent_30cm", "silent_3_5_sigma", "frames")],
        ]
        for text, numbers in zip(shown, expected, strict=True):
            agree(text, numbers)


LIGHTS = ("L1", "L2", "L3")


def test_table_of_the_rendered_rooms() -> None:
    text = section("docs/results.md", "This version").split("Two rendered rooms")[1].replace("\n  |", "\n|")
    rows = cells_of(text.split("\n\n- ")[0])
    assert len(rows) == len({(row["room"], row["method"]) for row in RENDERED_FLIGHTS})
    for room, method, *shown in rows:
        found = chosen(RENDERED_FLIGHTS, room=room, method=method)
        by_light = [chosen(found, light=light) for light in LIGHTS]
        expected = [
            *([median_of(rows, name) for rows in by_light] for name in ("median_cm", "rmse_cm", "odometry_rmse_cm")),
            [median_of(rows, "coverage_95") for rows in by_light],
            [tracking_percent(rows) for rows in by_light],
            [total(found, name) for name in ("silent_30cm", "silent_3_5_sigma", "frames")],
        ]
        for cell, numbers in zip(shown, expected, strict=True):
            agree(cell, numbers)


def median_of(rows: Rows, column: str) -> float:
    return float(np.median(values(rows, column)))


def rmse_by_build(method: str, column: dict[str, str]) -> dict[str, float]:
    rows = chosen(FLIGHTS, method=method, **column)
    builds = sorted({row["build"] for row in rows})
    return {build: float(np.median(values(chosen(rows, build=build), "rmse_cm"))) for build in builds}


def test_what_scans_add() -> None:
    text = (REPOSITORY / "docs" / "results.md").read_text(encoding="utf-8")
    (sentence,) = re.findall(r"The RMSE of the default is (.*?) at the desk, build by build", text)
    ratios = []
    for column in COLUMNS:
        default, without_scans = (rmse_by_build(method, column) for method in ("default", "without scans"))
        ratios.append(interval_of([default[build] / without_scans[build] for build in default]))
    agree(
        sentence, [number for each in ratios for number in (each.median, each.low, each.high) if number is not None]
    )


def spread(found: Iterable[float | None], digits: int = 2) -> list[float]:
    """Median, smallest and largest of what is known; one number where they are equal to the digits shown."""
    known = [value for value in found if value is not None]
    numbers = [float(np.median(known)), min(known), max(known)] if known else []
    return numbers[:1] if len({f"{number:.{digits}f}" for number in numbers}) == 1 else numbers


def test_table_of_recovery() -> None:
    rows = iter(
        cells_of(section("docs/results.md", "This version").split("bench recovery")[1].replace("\n  |", "\n|"))
    )
    for room in ("redkitchen", "desk"):
        builds = json.loads((DATA / f"recovery-{room}.json").read_text())
        assert [build["build"] for build in builds] == [2, 3, 4]
        for part in ("near", "away", None):
            _, starts, kidnaps, alarms, false, edits, coverage = next(rows)
            found = [build if part is None else build[part] for build in builds]
            agree(starts, [*spread(each["global_start_rate"] for each in found), found[0]["starts"]])
            agree(kidnaps, [*spread(each["kidnap_recovery_rate"] for each in found), found[0]["kidnaps"]])
            agree(alarms, spread((100.0 * each["false_alarm_rate"] for each in found), 1))
            agree(coverage, spread(each["coverage_95"] for each in found))
            if part is None:
                agree(false, spread((100.0 * each["false_tracking_rate"] for each in found), 1))
                agree(edits, spread(each["map_changed_rate"] for each in found))


def test_table_of_recovery_of_other_bundles() -> None:
    bundles = json.loads((DATA / "recovery-others.json").read_text())
    text = (
        section("docs/results.md", "This version").split("an untuned bundle in each room")[1].replace("\n  |", "\n|")
    )
    for bundle, (name, starts, kidnaps, *rates, coverage) in zip(
        bundles, cells_of(text.split("\n\n- ")[0]), strict=True
    ):
        parts = bundle["near"], bundle["away"]
        assert name == bundle["bundle"] and bundle["wrong_place_rate"] == 0.0
        for shown, rate, count in (
            (starts, "global_start_rate", "starts"),
            (kidnaps, "kidnap_recovery_rate", "kidnaps"),
        ):
            agree(shown, [each for part in parts for each in (part[rate], part[count]) if each is not None])
        for shown, rate in zip(rates, ("false_alarm_rate", "false_tracking_rate"), strict=True):
            agree(shown, [100.0 * bundle[rate]])
        agree(coverage, [bundle["coverage_95"], bundle["coverage_99"]])


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
    rows = cells_of(section("README.md", "Accuracy"))
    assert [row[0] for row in rows] == [name for name, _ in README_ROWS]
    for (_, numbers), (_, *shown) in zip(README_ROWS, rows, strict=True):
        for text, column in zip(shown, COLUMNS, strict=True):
            agree(text, numbers(column))


# --- Sentences ---

DESK_BEYOND = chosen(FLIGHTS, method="default", **COLUMNS[3])
KITCHEN_BETWEEN = chosen(FLIGHTS, method="default", **COLUMNS[0])


def rendered_rmse_cm(room: str, light: str) -> float:
    return median_of(chosen(RENDERED_FLIGHTS, room=room, light=light, method="default"), "rmse_cm")


def sift_rmse_cm(light: str) -> float:
    return 100.0 * float(LIVING_ROOM["fig5b"]["living room"]["by light"]["SIFT keypoints"][light]["median"])


SENTENCES: tuple[tuple[str, Sequence[float]], ...] = (
    (r"\d+ % of the frames are \*tracking\*", [tracking_percent(DESK_BEYOND)]),
    (
        r"Of these \d+ frames, \d+ were wrongly \*tracking\* \(\d+ over 30 cm off, \d+ beyond 3.5 sigma\)",
        [
            total(DESK_BEYOND, "frames"),
            total(DESK_BEYOND, "silent_30cm") + total(DESK_BEYOND, "silent_3_5_sigma"),
            total(DESK_BEYOND, "silent_30cm"),
            30,
            total(DESK_BEYOND, "silent_3_5_sigma"),
            3.5,
        ],
    ),
    (
        r"of the \d+ of RedKitchen, interpolation, \d+ \(\d+ and \d+\)",
        [
            total(KITCHEN_BETWEEN, "frames"),
            total(KITCHEN_BETWEEN, "silent_30cm") + total(KITCHEN_BETWEEN, "silent_3_5_sigma"),
            total(KITCHEN_BETWEEN, "silent_30cm"),
            total(KITCHEN_BETWEEN, "silent_3_5_sigma"),
        ],
    ),
    (
        r"the RMSE is [\d.]+ and [\d.]+ cm in medium light, and [\d.]+ and [\d.]+ cm in near darkness "
        r"\(1 build a room, \d flights a light\)",
        [
            *(rendered_rmse_cm(room, light) for light in ("L2", "L3") for room in ("living room", "dining room")),
            1,
            len({row["flight"] for row in RENDERED_FLIGHTS}),
        ],
    ),
    (r"SIFT is more exact, with an RMSE of [\d.]+ cm", [sift_in_kitchen_cm("interpolation")]),
    (r"SIFT had [\d.]+ and [\d.]+ cm \(1 run\)", [sift_rmse_cm("L2"), sift_rmse_cm("L3"), 1]),
    (
        r"the network [\d.]+ MB, landmarks [\d.]+ to [\d.]+ MB, the mixture \d+ kB",
        [
            KITCHEN["table1"]["depth networks"]["full"]["bytes"] / 1e6,
            0.2,
            0.4,
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
    "0:400:4": "frames",
    "0:350:7": "frames",
    "0:300:3": "frames",
    "300:400": "frames",
    "350:500": "frames",
    "0:300": "frames",
    "0:350": "frames",
    "10 cm and 3° off": "the starts of the flights",
    "1.5 cm and 1.7°": "stated by those who recorded the desk",
    "15 to 20 cm": "measured elsewhere, without kept data",
    "0.35 m from the nearest build frame": "of the recordings, in the median",
    "17 cm off, odometry alone 18 cm": "written in the picture",
}


@pytest.mark.parametrize(("pattern", "expected"), SENTENCES)
def test_sentence_of_readme(pattern: str, expected: Sequence[float]) -> None:
    (text,) = re.findall(f"({pattern})", (REPOSITORY / "README.md").read_text(encoding="utf-8"))
    agree(text, expected)


def without(text: str, patterns: Iterable[Any]) -> str:
    for pattern in patterns:
        text = re.sub(pattern, "", text)
    return text


def test_every_other_number_of_readme_is_none_that_was_measured() -> None:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    text = without(text, [r"(?s)```.*?```", r"\]\([^)]*\)", r"(?m)^\|.*$", r"`[^`]*`"])
    text = without(text, (pattern for pattern, _ in SENTENCES))
    for phrase in sorted(NOT_OF_THE_DATA, key=len, reverse=True):
        text = text.replace(phrase, "")
    assert NUMBER.findall(text) == []


# --- The paper's method ---


def test_sentences_of_the_papers_method() -> None:
    text = (REPOSITORY / "docs" / "beyond-the-paper.md").read_text(encoding="utf-8")
    kept = json.loads((DATA / "paper-method.json").read_text())
    between, beyond, many = ([flight["median_cm"], flight["rmse_cm"]] for flight in kept["flights"])
    sentences = {
        r"has a median of [\d.]+ cm and an RMSE of [\d.]+ cm between the build frames": between,
        r"and [\d.]+ and [\d.]+ cm beyond them": beyond,
        r"Ten times the particles, beyond, give \d+ and \d+ cm": many,
        r"falls from [\d.]+ to [\d.]+ %": [100.0 * error for error in kept["held_out_absrel"]],
        r"moved by [\d.]+ cm in the median": [kept["shift_median_cm"]],
    }
    for pattern, expected in sentences.items():
        (found,) = re.findall(pattern, text)
        agree(found, expected)
