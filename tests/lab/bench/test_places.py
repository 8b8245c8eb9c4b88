"""The benchmark of places flies a building of two rooms; figures of a flight are those of its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of
from monoloc_lab.bench import places
from monoloc_lab.bench.place_building import STEP_M, room_name, room_of
from monoloc_lab.bench.place_flights import PlaceFlight
from monoloc_lab.synth.row_of_rooms import RowOfRooms, row_of_rooms


@pytest.fixture(scope="module")
def row() -> RowOfRooms:
    return row_of_rooms(2, 0)


def perfect_flight(row: RowOfRooms, poses: np.ndarray) -> PlaceFlight:
    numbers = [room_of(row, pose[:3, 3]) for pose in poses]
    worlds = np.stack([row.in_world(number, pose) for number, pose in zip(numbers, poses, strict=True)])
    rooms: list[str | None] = [room_name(number) for number in numbers]
    return PlaceFlight(rooms, ["tracking"] * len(poses), worlds, np.ones(len(poses)), 2, 100.0)


def test_a_perfect_flight_is_found_handed_over_and_right(row: RowOfRooms) -> None:
    poses = row.walk(0, 1, STEP_M)
    flight = perfect_flight(row, poses)
    assert places._is_found(row, poses, flight) and not places._is_wrong(row, poses, flight)
    assert places._is_handed_over(row, poses, flight, 0) and places._entries(flight.rooms) == 2
    np.testing.assert_allclose(places._errors(row, poses, flight), 0.0, atol=1e-6)


def test_a_belief_in_another_room_is_wrong(row: RowOfRooms) -> None:
    poses = row.walk(0, 1, STEP_M)
    right = perfect_flight(row, poses)
    stays = PlaceFlight([room_name(0)] * len(poses), right.states, right.poses, right.step_ms, 1, 100.0)
    assert places._is_wrong(row, poses, stays)
    assert not places._is_handed_over(row, poses, stays, 0) and places._entries(stays.rooms) == 1
    lost = PlaceFlight(stays.rooms, ["lost"] * len(poses), right.poses, right.step_ms, 1, 100.0)
    assert not places._is_wrong(row, poses, lost) and not places._is_found(row, poses, lost)


@pytest.mark.slow
def test_two_rooms_are_built_joined_and_flown(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    figures = json_of(capfd, "bench", "place", "--rooms", "2", "--work", str(tmp_path / "work"))
    assert (figures["rooms"], figures["doors_measured"], figures["starts"]) == (2, 1, 2)
    assert figures["wrong_starts"] == 0 and figures["handed_over"] == 1
    assert figures["door_error_m_max"] < 0.1
    assert [size["rooms"] for size in figures["sizes"]] == [2]
