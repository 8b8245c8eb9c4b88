"""``monoloc build`` over a bundle that was edited, and beside what flights have shown of it."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from cli_helpers import outputs, refused, succeeds
from edit_helpers import CUBE, mapped_room
from monoloc.builder.build_report import BuildReport
from monoloc.bundle import Bundle, read_bundle, write_bundle
from monoloc.errors import DataError
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording

BOX = ",".join(map(str, (*(CUBE.centre - CUBE.half), *(CUBE.centre + CUBE.half))))
BUILD = ("build", "walk", "--out", "room.monoloc")


def built(*given: object) -> tuple[Bundle, BuildReport]:
    """In place of a build."""
    values: dict[str, Any] = {field.name: 0 for field in fields(BuildReport)}
    none = dict.fromkeys(("depth_absrel_before", "scale_sd", "depth_scale"))
    return mapped_room(), BuildReport(**{**values, **none, "warnings": []})


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a bundle and a recording to build it again from."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("monoloc.cli.build.build_bundle", built)
    write_bundle(tmp_path / "room.monoloc", mapped_room())
    write_recording(tmp_path / "walk", RoomRecording(Room(), make_path(2), SMALL_CAMERA))
    return tmp_path


def test_edits_that_a_build_replaces_are_noted_before_it(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, err = outputs(capfd, *BUILD)
    assert "note" not in err
    succeeds(capfd, "map", "edit", "room.monoloc", "remove", "--box", BOX)

    def failing(*given: object) -> None:
        _, err = capfd.readouterr()
        assert "note: room.monoloc: the new bundle replaces its edits (1), too; to keep them, stop now" in err
        raise DataError("walk", "cannot be built", "record it again")

    monkeypatch.setattr("monoloc.cli.build.build_bundle", failing)
    refused(capfd, here, BUILD, "walk", "cannot be built", "record")
    assert len(read_bundle(here / "room.monoloc").edits) == 1


def test_what_flights_showed_of_the_old_map_goes_with_it(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (here / "flying.monoloc").symlink_to("room.monoloc")
    evidence = here / "room.evidence.npz"
    evidence.write_bytes(b"of another room")
    _, err = outputs(capfd, "build", "walk", "--out", "flying.monoloc")
    assert "replaces what flights showed of it (room.evidence.npz), too" in err
    assert not evidence.exists() and (here / "flying.monoloc").is_symlink()
