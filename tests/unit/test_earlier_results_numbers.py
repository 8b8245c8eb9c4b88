"""Tables of docs/results-of-earlier-versions.md are those of the kept data, or say that their runs were not kept."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from document_numbers import (
    Rows,
    Table,
    agree,
    agree_all,
    check_table,
    chosen,
    json_of,
    numbers,
    only,
    table_of,
    tables_of,
    values,
)

PAGE = "docs/results-of-earlier-versions.md"
LOCALIZATION = table_of("localization.csv")
BASELINES = table_of("baselines.csv")
VARIANTS = table_of("adaptation-variants.csv")
GRAVITY = chosen(table_of("gravity.csv"), room="living room")
WITHOUT_ODOMETRY = table_of("without-odometry.csv")
KITCHEN, LIVING_ROOM = (json_of(f"reproduce-{room}.json")["figures"] for room in ("redkitchen", "living-room"))
MEDIAN = ("median_cm", "median_min_cm", "median_max_cm")
BASELINE_OF_ROW = {
    "sensor depth in this filter, no landmarks": ("sensor depth", ""),
    "PoseNet, size of full": ("PoseNet", "full"),
    "PoseNet with synthesised views, full": ("PoseNet with synthesised views", "full"),
    "filtered PoseNet, full": ("filtered PoseNet", "full"),
    "ORB keypoints": ("ORB keypoints", ""),
    "SIFT keypoints, 9.8 MB": ("SIFT keypoints", ""),
}
COLUMNS = tuple(
    {"split": split, "light": light}
    for split in ("interpolation", "extrapolation")
    for light in ("as recorded", "L3")
)


def columns_of(rows: Rows, *columns: str) -> list[list[float]]:
    return [numbers(only(rows, **wanted), *columns) for wanted in COLUMNS]


def name_of(cell: str) -> str:
    return cell.replace("`", "")


# --- RedKitchen and living room ---


def of_network(cell: str, landmarks: str, room: str) -> Rows:
    """``localization.csv`` has five builds of two rows as well; the tables are of three and two."""
    network, variant = name_of(cell).split(", ")
    builds = {"RedKitchen": "3", "living room": "2"}[room]
    return chosen(LOCALIZATION, room=room, network=network, variant=variant, landmarks=landmarks, builds=builds)


def assert_all_networks(table: Table, room: str) -> None:
    kept = {(row["network"], row["variant"], row["landmarks"]) for row in LOCALIZATION if row["room"] == room}
    assert {(*name_of(row[0]).split(", "), row[1]) for row in table.rows} == kept and len(table.rows) == len(kept)


def check_kitchen(table: Table) -> None:
    assert_all_networks(table, "RedKitchen")
    for network, landmarks, *shown in table.rows:
        agree_all(shown, columns_of(of_network(network, landmarks, "RedKitchen"), *MEDIAN, "rotation_median_deg"))


def check_kitchen_rmse(table: Table) -> None:
    assert_all_networks(table, "RedKitchen")
    for network, landmarks, *shown in table.rows:
        agree_all(shown, columns_of(of_network(network, landmarks, "RedKitchen"), "rmse_cm"))


def check_living_room(table: Table) -> None:
    assert_all_networks(table, "living room")
    for network, landmarks, *shown in table.rows:
        rows = [only(of_network(network, landmarks, "living room"), light=light) for light in ("L2", "L3")]
        errors = [numbers(row, *MEDIAN, "rotation_median_deg") for row in rows]
        agree_all(shown, [*errors, values(rows, "coverage_95")])


def check_baselines(table: Table) -> None:
    assert [name_of(row[0]) for row in table.rows] == list(BASELINE_OF_ROW)
    for name, *shown in table.rows:
        method, size = BASELINE_OF_ROW[name_of(name)]
        rows = chosen(BASELINES, room="RedKitchen", method=method, size=size)
        agree_all(shown, columns_of(rows, *MEDIAN, "rotation_median_deg"))


def test_baselines_are_the_runs_of_the_reports() -> None:
    """Their RMSE was kept twice."""
    names = {"sensor depth": "sensor depth in our filter", "PoseNet with synthesised views": "PoseNet, with views"}
    for room, figures in (("RedKitchen", KITCHEN), ("living room", LIVING_ROOM)):
        rows = [row for row in BASELINES if row["room"] == room and row["size"] in ("", "full")]
        assert len(rows) == {"RedKitchen": 48, "living room": 18}[room]
        for row in rows:
            by_light = figures["fig5b"][row["split"]]["by light"]
            agree(row["rmse_cm"], [100.0 * by_light[names.get(row["method"], row["method"])][row["light"]]["median"]])


# --- Relocalisation ---


def check_relocalisation(table: Table) -> None:
    frames = ""
    for network, shown_frames, landmarks, *shown in table.rows:
        frames = shown_frames.partition(",")[0] or frames
        for light, cell in zip(("as recorded", "L3"), shown, strict=True):
            row = only(
                table_of("relocalization.csv"),
                bundle=f"{name_of(network)}, 0:300:3",
                frames=frames,
                landmarks=landmarks,
                light=light,
            )
            agree(cell, numbers(row, "found", "starts", "error_when_found_median_cm", "error_when_found_max_cm"))


# --- What is tuned, gravity, map, poses ---


def check_variants(table: Table) -> None:
    assert len(table.rows) == len(chosen(VARIANTS, network="full"))
    for network, split, tuned, *shown in table.rows:
        row = only(VARIANTS, network=name_of(network), split=split, tuned=tuned)
        columns = ("rmse_cm",), ("rmse_over_odometry_median", "rmse_over_odometry_worst"), ("absrel_percent",)
        agree_all(shown, [numbers(row, *each) for each in (MEDIAN, *columns, ("map_shift_median_cm",))])


def check_gravity(table: Table) -> None:
    assert 2 * len(table.rows) == len(GRAVITY)
    for name, *shown in table.rows:
        network, light = name_of(name).split(", ")
        rows = [only(GRAVITY, network=network, light=light, gravity_given=given) for given in ("no", "yes")]
        agree_all(shown, [*(numbers(row, *MEDIAN) for row in rows), values(rows, "rmse_cm")])


def kept_map(name: str) -> dict[str, Any]:
    """``mixture, K = 50`` or ``voxels of 20 cm``."""
    (size,) = re.findall(r"\d+", name)
    kind = name.split(" ")[0].strip(",")
    wanted = float(size) if kind == "mixture" else float(size) / 100.0
    (found,) = (each for each in KITCHEN["map-size"][kind] if each["size"] == wanted)
    return dict(found)


def in_cm(error: dict[str, float], *names: str) -> list[float]:
    return [100.0 * error[name] for name in names]


def check_map_size(table: Table) -> None:
    for name, *shown in table.rows:
        kept = kept_map(name)
        median = in_cm(kept["unseen_ate_median_m"], "median", "smallest", "largest")
        agree_all(shown, [[kept["map_bytes"] / 1e3], median, in_cm(kept["unseen_ate_rmse_m"], "median")])


def check_build_poses(table: Table) -> None:
    poses = {"as given": "given", "with noise": "noisy", "with noise, --refine-poses": "noisy, refined"}
    assert [name_of(row[0]) for row in table.rows] == list(poses)
    for name, *shown in table.rows:
        rows = chosen(table_of("noisy-build-poses.csv"), depth="sensor", build_poses=poses[name_of(name)])
        agree_all(shown, [numbers(only(rows, split=split), *MEDIAN) for split in ("interpolation", "extrapolation")])


# --- All tables ---

CHECKS: dict[tuple[str, int], Callable[[Table], None]] = {
    ("RedKitchen", 0): check_kitchen,
    ("RedKitchen", 1): check_kitchen_rmse,
    ("Baselines", 0): check_baselines,
    ("Living room", 0): check_living_room,
    ("Relocalisation", 0): check_relocalisation,
    ("What is tuned", 0): check_variants,
    ("Gravity", 0): check_gravity,
    ("Size of the map", 0): check_map_size,
    ("Errors in the build poses", 0): check_build_poses,
}
TABLES = tables_of(PAGE)


@pytest.mark.parametrize("table", TABLES, ids=lambda table: f"{table.place[0]} {table.place[1]}")
def test_table(table: Table) -> None:
    check_table(table, CHECKS)


def test_no_table_is_missing() -> None:
    assert CHECKS.keys() <= {table.place for table in TABLES}
