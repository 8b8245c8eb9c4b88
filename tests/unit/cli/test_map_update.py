"""``monoloc map update``: its proposals, what it applies, where it keeps evidence, and its refusals."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_helpers import json_of, listing, outputs, refused, remove_depth, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.bundle_signature import SIGNATURE
from monoloc.cli.main import invoke
from monoloc.obstacles.depth_error import DepthError
from monoloc.updating.observed_flight import ObservedFlight
from monoloc.updating.proposals import proposals
from monoloc.updating.room_evidence import Evidence, write_evidence
from monoloc.updating.tally import Tally
from synthetic_room import SMALL_CAMERA, write_recording
from update_helpers import LEFT, flight, mapped

UPDATE = ("map", "update", "room.monoloc")


def is_missed() -> NDArray[np.bool_]:
    """Of the map's landmarks: those on the box, and some at the other end of the room."""
    points = mapped().landmarks.points.astype(np.float64)
    from_box_m = np.linalg.norm(points - LEFT.centre, axis=1)
    return LEFT.contains(points) | (from_box_m > np.quantile(from_box_m, 0.9))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a bundle, beside which two flights have left what they missed."""
    monkeypatch.chdir(tmp_path)
    write_bundle(tmp_path / "room.monoloc", mapped())
    missed = is_missed()
    views = np.where(missed, 10, 0)
    tally = Tally.new(len(missed))
    for _ in range(2):
        tally = tally.after_flight(views, views, np.where(missed, np.inf, 0.0))
    evidence = replace(Evidence.none(mapped()), landmarks=tally, flights=("monday", "tuesday"))
    write_evidence(tmp_path / "room.evidence.npz", evidence, mapped())
    return tmp_path


def test_proposals_are_listed_drawn_and_applied_by_id(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = listing(here)
    listed = json_of(capfd, *UPDATE)
    assert listing(here) == before and listed["counted_flights"] == 2
    assert {each["kind"] for each in listed["proposals"]} == {"retire landmarks"}
    assert sum(each["count"] for each in listed["proposals"]) == is_missed().sum()
    (here / "room.monoloc" / SIGNATURE).write_bytes(bytes(64))
    drawn: list[list[str]] = []
    monkeypatch.setattr(
        "monoloc.viz.update_drawing.draw_edits", lambda axis, edits, *_, **__: drawn.append([e.name for e in edits])
    )
    first, second, *_ = (each["id"] for each in listed["proposals"])
    out, err = outputs(capfd, *UPDATE, "--apply", first, "--plot", "change.png")
    assert first in out and second in out
    assert drawn == [[], ["1 update"]]  # before and after
    assert "sign it again" in err and (here / "change.png").stat().st_size > 10_000
    edited = read_bundle(here / "room.monoloc")
    assert len(mapped().landmarks) - len(edited.landmarks) == listed["proposals"][0]["count"]
    assert edited.edits[-1].record.parameters["newest_flights"] == ["monday", "tuesday"]
    assert json_of(capfd, *UPDATE)["proposals"] == listed["proposals"][1:]  # those of the list that was seen
    refused(capfd, here, (*UPDATE, "--apply", f"{second},{first}"), "--apply", first, "list them again")
    _, err = outputs(capfd, "map", "edit", "room.monoloc", "undo")
    assert "two new flights can propose it again" in err


def test_an_update_while_another_one_is_applied_is_refused(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = json_of(capfd, *UPDATE)["proposals"][0]["id"]

    def meanwhile(*given: Any) -> Any:
        monkeypatch.undo()
        monkeypatch.chdir(here)
        succeeds(capfd, *UPDATE, "--apply", first)
        states.append(listing(here))
        return proposals(*given)

    states: list[dict[str, bytes | None]] = []
    monkeypatch.setattr("monoloc.cli.map_update.proposals", meanwhile)
    assert invoke([*UPDATE, "--auto", "--plot", "change.png"]) == 2
    assert "was changed meanwhile by another command, so nothing is written; run" in capfd.readouterr().err
    assert states == [listing(here)]


def test_evidence_lies_beside_the_bundle_that_a_link_leads_to(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (here / "flying.monoloc").symlink_to("room.monoloc")
    assert json_of(capfd, "map", "update", "flying.monoloc")["proposals"] == json_of(capfd, *UPDATE)["proposals"]


def test_warnings_of_applied_edits_are_printed(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoloc.editing.edits._other_gravity", lambda *_: "gravity is another")
    _, err = outputs(capfd, *UPDATE)
    assert "warning" not in err
    proposed = len(json_of(capfd, *UPDATE)["proposals"])
    _, err = outputs(capfd, *UPDATE, "--auto")
    assert err.count("warning: room.monoloc: gravity is another") == proposed > 0


@pytest.mark.slow
def test_a_flight_adds_evidence_beside_the_bundle_that_is_written(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_recording(here / "flight", flight(1))
    given = ("folder:flight", "--auto", "--out", "new.monoloc", "--seed", "3")
    result = json_of(capfd, *UPDATE, *given)
    assert result["flights"][0]["refusal"] is None and result["flights"][0]["usable_frames"] >= 5
    assert result["counted_flights"] == 3 and all(each["applied"] for each in result["proposals"])
    assert (here / "new.evidence.npz").is_file() and len(read_bundle(here / "new.monoloc").edits) >= 1
    assert read_bundle(here / "room.monoloc").edits == ()


@pytest.mark.parametrize(
    ("arguments", "names", "problem", "fix"),
    [
        (("--apply", "1"), "--apply", "has '1', which is the id of no current proposal", "list them again"),
        (("--apply", "1", "--auto"), "--apply", "is given together with --auto", "give one"),
        (("folder:flight", "--apply", "1"), "--apply", "a list that these recordings change", "the new list first"),
        (("folder:flight", "--depth-scale", "0"), "--depth-scale", "is 0", "the stored value of one metre"),
        (("--out", "elsewhere"), "--out", "elsewhere is not named as a bundle", "name it"),
    ],
)
def test_refusals(
    here: Path, capfd: pytest.CaptureFixture[str], arguments: tuple[str, ...], names: str, problem: str, fix: str
) -> None:
    refused(capfd, here, (*UPDATE, *arguments), names, problem, fix)


def test_flights_of_which_none_can_be_used_end_with_what_to_do_and_write_nothing(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(here / "flight", flight(1))
    detected, depth_error = SMALL_CAMERA, DepthError(0.1, 0.0, True)
    seen = ObservedFlight("wednesday", [], detected, {"lost": 6}, depth_error, "0% of its frames are tracking", "fly")
    monkeypatch.setattr("monoloc.cli.map_update.observe", lambda *given: seen)
    before = listing(here)
    given = ("folder:flight", "folder:flight", "--out", "new.monoloc", "--plot", "change.png")
    assert invoke([*UPDATE, *given, "--json"]) == 2
    out, err = capfd.readouterr()
    problem = "0% of its frames are tracking, and none of the other flights can be used (1)"
    assert f"monoloc: wednesday: {problem}; fly\n" in err
    assert invoke([*UPDATE, "folder:flight"]) == 2
    assert capfd.readouterr().err.count("wednesday: ") == 1  # its problem and the fix are said once
    assert [each["fix"] for each in json.loads(out)["flights"]] == ["fly", "fly"]
    assert listing(here) == before
    outputs(capfd, *UPDATE, "folder:flight", "--auto")  # applies what earlier flights showed
    assert read_bundle(here / "room.monoloc").edits


def test_a_write_protected_bundle_is_refused_before_flights_are_looked_at(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(here / "flight", flight(1))
    monkeypatch.setattr("monoloc.cli.map_update.observe", None)
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK or Path(path).name != "room.monoloc")
    refused(capfd, here, (*UPDATE, "folder:flight", "--auto"), "room.monoloc", "is write-protected", "chmod -R u\\+w")


def test_a_folder_that_takes_no_evidence_is_refused_before_flights_are_looked_at(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(here / "flight", flight(1))
    monkeypatch.setattr("monoloc.cli.map_update.observe", None)
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.W_OK or Path(path) != here)
    path = str(here / "room.evidence.npz")
    refused(capfd, here, (*UPDATE, "folder:flight"), path, "cannot be written there", "copy the bundle")


def test_a_sensor_is_asked_for_only_where_there_is_one(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_recording(here / "flight", flight(1))
    remove_depth(here / "flight")
    arguments = (*UPDATE, "folder:flight", "--depth", "sensor")
    refused(capfd, here, arguments, "--depth", "has no depth", "leave it out")
