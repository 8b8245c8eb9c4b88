"""Sentences of docs/results-of-earlier-versions.md show numbers of the kept data."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from document_numbers import (
    Rows,
    Sentence,
    agree_sentence,
    chosen,
    json_of,
    median_of,
    middle,
    numbers,
    only,
    other_numbers,
    page,
    sections_of,
    table_of,
    total,
    tracking_percent,
    values,
)
from kept_flights import DESK_BEYOND, KITCHEN_BETWEEN, STRETCHES

PAGE = "docs/results-of-earlier-versions.md"
SPLITS = ("interpolation", "extrapolation")
FLIGHTS = table_of("flights-of-earlier-versions.csv")
RECOVERY: list[dict[str, Any]] = json_of("recovery-of-earlier-versions.json")
FAULTS: dict[str, dict[str, Any]] = {
    each["room"]: each["faults"] for each in json_of("faults-of-earlier-versions.json")
}
BUILD_0 = {room: FAULTS[f"{room}, build 0 of 6fcafb4"] for room in ("redkitchen", "desk")}
LENSES = [name for name in FAULTS["desk"] if name.startswith("intrinsics")]
LOCALIZATION = [row for row in table_of("localization.csv") if row["room"] == "RedKitchen" and row["builds"] == "3"]
BASELINES = chosen(table_of("baselines.csv"), room="RedKitchen", light="as recorded")
KITCHEN = json_of("reproduce-redkitchen.json")["figures"]
RELOCALISATION = table_of("relocalization.csv")
WITHOUT_ODOMETRY = table_of("without-odometry.csv")


def extremes(found: Iterable[float]) -> list[float]:
    found = list(found)
    return [min(found), max(found)]


# --- The versions before this one ---


def of_version(commit: str, method: str, stretch: int) -> Rows:
    built_from, frames = STRETCHES[stretch]
    return chosen(FLIGHTS, flown_by=commit, method=method, built_from=built_from, flown=frames)


METHODS = ("default", "without landmarks", "untuned")
STATED = ("default", "without scans", "untuned")


def of_all_stretches(commit: str, methods: tuple[str, ...] = METHODS) -> list[float]:
    """RMSE, median over builds, by method and stretch."""
    return [middle(of_version(commit, method, stretch), "rmse_cm")[0] for method in methods for stretch in range(4)]


def silent_beyond_the_desk(commit: str, *methods: str) -> list[float]:
    """Frames silently beyond 3.5 sigma at the desk, extrapolation, and all of them, by method."""
    return [
        total(of_version(commit, method, DESK_BEYOND), column)
        for method in methods
        for column in ("silent_3_5_sigma", "frames")
    ]


def of_flights(rows: Rows, column: str) -> list[float]:
    """Median, smallest and largest over the flights of two builds, which have no interval."""
    return [median_of(rows, column), *extremes(values(rows, column))]


def recovered(room: str, commit: str, *builds: int) -> list[dict[str, Any]]:
    found = [each for each in RECOVERY if each["room"] == room and each["build"] in builds]
    return [each for each in found if each["flown_by"].startswith(commit)]


LANDMARKS, DEPTH_ALONE = (of_version("4b16d73", method, DESK_BEYOND) for method in ("default", "without landmarks"))
FALSE_AT_THE_DESK = sorted(
    100.0 * each["false_tracking_rate"]
    for each in recovered("desk", "", 2, 3, 4)
    if each["flown_by"] in ("10ca71e", "a445b12")
)
WITHOUT_THE_BORDER, DOUBLED_NOISE = (
    {room: recovered(room, version, 0, 1, 2) for room in ("desk", "redkitchen")} for version in ("2554d1a", "78912a3")
)


def of_three_builds(by_room: dict[str, list[dict[str, Any]]], part: str) -> list[float]:
    """Kidnaps away from the desk's build frames, those found there, those found of all, edits named, coverage.

    Args:
        by_room: three builds of each room.
        part: of the flights, whose coverage stands last.
    """
    desk = by_room["desk"]
    return [
        desk[0]["away"]["kidnaps"],
        middle_of(build["away"]["kidnap_recovery_rate"] for build in desk),
        middle_of(build["kidnap_recovery_rate"] for build in desk),
        desk[0]["kidnaps"],
        *(middle_of(build["map_changed_rate"] for build in by_room[room]) for room in ("desk", "redkitchen")),
        middle_of(build["coverage_95"] for build in desk),
        middle_of(build[part]["coverage_95"] for build in desk),
    ]


BEFORE, AFTER = recovered("desk", "76e6b71", 0)[0], recovered("desk", "271bf5c", 0)[0]


def middle_of(values: Iterable[float]) -> float:
    return float(np.median(list(values)))


def silent(faults: dict[str, Any], *names: str, column: str = "silent_frames") -> int:
    """During and after some faults, or all of them."""
    found = [fault for name, fault in faults.items() if name != "none" and (not names or name in names)]
    return sum(fault[part][column] for fault in found for part in ("during", "after"))


def shares(*names: str) -> list[float]:
    return [FAULTS["desk"][name]["during"]["coverage_95"] for name in names]


ANOTHER = table_of("desk-another-build.csv")
SHARP = 20.0  # cm; an RMSE above it is counted


def above(flown_by: str) -> list[float]:
    """How many flights' RMSE is above, and the number of flights."""
    rmse = values(chosen(ANOTHER, flown_by=flown_by), "rmse_cm")
    return [sum(each > SHARP for each in rmse), len(rmse)]


BEFORE_CONSENSUS, CONSENSUS, NOW = dict.fromkeys(row["flown_by"] for row in ANOTHER)
ANOTHER_EARLIER = [row for row in ANOTHER if row["flown_by"] != NOW]
ANOTHER_BUILD: tuple[Sentence, ...] = (
    (
        "the median error is {} to {} cm and the RMSE {} to {} cm; it is above {} cm in {} of {} flights and in {} "
        "of {}.",
        [
            *(bound(values(ANOTHER_EARLIER, column)) for column in ("median_cm", "rmse_cm") for bound in (min, max)),
            SHARP,
            *above(BEFORE_CONSENSUS),
            *above(CONSENSUS),
        ],
    ),
    (
        "the RMSE is {} to {} cm, and the states are the same.",
        [bound(values(chosen(ANOTHER, flown_by=NOW), "rmse_cm")) for bound in (min, max)],
    ),
)

BEFORE_THIS_ONE: tuple[Sentence, ...] = (
    (
        "the RMSE of the default was {}, {}, {} and {} cm, by depth alone {}, {}, {} and {} cm, and of untuned "
        "bundles {}, {}, {} and {} cm (3 builds). At the desk, extrapolation, {} of {} frames of the default, "
        "{} of {} without scans and {} of {} of untuned bundles were silently beyond 3.5 sigma; {}, {} and {} % of "
        "the frames were *tracking*.",
        [
            *of_all_stretches("85929a4"),
            *silent_beyond_the_desk("85929a4", *STATED),
            *(tracking_percent(of_version("85929a4", method, DESK_BEYOND)) for method in STATED),
        ],
    ),
    (
        "the default had an RMSE of {}, {}, {} and {} cm, and untuned bundles {}, {}, {} and {} cm (3 builds). At "
        "the desk, extrapolation, {} of {} frames of the default and {} of {} of untuned bundles were silently "
        "beyond 3.5 sigma.",
        [
            *of_all_stretches("54ae70c", ("default", "untuned")),
            *silent_beyond_the_desk("54ae70c", "default", "untuned"),
        ],
    ),
    (
        "the RMSE of the default was {}, {}, {} and {} cm, by depth alone {}, {}, {} and {} cm, and of untuned "
        "bundles {}, {}, {} and {} cm (3 builds). At the desk, extrapolation, {} of {} frames by depth alone and "
        "{} of {} of untuned bundles were silently beyond 3.5 sigma.",
        [
            *of_all_stretches("78912a3"),
            *silent_beyond_the_desk("78912a3", "without landmarks", "untuned"),
        ],
    ),
    (
        "the default had an RMSE of {}, {}, {} and {} cm, the same by depth alone {}, {}, {} and {} cm, and untuned "
        "bundles {}, {}, {} and {} cm.",
        of_all_stretches("3c59bd0"),
    ),
    (
        "the default had an RMSE of {}, {}, {} and {} cm, the same by depth alone {}, {}, {} and {} cm, and untuned "
        "bundles {}, {}, {} and {} cm (3 builds); {} of {} frames in RedKitchen, interpolation, and {} of {} at the "
        "desk, extrapolation, were silently beyond 3.5 sigma",
        [
            *of_all_stretches("2554d1a"),
            *(
                total(of_version("2554d1a", "default", stretch), column)
                for stretch in (KITCHEN_BETWEEN, DESK_BEYOND)
                for column in ("silent_3_5_sigma", "frames")
            ),
        ],
    ),
    (
        "the default had an RMSE of {}, {}, {} and {} cm, the same by depth alone {}, {}, {} and {} cm, and untuned "
        "bundles {}, {}, {} and {} cm (3 builds); by depth alone at the desk, extrapolation, {} of {} frames were "
        "silently beyond 3.5 sigma, with untuned bundles {} of {}.",
        [
            *of_all_stretches("5eed510"),
            *(
                total(of_version("5eed510", method, DESK_BEYOND), column)
                for method in ("without landmarks", "untuned")
                for column in ("silent_3_5_sigma", "frames")
            ),
        ],
    ),
    (
        "With the same builds, the default had an RMSE of {}, {}, {} and {} cm",
        [middle(of_version("491910c", "default", stretch), "rmse_cm")[0] for stretch in range(4)],
    ),
    (
        "untuned bundles had {} instead of {} frames silently beyond 3.5 sigma",
        [total(of_version(commit, "untuned", DESK_BEYOND), "silent_3_5_sigma") for commit in ("491910c", "3c59bd0")],
    ),
    (
        "with landmarks, an RMSE of {} cm ({}–{}), a coverage of {} and {}, and {} and {} of {} frames silently over "
        "30 cm and beyond 3.5 sigma; by depth alone {} cm ({}–{}), {} and {}.",
        [
            *of_flights(LANDMARKS, "rmse_cm"),
            *(median_of(LANDMARKS, column) for column in ("coverage_95", "coverage_99")),
            *(total(LANDMARKS, column) for column in ("silent_30cm", "silent_3_5_sigma", "frames")),
            *of_flights(DEPTH_ALONE, "rmse_cm"),
            *(median_of(DEPTH_ALONE, column) for column in ("coverage_95", "coverage_99")),
        ],
    ),
    (
        "RedKitchen 0:300 by depth alone had an RMSE of {} cm, and the desk 0:350 {} cm",
        [median_of(of_version("4b16d73", "without landmarks", stretch), "rmse_cm") for stretch in (0, 2)],
    ),
    (
        "at the desk, {} % of the *tracking* frames were more than 30 cm off in one of three builds, {} % in another "
        "and none in the third",
        FALSE_AT_THE_DESK[:0:-1],
    ),
    (
        "of the {} kidnaps away from the build's frames of the desk {} were found, and {} of all {}; of map edits, "
        "{} at the desk and {} in RedKitchen were named. The coverage at the desk was {}, away from the build's "
        "frames {}.",
        of_three_builds(DOUBLED_NOISE, "away"),
    ),
    (
        "of {} kidnaps away from the build's frames of the desk, {} were found within 3 s, and {} of all {}; of map "
        "edits, {} at the desk and {} in RedKitchen were named. The coverage at the desk was {}, near the build's "
        "frames {}.",
        of_three_builds(WITHOUT_THE_BORDER, "near"),
    ),
    ("named {} of the map edits", [AFTER["map_changed_rate"]]),
    ("The coverage of the same build was {} before", [BEFORE["coverage_95"]]),
    (", and {} after.", [AFTER["coverage_95"]]),
    (
        "build 0 of [five](#flights) had {} silent frames of {} in RedKitchen, all of them among the "
        "{} with a wrong focal length, and {} of {} at the desk, {} of them among the {} with one",
        [
            silent(BUILD_0["redkitchen"]),
            silent(BUILD_0["redkitchen"], column="frames"),
            silent(BUILD_0["redkitchen"], *LENSES, column="frames"),
            silent(BUILD_0["desk"]),
            silent(BUILD_0["desk"], column="frames"),
            *(silent(BUILD_0["desk"], *LENSES, column=column) for column in ("silent_frames", "frames")),
        ],
    ),
    (
        "RedKitchen had {} silent frames in the version",
        [FAULTS["redkitchen"]["intrinsics-minus-30"]["during"]["silent_frames"]],
    ),
    (
        "half covered on the left {}, on the right {}, below {}; flickering {}; mirrored {}; turned {}; wrong lenses "
        "{} to {} ({} or {} frames each)",
        [
            *shares("half-covered-left", "half-covered-right", "half-covered-lower", "flickering", "mirrored"),
            *shares("turned-180"),
            *extremes(shares(*LENSES)),
            *(FAULTS["desk"][name]["during"]["frames"] for name in ("mirrored", LENSES[0])),
        ],
    ),
)


def test_what_the_versions_before_show_without_a_number() -> None:
    assert silent(BUILD_0["redkitchen"]) == silent(BUILD_0["redkitchen"], *LENSES)
    assert FALSE_AT_THE_DESK[0] == 0.0
    assert {each["false_tracking_rate"] for each in recovered("redkitchen", "", 2, 3, 4)} == {0.0}
    assert BEFORE["map_changed_rate"] == AFTER["map_changed_rate"]
    assert len({row["build"] for row in LANDMARKS}) == 2


# --- RedKitchen ---


def of_column(column: str, landmarks: str, variant: str, **labels: str) -> list[float]:
    return values(chosen(LOCALIZATION, landmarks=landmarks, variant=variant, **labels), column)


def by_split(column: str, landmarks: str) -> list[float]:
    """Smallest and largest of adapted networks, interpolation and extrapolation."""
    return [end for split in SPLITS for end in extremes(of_column(column, landmarks, "adapted", split=split))]


def worst_ratio(landmarks: str, **labels: str) -> float:
    return max(of_column("rmse_over_odometry_worst", landmarks, "adapted", **labels))


def rmse_of(method: str, size: str = "") -> list[float]:
    return [numbers(only(BASELINES, method=method, size=size, split=split), "rmse_cm")[0] for split in SPLITS]


IN_RED_KITCHEN: tuple[Sentence, ...] = (
    (
        "with landmarks, adapted, is {} to {} on the interpolation split, below the stated 0.95, and {} to {} on the "
        "extrapolation split. With adapted depth alone it is {} to {}; with unadapted depth alone {} to {}.",
        [
            *by_split("coverage_95", "yes"),
            *extremes(of_column("coverage_95", "no", "adapted")),
            *extremes(of_column("coverage_95", "no", "unadapted")),
        ],
    ),
    (
        "with landmarks, adapted: {} to {} on the interpolation split, {} to {} on the extrapolation split; worst "
        "of {} flights {}. With depth alone the worst flights reach {} as recorded and {} in L3.",
        [
            *by_split("rmse_over_odometry_median", "yes"),
            sum(of_column("flights", "yes", "adapted")),
            worst_ratio("yes"),
            *(worst_ratio("no", light=light) for light in ("as recorded", "L3")),
        ],
    ),
    (
        "adapted: {} to {} % on the interpolation split, {} to {} % on the extrapolation split. Unadapted: "
        "{} to {} %.",
        [
            *by_split("absrel_percent", "no"),
            *extremes(of_column("absrel_percent", "no", "unadapted")),
        ],
    ),
    (
        "SIFT {} and {} cm, ORB {} and {} cm, odometry alone from the same start {} and {} cm",
        [
            *rmse_of("SIFT keypoints"),
            *rmse_of("ORB keypoints"),
            *(100.0 * KITCHEN["fig4d"][split]["dead reckoning, same start"]["median"] for split in SPLITS),
        ],
    ),
    ("PoseNet {} and {} cm. With", rmse_of("PoseNet", "full")),
    (
        "the coverage on the extrapolation split is {}:",
        numbers(only(BASELINES, method="sensor depth", split="extrapolation"), "coverage_95"),
    ),
)


# --- Others ---

ADAPTED = "network and map"
WITHOUT = {
    split: [row for row in chosen(WITHOUT_ODOMETRY, split=split) if row["tuned"] == ADAPTED] for split in SPLITS
}
LOSING = [row for row in WITHOUT_ODOMETRY if row["tuned"] != ADAPTED]
BEYOND_200 = chosen(RELOCALISATION, frames="200:262", landmarks="no")
SHARE = "share_not_lost_and_more_than_40cm_off"
OTHERS: tuple[Sentence, ...] = (
    ("in which a result took {} s", extremes(values(RELOCALISATION, "seconds_to_result"))[:1]),
    (
        "{} to {} % of such frames were, with errors of {} cm in the median",
        [
            *(100.0 * share for share in extremes(values(BEYOND_200, SHARE))),
            median_of(BEYOND_200, "error_when_found_median_cm"),
        ],
    ),
    (
        "1 build, {} or {} starts) adapted networks have {} to {} cm on the interpolation split and {} to {} cm on "
        "the extrapolation split. Every other variant loses the camera ({} to {} cm).",
        [
            *extremes(values(WITHOUT_ODOMETRY, "no_odometry_starts")),
            *(number for split in SPLITS for number in extremes(values(WITHOUT[split], "no_odometry_median_cm"))),
            *extremes(values(LOSING, "no_odometry_median_cm")),
        ],
    ),
    (
        "gravity gains nothing: {} cm without, {} cm with",
        [
            float(only(table_of("gravity.csv"), room="RedKitchen", gravity_given=given)["median_cm"])
            for given in ("no", "yes")
        ],
    ),
)


def test_what_relocalisation_shows_without_a_number() -> None:
    assert {row["seconds_to_result"] for row in RELOCALISATION} == {"1.0"}
    assert {float(row[SHARE]) for row in RELOCALISATION if row["frames"] != "200:262"} == {0.0}


# --- All numbers ---

SENTENCES = (*BEFORE_THIS_ONE, *ANOTHER_BUILD, *IN_RED_KITCHEN, *OTHERS)
NOT_OF_THE_DATA: dict[str, str] = {
    "versions of 22 to 27 November 2026": "dates",
    "seed 0, in float32": "of the build",
    "the lost camera by 39 cm": "looked up in one flight, whose poses were not kept",
    "a version of 26 November had": "a date",
    "a version of 27 November": "a date",
    "Build 0 of the desk, a version of 26 November": "a name and a date",
    "a focal length 30 % too short": "a fault",
    "the 95 % ellipsoid of frames": "a definition",
    "3 builds, 2 starts each, 6 flights": "checked in the table",
    "2 builds, 2 starts each, 4 flights": "checked in the table",
    "1 build or training per seed, 5 seeds": "of the file",
    "39 frames at 15 Hz": "of the recording",
    "more than 40 cm off": "a definition",
    "Depth alone, 1 build, 5 starts": "of the file",
    "depth alone, 1 build, 5 starts.": "of the file",
    "depth alone, 1 build, 5 starts, an earlier": "of the file",
    "0.5° per axis, constant in a flight, and 0.3° per frame": "what was simulated",
    "built from , 5 seeds": "of the file",
    "from 2 kB on": "a row",
    "voxels of 40 cm": "of the file",
    "K = 200, built": "a setting",
    "sensor depth, 5 seeds. Noise is 2 cm and 1° per axis": "what was simulated",
}
WITHOUT_KEPT_RUNS = (
    "Stopping before obstacles",
    "When the states were introduced",
    "A live flight beside other work",
    "Gyroscope",
    "Floor of a building",
)


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    sections = [text for heading, text in sections_of(PAGE) if heading not in WITHOUT_KEPT_RUNS]
    assert len(sections) == 13
    assert other_numbers("".join(sections), SENTENCES, NOT_OF_THE_DATA) == []


@pytest.mark.parametrize("heading", WITHOUT_KEPT_RUNS)
def test_section_says_that_its_runs_were_not_kept(heading: str) -> None:
    assert re.search(r"The runs .*were not kept", dict(sections_of(PAGE))[heading])


VERSIONS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")


@pytest.mark.parametrize(
    ("table", "words"), [("flights-of", "flights"), ("faults-of", "failing"), ("recovery-of", "kidnaps")]
)
def test_number_of_versions_in_the_list_of_files(table: str, words: str) -> None:
    data = json_of if table != "flights-of" else table_of
    found = {row["flown_by"] for row in data(f"{table}-earlier-versions.{'csv' if data is table_of else 'json'}")}
    (line,) = [line for line in page("docs/results/README.md").splitlines() if f"({table}-earlier-versions." in line]
    assert re.search(rf"\[{words}[^|]* {VERSIONS[len(found)]} versions", line)
