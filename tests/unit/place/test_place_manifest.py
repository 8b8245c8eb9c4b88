"""The manifest of a place refuses what it cannot mean, and its doors hold both ways."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from monoloc.geometry import invert, se3_exp, transform
from monoloc.place.place_manifest import Door, PlaceManifest, RoomEntry, parse_place, place_content
from refusals import refuses_data

FILE = Path("house.place/place.json")
T_A_B = se3_exp(np.array([3.0, -1.0, 0.5, 0.2, 1.1, -0.4]))


def a_door() -> Door:
    return Door.between("a", "b", T_A_B, (0.02, 0.01), np.array([1.0, 2.0, 0.5]), 1.2)


def body() -> dict[str, Any]:
    rooms = tuple(RoomEntry(name=name, bundle=f"../{name}.monoloc", sha256="0" * 64) for name in "ab")
    manifest = PlaceManifest(monoloc_version="1", rooms=rooms, doors=(a_door(),), index_sha256="1" * 64)
    content: dict[str, Any] = json.loads(manifest.model_dump_json())
    return content


def test_a_manifest_is_read_as_it_was_written() -> None:
    manifest = parse_place(json.dumps(body()).encode(), FILE)
    assert [room.name for room in manifest.rooms] == ["a", "b"]
    np.testing.assert_allclose(manifest.doors[0].T_a_b, T_A_B, atol=1e-12)


def test_a_door_holds_both_ways() -> None:
    door = a_door()
    assert door.beyond("a") == "b" and door.beyond("b") == "a" and not door.joins("c")
    np.testing.assert_allclose(door.T_beyond_here("b"), T_A_B, atol=1e-12)
    np.testing.assert_allclose(door.T_beyond_here("a"), invert(T_A_B), atol=1e-12)
    np.testing.assert_allclose(transform(T_A_B, door.centre_in("b")[None])[0], door.centre_in("a"), atol=1e-12)


def change(*path: str | int, to: object) -> Callable[[dict[str, Any]], None]:
    def spoil(content: dict[str, Any]) -> None:
        place: Any = content
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to

    return spoil


@pytest.mark.parametrize(
    ("spoil", "problem", "fix"),
    [
        (change("schema_version", to=2), "has schema 2, this monoloc reads 1", "with this version"),
        (change("rooms", 1, "name", to="a"), "two rooms have the name a", "place new"),
        (change("doors", 0, "b", to="c"), "a door leads to c, which is no room", "place new"),
        (change("doors", 0, "b", to="a"), "must join two rooms, not a with itself", "place new"),
        (change("doors", 0, "pose", 6, to=2.0), "a quaternion of length 1", "place new"),
        (change("doors", 0, "radius_m", to=0.0), "doors.0.radius_m: must be greater", "place new"),
        (change("rooms", 0, "bundle", to="/etc/a.monoloc"), "must be relative to the place", "place new"),
        (change("rooms", 0, "sha256", to="x"), "rooms.0.sha256", "place new"),
    ],
)
def test_what_it_cannot_mean_is_refused(spoil: Callable[[dict[str, Any]], None], problem: str, fix: str) -> None:
    content = body()
    spoil(content)
    refuses_data(lambda: parse_place(json.dumps(content).encode(), FILE), FILE, problem, fix)


def test_damaged_text_is_refused() -> None:
    refuses_data(lambda: parse_place(b'{"schema_version": 1', FILE), FILE, "is cut short or edited", "place new")
    refuses_data(lambda: parse_place(b"[1]", FILE), FILE, "has schema None", "with this version")


def test_what_is_no_place_is_refused(tmp_path: Path) -> None:
    nowhere = tmp_path / "nowhere.place"
    refuses_data(lambda: place_content(nowhere), nowhere, "there is no such folder", "place new")
    refuses_data(lambda: place_content(tmp_path), tmp_path, "is not a place .no place.json", "place new")
    with (tmp_path / "place.json").open("wb") as file:
        file.truncate((1 << 22) + 1)
    file_path = tmp_path / "place.json"
    refuses_data(lambda: place_content(tmp_path), file_path, "cannot be read .it is larger", "place new")
