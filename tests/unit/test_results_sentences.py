"""Sentences of docs/results.md show numbers of the kept data; those of claims have a file of their own."""

from __future__ import annotations

import re
from typing import Any

import pytest

from document_numbers import (
    Rows,
    Sentence,
    agree_sentence,
    by_build,
    chosen,
    json_of,
    other_numbers,
    sections_of,
    table_of,
    three,
    total,
    tracking_percent,
    values,
)
from kept_flights import (
    DESK_BETWEEN,
    DESK_BEYOND,
    FLIGHTS,
    KITCHEN_BETWEEN,
    KITCHEN_BEYOND,
    flown,
    over,
    over_builds_of,
)
from monoloc_lab.experiments.interval import step_of

PAGE = "docs/results.md"
OF_4B16D73 = chosen(table_of("flights-of-earlier-versions.csv"), flown_by="4b16d73")
RECOVERY = [json_of(f"recovery-{room}.json") for room in ("redkitchen", "desk")]
FAULTS: list[dict[str, Any]] = [json_of(f"faults-{room}.json")["faults"] for room in ("redkitchen", "desk")]
OTHERS = json_of("recovery-others.json")
LENSES = [name for name in FAULTS[0] if name.startswith("intrinsics")]

# --- This version ---


def tracking(rows: Rows, method: str) -> float:
    """Of builds 0 and 1, RedKitchen 300:400."""
    return tracking_percent(
        [row for row in chosen(rows, method=method, flown="300:400") if row["build"] in ("0", "1")]
    )


THIS_VERSION: tuple[Sentence, ...] = (
    (
        "is {} ({}–{}) and {} ({}–{}) times that without scans in RedKitchen, interpolation and extrapolation, "
        "and {} ({}–{}) and {} ({}–{}) times at the desk, build by build",
        [number for stretch in range(4) for number in three(over("without scans", stretch))],
    ),
    (
        "At the desk, extrapolation, scans halve the median error ({} for {} cm) and make the covariance honest "
        "({} for {})",
        [
            number
            for column in ("median_cm", "coverage_95")
            for number in over_builds_of(column, DESK_BEYOND, "default", "without scans")
        ],
    ),
    (
        "In RedKitchen, interpolation, all {} frames beyond 3.5 sigma are with scans",
        [total(flown("default", KITCHEN_BETWEEN), "silent_3_5_sigma")],
    ),
    (
        "tuning lowers the RMSE from {} to {} cm (interpolation) and from {} to {} cm (extrapolation); without scans "
        "the latter is {} to {} cm",
        [
            *over_builds_of("rmse_cm", KITCHEN_BETWEEN, "untuned", "default"),
            *over_builds_of("rmse_cm", KITCHEN_BEYOND, "untuned", "default"),
            *over_builds_of("rmse_cm", KITCHEN_BEYOND, "untuned, without scans", "without scans"),
        ],
    ),
    (
        "the untuned bundles are nearly as good ({} for {} cm)",
        over_builds_of("rmse_cm", DESK_BETWEEN, "untuned", "default"),
    ),
    (
        "they are better in the RMSE ({} for {} cm; without scans {} for {}) and worse in the median ({} for {} cm), "
        "with {} of {} frames silently beyond 3.5 sigma",
        [
            *over_builds_of("rmse_cm", DESK_BEYOND, "untuned", "default"),
            *over_builds_of("rmse_cm", DESK_BEYOND, "untuned, without scans", "without scans"),
            *over_builds_of("median_cm", DESK_BEYOND, "untuned", "default"),
            *(total(flown("untuned", DESK_BEYOND), column) for column in ("silent_3_5_sigma", "frames")),
        ],
    ),
    (
        "(builds 0 and 1, and its own builds of the same seeds): {} instead of {} % with landmarks, "
        "{} instead of {} % by depth alone",
        [tracking(rows, method) for method in ("default", "without landmarks") for rows in (FLIGHTS, OF_4B16D73)],
    ),
    (
        "{} starts without a pose, {} kidnaps and {} edited maps a build",
        [RECOVERY[0][0][name] for name in ("starts", "kidnaps", "map_edits")],
    ),
    ("Of the {} kidnaps there", [RECOVERY[1][0]["away"]["kidnaps"]]),
    ("**1 build each**, {} starts, {} kidnaps", [OTHERS[0]["starts"], OTHERS[0]["kidnaps"]]),
    (
        "**1 build**, two flights a light, {} frames each",
        [float(table_of("rendered-rooms.csv")[0]["frames"])],
    ),
)


def test_what_the_bullets_of_this_version_say_without_a_number() -> None:
    assert step_of(over("without landmarks", DESK_BEYOND)) == "undecided"
    assert total(flown("without scans", KITCHEN_BETWEEN), "silent_3_5_sigma") == 0.0
    for stretch in (KITCHEN_BEYOND, DESK_BEYOND):
        assert len({*by_build(flown("untuned, without scans", stretch), "rmse_cm").values()}) == 1
    for rows in (chosen(FLIGHTS, flown="300:400"), chosen(OF_4B16D73, flown="300:400")):
        assert total(rows, "silent_30cm") == total(rows, "silent_3_5_sigma") == 0.0
    for build in (build for room in RECOVERY for build in room):
        assert build["lost_reported_rate"] == 1.0 and build["map_changed_false_rate"] == 0.0
        assert build["false_tracking_rate"] == 0.0
        assert [build[name] for name in ("starts", "kidnaps", "map_edits")] == [20, 40, 12]


# --- What the state says ---


def recovery_s(faults: dict[str, Any]) -> list[float]:
    found = [fault["recovery_s"] for fault in faults.values() if fault["recovery_s"] is not None]
    return [min(found), max(found)]


def shares(faults: dict[str, Any], *names: str) -> list[float]:
    return [faults[name]["during"]["coverage_95"] for name in names]


STATE: tuple[Sentence, ...] = (
    (
        "A camera was *tracking* again {} to {} s after a fault in RedKitchen, and {} to {} s at the desk",
        [number for faults in FAULTS for number in recovery_s(faults)],
    ),
    (
        "RedKitchen was *map-changed* in {} of {} frames",
        [
            sum(
                FAULTS[0][name]["during"]["states"]["map-changed"]
                for name in ("half-covered-left", "half-covered-lower")
            ),
            sum(FAULTS[0][name]["during"]["frames"] for name in ("half-covered-left", "half-covered-lower")),
        ],
    ),
    (
        "half covered on the left {}, on the right {}, below {}; flickering {}; JPEG at 10 {}; mirrored {}; "
        "turned {}; wrong lenses {} to {} ({} or {} frames each)",
        [
            *shares(FAULTS[1], "half-covered-left", "half-covered-right", "half-covered-lower"),
            *shares(FAULTS[1], "flickering", "jpeg-quality-10", "mirrored", "turned-180"),
            min(shares(FAULTS[1], *LENSES)),
            max(shares(FAULTS[1], *LENSES)),
            FAULTS[1]["mirrored"]["during"]["frames"],
            FAULTS[1][LENSES[0]]["during"]["frames"],
        ],
    ),
    (
        "held all poses but those of turned images ({}) and of wrong lenses ({} to {})",
        [
            *shares(FAULTS[0], "turned-180"),
            min(shares(FAULTS[0], *LENSES)),
            max(shares(FAULTS[0], *LENSES)),
        ],
    ),
)


def test_what_the_state_says_without_a_number() -> None:
    assert sum(fault["after"]["silent_frames"] for faults in FAULTS for fault in faults.values()) == 0
    others = [fault for name, fault in FAULTS[0].items() if name not in (*LENSES, "turned-180")]
    assert {fault["during"]["coverage_95"] for fault in others} == {1.0, None}
    assert all(FAULTS[1][name]["during"]["states"]["tracking"] for name in LENSES)


# --- All numbers ---

READING: tuple[Sentence, ...] = (
    (
        "the nearest build frame is {} cm away in the median",
        [100.0 * json_of("reproduce-redkitchen.json")["figures"]["fig5b"]["interpolation"]["nearest_build_frame_m"]],
    ),
    (
        "evaluated on another; {} m from the nearest build frame in the median",
        [json_of("reproduce-living-room.json")["figures"]["fig5b"]["living room"]["nearest_build_frame_m"]],
    ),
)
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
SENTENCES = (*READING, *THIS_VERSION, *ANOTHER_BUILD, *STATE)
NOT_OF_THE_DATA: dict[str, str] = {
    "seed 0, in float32": "of the build",
    "lost camera by 39 cm": "looked up in one flight, whose poses were not kept",
    "7-Scenes": "a name",
    "[400 frames": "of the recording",
    "500 frames by hand": "of the recording",
    "160x120": "pixels",
    "so that 300 frames remain": "of the recording",
    "is 0.7 away in the median": "of the recording",
    "(0.8 of pose distance": "of the recording",
    "lights, 0.35 m from the nearest build frame": "of the recordings",
    "is flown 0.35 m from": "of the recordings",
    "are 10 cm and 3° beside": "the starts of the flights",
    "starts 10 cm and 3° off": "the starts of the flights",
    "94 % (five builds) and 75 % (three)": "of the statistics",
    "the stated 95 % ellipsoid": "a definition",
    "the 95 % ellipsoid of frames": "a definition",
    "the stated 95 and 99 % ellipsoids": "a definition",
    "more than 30 cm off, or beyond 3.5 sigma": "a definition",
    "more than 30 cm off or outside 3.5 sigma": "a definition",
    "frame was more than 30 cm off": "a definition",
    "within 0.3 of pose distance": "a definition",
    "turns by 2 to 5° a frame": "of the recording",
    "7 to 15 cm and 5 to 10° off": "of single frames that were not kept",
    "Builds 0 and 1 were made on an AMD EPYC (seeds 0 and 1), 2 to 4 on an Intel Xeon (seeds 0 to 2)": "names",
    "(builds 2 to 4 of the table)": "names",
    "9 begin at": "of the recording",
    "2 at 451 and 459": "of the recording",
    "begins at 443": "of the recording",
    "1 build and 1 flight a fault": "one build in the file",
    "a focal length 30 % off": "a fault",
}
OF_CLAIMS = ("Failed", "Undecided")
WITHOUT_KEPT_RUNS = ("Places that look alike", "A changed room", "A live flight", "Time and memory", "Budget")


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_sentence(sentence: str, expected: list[float]) -> None:
    agree_sentence(PAGE, sentence, expected)


def test_every_other_number_is_none_of_kept_runs() -> None:
    sections = [each for each in sections_of(PAGE) if each[0] not in (*OF_CLAIMS, *WITHOUT_KEPT_RUNS)]
    assert len(sections) == 7
    assert other_numbers("".join(text for _, text in sections), SENTENCES, NOT_OF_THE_DATA) == []


@pytest.mark.parametrize("heading", WITHOUT_KEPT_RUNS)
def test_section_says_that_its_runs_were_not_kept(heading: str) -> None:
    assert re.search(r"(runs .*were|runs that were) not kept", dict(sections_of(PAGE))[heading])
