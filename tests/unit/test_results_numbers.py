"""Tables of docs/results.md are those of the kept data, or say that their runs were not kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import pytest
from scipy.stats import spearmanr

from document_numbers import (
    Table,
    agree,
    agree_all,
    check_table,
    chosen,
    json_of,
    median_of,
    middle,
    numbers,
    only,
    over_builds,
    spread,
    table_of,
    tables_of,
    total,
    tracking_percent,
    values,
)
from kept_flights import predicted_and_actual

PAGE = "docs/results.md"
LIGHTS = ("L1", "L2", "L3")
BUNDLES = ("tuned", "untuned")
RECOVERY = "Kidnaps, starts without a pose, edited maps"
FAULTS_OF_ROW = {
    "black, covered, saturated, frozen": ("black", "covered", "saturated", "frozen"),
    "noise, other room, mirrored, turned by 180 degrees": ("noise", "other-room", "mirrored", "turned-180"),
    "propeller guards in view, whole flight": ("propeller-guards",),
    "drops on the lens, whole flight": ("drops",),
    "half covered on the right": ("half-covered-right",),
    "half covered on the left or below, blurred, flickering, JPEG at 10": (
        "half-covered-left",
        "half-covered-lower",
        "blurred",
        "flickering",
        "jpeg-quality-10",
    ),
    "time backwards, images missing for 2 and 10 s": ("time-backwards", "dropped-2s", "dropped-10s"),
    "focal length + 10 %, whole flight": ("intrinsics-plus-10",),
    "focal length - 10 %": ("intrinsics-minus-10",),
    "focal length + 30 %": ("intrinsics-plus-30",),
    "focal length - 30 %": ("intrinsics-minus-30",),
    "lens 10 % longer, with the build's focal length": ("longer-lens-10",),
    "lens 30 % longer": ("longer-lens-30",),
    "image stretched along its width by 10 %": ("stretched-x-10",),
    "along its width by 33 %": ("stretched-x-33",),
    "along its height by 10 %": ("stretched-y-10",),
    "along its height by 33 %": ("stretched-y-33",),
}
OF_LENS = ("intrinsics", "longer-lens", "stretched")  # first words of a fault of the lens


def check_flights(file: str, table: Table) -> None:
    flights = table_of(file)
    assert len(table.rows) == len({(row["built_from"], row["flown"], row["method"]) for row in flights})
    for where, method, *shown in table.rows:
        built_from, flown = where.split(", ")
        found = chosen(flights, built_from=built_from, flown=flown, method=method)
        agree_all(
            shown,
            [
                over_builds(found, "median_cm"),
                over_builds(found, "rmse_cm"),
                middle(found, "rotation_median_deg"),
                [*middle(found, "coverage_95"), *middle(found, "coverage_99")],
                [tracking_percent(found)],
                [total(found, name) for name in ("silent_30cm", "silent_3_5_sigma", "frames")],
            ],
        )


def check_keypoints(table: Table) -> None:
    found = table_of("further-recordings-keypoints.csv")
    assert len(table.rows) == len(found)
    for where, keypoints, *shown in table.rows:
        built_from, scored = where.split(", ")
        row = only(found, keypoints=keypoints.lower(), scored=scored, built_from=built_from.split()[-1])
        figures = [numbers(row, name) for name in ("megabytes", "median_cm", "rmse_cm", "rotation_median_deg")]
        agree_all(shown, [*figures, numbers(row, "without_pose", "images")])


def check_further_recovery(table: Table) -> None:
    recovery, faults = json_of("recovery-further.json"), json_of("faults-further.json")
    for column, each in enumerate(recovery, start=1):
        regions = [each[name] for name in ("near", "away")]
        found = [
            [number for region in regions for number in (round(region[rate] * region[count]), region[count])]
            for rate, count in (("global_start_rate", "starts"), ("kidnap_recovery_rate", "kidnaps"))
        ]
        edits = [
            round(each["map_edits"] * (each[name] or 0.0)) for name in ("map_changed_rate", "map_changed_false_rate")
        ]
        ended = faults[each["bundle"]]
        left_out = ((), OF_LENS)  # all faults, and those of no lens
        silent = [
            silent_of([ended[name] for name in ended if not name.startswith(("none", *which))], "during", "after")
            for which in left_out
        ]
        shown = [row[column] for row in table.rows]
        coverage = [each["coverage_95"], each["coverage_99"]]
        named = [*edits, each["map_edits"]] if each["map_edits"] else []
        agree_all(shown, [*found, [100.0 * each["false_tracking_rate"]], coverage, named, *silent])


def check_rendered_rooms(table: Table) -> None:
    flights = table_of("rendered-rooms.csv")
    assert len(table.rows) == len({(row["room"], row["method"]) for row in flights})
    for room, method, *shown in table.rows:
        found = chosen(flights, room=room, method=method)
        by_light = [chosen(found, light=light) for light in LIGHTS]
        columns = ("median_cm", "rmse_cm", "odometry_rmse_cm", "coverage_95")
        agree_all(
            shown,
            [
                *([median_of(rows, column) for rows in by_light] for column in columns),
                [tracking_percent(rows) for rows in by_light],
                [total(found, name) for name in ("silent_30cm", "silent_3_5_sigma", "frames")],
            ],
        )


def check_other_cameras(table: Table) -> None:
    flights = table_of("other-cameras.csv")
    assert len(table.rows) == len({row["camera"] for row in flights})
    columns = (
        {"room": "office", "bundle": "untuned", "without": ""},
        {"room": "dining room", "bundle": "untuned", "without": ""},
        {"room": "office", "bundle": "tuned", "without": ""},
        {"room": "office", "bundle": "tuned", "without": "landmarks"},
    )
    for camera, *shown in table.rows:
        found = [only(flights, camera=camera.replace("°", " degrees"), **labels) for labels in columns]
        agree_all(shown, [numbers(row, "median_cm", "rmse_cm", "tracking") for row in found])


def check_many_rooms(table: Table) -> None:
    flights = table_of("many-rooms.csv")
    assert [row[0] for row in table.rows] == sorted({row["room"] for row in flights})
    for room, *shown in table.rows:
        found = chosen(flights, room=room, without="")
        beside, elsewhere, dark = (
            [numbers(only(found, bundle=bundle, flight=flight), "rmse_cm", "tracking") for bundle in BUNDLES]
            for flight in ("beside the walk", "elsewhere", "elsewhere, near darkness")
        )
        distance = numbers(only(found, bundle="tuned", flight="elsewhere"), "distance")
        agree_all(shown, [*beside, distance, *elsewhere, *dark])


def check_starts_in_many_rooms(table: Table) -> None:
    rooms = json_of("recovery-many-rooms.json")
    for room, (name, *shown, coverage) in zip(rooms, table.rows, strict=True):
        assert name == room["room"] and (room["starts"], room["kidnaps"]) == (20, 20)
        rates = [room["global_start_rate"], room["kidnap_recovery_rate"]]
        alarms, false = (100.0 * room[rate] for rate in ("false_alarm_rate", "false_tracking_rate"))
        agree_all([*shown, coverage], [*([rate] for rate in rates), [alarms], [false], [room["coverage_95"]]])


def check_recovery(table: Table) -> None:
    rows = iter(table.rows)
    for room in ("RedKitchen", "desk"):
        builds = json_of(f"recovery-{room.lower()}.json")
        assert [build["build"] for build in builds] == [0, 1, 2]
        for part in ("near", "away", "all"):
            name, starts, kidnaps, alarms, false, edits, coverage = next(rows)
            found = [build if part == "all" else build[part] for build in builds]
            assert name == f"{room}, {part}"
            agree(starts, [*spread(each["global_start_rate"] for each in found), found[0]["starts"]])
            agree(kidnaps, [*spread(each["kidnap_recovery_rate"] for each in found), found[0]["kidnaps"]])
            agree(alarms, spread((100.0 * each["false_alarm_rate"] for each in found), 1))
            agree(coverage, spread(each["coverage_95"] for each in found))
            if part == "all":
                agree(false, spread((100.0 * each["false_tracking_rate"] for each in found), 1))
                agree(edits, spread(each["map_changed_rate"] for each in found))
            else:
                assert (false, edits) == ("", "")
    assert list(rows) == []


def check_recovery_of_other_bundles(table: Table) -> None:
    bundles = json_of("recovery-others.json")
    for bundle, (name, starts, kidnaps, *rates, coverage) in zip(bundles, table.rows, strict=True):
        parts = bundle["near"], bundle["away"]
        assert name == bundle["bundle"] and bundle["wrong_place_rate"] == 0.0
        for shown, rate, count in (
            (starts, "global_start_rate", "starts"),
            (kidnaps, "kidnap_recovery_rate", "kidnaps"),
        ):
            agree(shown, [each for part in parts for each in (part[rate], part[count]) if each is not None])
        agree_all(rates, [[100.0 * bundle["false_alarm_rate"]], [100.0 * bundle["false_tracking_rate"]]])
        agree(coverage, [bundle["coverage_95"], bundle["coverage_99"]])


# --- Failing cameras ---


def when(reported_s: float) -> str:
    if math.isinf(reported_s):
        return "never"
    return f"{reported_s:.2g} s" if reported_s > 0.0 else "at once"


def when_reported(faults: Sequence[dict[str, Any]]) -> str:
    times = [math.inf if fault["reported_s"] is None else fault["reported_s"] for fault in faults]
    if when(min(times)) == when(max(times)):
        return when(max(times))
    return f"{when(min(times))} to never" if math.isinf(max(times)) else f"{when(max(times))} at most"


def silent_of(faults: Sequence[dict[str, Any]], *parts: str) -> tuple[int, int]:
    counted = [fault[part] for fault in faults for part in parts]
    return sum(part["silent_frames"] for part in counted), sum(part["frames"] for part in counted)


def fault_rows(room: str) -> dict[str, str]:
    """The cells of one room."""
    kept: dict[str, dict[str, Any]] = json_of(f"faults-{room}.json")["faults"]
    faults = {name: fault for name, fault in kept.items() if name != "none"}
    cells = {}
    for row, names in FAULTS_OF_ROW.items():
        found = [faults[name] for name in names]
        cells[row] = "{} of {}".format(*silent_of(found, "during"))
        if "time-backwards" not in names:
            cells[row] += f", {when_reported(found)}"
    silent, frames = silent_of([*faults.values()], "during", "after")
    cells["all faults, during and after"] = (
        f"{silent} of {frames} ({100.0 * silent / frames:.{1 if 100 * silent < 10 * frames else 0}f} %)"
    )
    others = [fault for name, fault in faults.items() if not name.startswith(OF_LENS)]
    cells["all but focal length, lens and stretched images"] = "{} of {}".format(
        *silent_of(others, "during", "after")
    )
    return cells


def check_faults(table: Table) -> None:
    kitchen, desk = (fault_rows(room) for room in ("redkitchen", "desk"))
    assert table.rows == tuple((name, kitchen[name], desk[name]) for name in kitchen)


def test_every_fault_is_in_a_row() -> None:
    shown = {name for names in FAULTS_OF_ROW.values() for name in names}
    for room in ("redkitchen", "desk"):
        assert json_of(f"faults-{room}.json")["faults"].keys() == shown | {"none"}


# --- All tables ---


def check_live_flight(table: Table) -> None:
    flights = json_of("live-flight.json")
    assert [flight["threads"] for flight in flights] == [1, 2]
    for flight in flights:
        assert flight["resets"] == 0 and all(each["different_frames"] == 0 for each in flight["recordings"])
    for column, flight in enumerate(flights, start=1):
        summary, replayed = flight["summary"], [each["frames"] for each in flight["recordings"]]
        assert summary["dropped"].keys() == {"skipped"}
        back = [flight[f"{what}_back_s"] for what in ("camera", "link", "process")]
        expected = [
            flight["load_average"],
            [flight["rate_hz"]],
            [flight["latency_ms_median"], flight["latency_ms_p95"]],
            [flight["stamp_error_ms_median"], flight["stamp_error_ms_p95"]],
            [summary["frames"], summary["dropped"]["skipped"]],
            [summary["states"]["tracking"]],
            [flight["longest_gap_s"]],
            [flight["poses"], flight["poses_refused"], flight["poses_by_mavsdk"]],
            [flight["timesync_answered"], flight["timesync_ms_p95"]],
            [flight["resident_mb_start"], flight["resident_mb_end"]],
            back,
            [frames for frames in replayed for _ in range(2)],
        ]
        agree_all([row[column] for row in table.rows], expected)


def check_budget(table: Table) -> None:
    flights = table_of("budget.csv")
    assert len(table.rows) == len({(row["built_from"], row["threads"], row["budget_ms"]) for row in flights})
    for room, threads, budget, *shown in table.rows:
        flown = [row for row in flights if row["built_from"].startswith(room)]
        found = chosen(flown, threads=threads, budget_ms=budget.removesuffix(" ms").replace("–", ""))
        columns = ("rmse_cm", "p95_ms", "p99_ms")
        rmse, p95, p99 = (over_builds(found, column) for column in columns)
        in_turn = 100.0 * total(found, "in_turn") / total(found, "frames")
        agree_all(shown, [middle(found, "median_cm"), rmse, middle(found, "median_ms"), p95, p99, [in_turn]])


def check_localizability(table: Table) -> None:
    frames = table_of("localizability.csv")
    assert len(table.rows) == len({row["room"] for row in frames})
    for name, *shown in table.rows:
        found = chosen(frames, room=name.partition(",")[0])
        rank = float(spearmanr(values(found, "expected"), values(found, "found")).statistic)
        medians = [median_of(found, column) for column in ("distance", "expected", "found")]
        predicted, actual = predicted_and_actual(found)
        agree_all(
            shown,
            [
                [len(found)],
                *([median] for median in medians),
                [rank],
                [predicted],
                [actual],
            ],
        )


def check_unseen_rooms(table: Table) -> None:
    flights = table_of("unseen-rooms.csv")
    assert [row[0] for row in table.rows] == sorted({row["room"] for row in flights})
    for room, *shown in table.rows:
        found = chosen(flights, room=room)
        silent = [total(found, name) for name in ("silent_30cm", "silent_3_5_sigma")]
        distance, *shares = ([numbers(found[0], name)[0]] for name in ("distance", "starts_found", "kidnaps_found"))
        errors = [values(found, name) for name in ("rmse_cm", "median_cm")]
        agree_all(shown, [distance, *errors, [total(found, "tracking")], silent, *shares])


def check_second_walk(table: Table) -> None:
    flights = table_of("second-walk.csv")
    assert len(table.rows) == len({(row["room"], row["walks"]) for row in flights})
    for room, walks, *shown in table.rows:
        found = chosen(flights, room=room, walks=walks)
        shares = [numbers(found[0], name) for name in ("starts_found", "kidnaps_found", "wrong_place")]
        of_bundle = [numbers(found[0], name) for name in ("distance", "predicted")]
        agree_all(shown, [*of_bundle, values(found, "rmse_cm"), [total(found, "tracking")], *shares])


CHECKS: dict[tuple[str, int], Callable[[Table], None]] = {
    ("This version", 0): partial(check_flights, "this-version.csv"),
    ("Two recordings that nobody had looked at", 0): partial(check_flights, "further-recordings.csv"),
    ("Two recordings that nobody had looked at", 1): check_further_recovery,
    ("Two recordings that nobody had looked at", 2): check_keypoints,
    ("Two rendered rooms", 0): check_rendered_rooms,
    ("Other cameras", 0): check_other_cameras,
    ("Eight rendered rooms", 0): check_many_rooms,
    ("Eight rendered rooms", 1): check_starts_in_many_rooms,
    ("Eight rooms that nobody had looked at", 0): check_unseen_rooms,
    ("Where a lost camera is found", 0): check_localizability,
    ("Where a lost camera is found", 1): check_second_walk,
    (RECOVERY, 0): check_recovery,
    (RECOVERY, 1): check_recovery_of_other_bundles,
    ("What the state says", 0): check_faults,
    ("A live flight", 0): check_live_flight,
    ("Threads and budget", 0): check_budget,
}
TABLES = tables_of(PAGE)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: f"{table.place[0]} {table.place[1]}")
def test_table(table: Table) -> None:
    check_table(table, CHECKS)


def test_no_table_is_missing() -> None:
    assert CHECKS.keys() <= {table.place for table in TABLES}
