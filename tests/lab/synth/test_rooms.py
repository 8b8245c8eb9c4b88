"""Editing and storing rooms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.errors import DataError, SettingError
from monoloc_lab.synth.furniture import chair, table
from monoloc_lab.synth.layout import generate_room
from monoloc_lab.synth.materials import wood
from monoloc_lab.synth.rooms import Object, Room, read_room, write_room
from refusals import refuses_data

OAK = wood((0.8, 0.6, 0.4), (0.6, 0.4, 0.3))


def test_moving_returns_a_new_room() -> None:
    room = Room((4.0, 4.0, 2.5)).add(Object("chair", chair(OAK, OAK), (1.0, 1.0, 0.0)))
    moved = room.move("chair", (1.5, 0.0, 0.0), turn_rad=0.5)
    assert moved["chair"].position == (2.5, 1.0, 0.0) and moved["chair"].yaw_rad == 0.5
    assert room["chair"].position == (1.0, 1.0, 0.0)
    assert moved.remove("chair").names == []
    beside = np.array([[1.0, 1.0, 0.44]])
    assert room.clearance_m(beside)[0] < 0.0 < moved.clearance_m(beside)[0]


def test_impossible_edits_are_refused() -> None:
    room = Room((4.0, 4.0, 2.5)).add(Object("table", table(1.2, 0.8, 0.74, OAK, OAK), (2.0, 2.0, 0.0)))
    with pytest.raises(SettingError, match="there is no 'chair'; choose one of table"):
        room.move("chair")
    with pytest.raises(ValueError, match=r"^by_m must have shape \(3,\), got \(2,\)"):
        room.move("table", (1.0, 2.0))
    with pytest.raises(SettingError, match="'table' exists already"):
        room.add(Object("table", chair(OAK, OAK), (0.5, 0.5, 0.0)))
    with pytest.raises(SettingError, match="chair: intersects table"):
        room.add(Object("chair", chair(OAK, OAK), (2.0, 2.0, 0.35)))
    with pytest.raises(SettingError, match="table: intersects the walls"):
        room.move("table", (1.8, 0.0, 0.0))


def test_written_room_is_read_unchanged(tmp_path: Path) -> None:
    room = generate_room(2)
    write_room(tmp_path / "room.json", room)
    assert read_room(tmp_path / "room.json") == room
    with pytest.raises(DataError, match=r"none.json: cannot be read .*monoloc synth room"):
        read_room(tmp_path / "none.json")
    (tmp_path / "other.json").write_text('{"size": [1, 2, 3], "objects": [{"name": 3}]}')
    with pytest.raises(DataError, match=r"other.json: is not a room"):
        read_room(tmp_path / "other.json")


def test_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    path.write_bytes(b"\xff\xfe{}")
    refuses_data(lambda: read_room(path), path, "cannot be read .*utf-8", "monoloc synth room")
