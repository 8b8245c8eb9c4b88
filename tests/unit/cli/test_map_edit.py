"""``monoloc map edit``: its commands, in place and beside, and its refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_helpers import json_of, listing, outputs, refused, succeeds, write_recording, write_workspace
from edit_helpers import CUBE, bundle_of_walk, cube_cloud, mapped_room
from monoloc.bundle import Bundle, digest_of, read_bundle, write_bundle
from monoloc.bundle_signature import SIGNATURE
from monoloc.cli.main import invoke
from monoloc.editing.edits import remove
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

LOWER, UPPER = (",".join(map(str, corner)) for corner in (CUBE.centre - CUBE.half, CUBE.centre + CUBE.half))
BOX = f"{LOWER},{UPPER}"
EDIT = ("map", "edit", "room.monoloc")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a bundle and a cloud."""
    monkeypatch.chdir(tmp_path)
    write_bundle(tmp_path / "room.monoloc", mapped_room())
    np.savez(tmp_path / "cube.npz", points=cube_cloud() - CUBE.centre)
    return tmp_path


def test_remove_add_move_undo_and_log(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    removed = json_of(capfd, *EDIT, "remove", "--box", BOX, "--yaw", "10")
    assert removed["kind"] == "remove" and removed["parameters"]["yaw_deg"] == 10.0
    assert removed["undo_bytes"] > 0 and removed["bytes"] > 0 and removed["seconds"] > 0.0
    centre = ",".join(map(str, CUBE.centre))
    added = json_of(capfd, *EDIT, "add", "cube.npz", "--at", centre, "--turn", "90")
    assert added["parameters"] == {"cloud": "cube.npz", "at": CUBE.centre.tolist(), "turn_deg": 90.0}
    moved = json_of(capfd, *EDIT, "move", "--box", BOX, "--by", "0.9,0,0", "--turn", "45", "--out", "moved.monoloc")
    assert moved["bundle"] == "moved.monoloc"
    log = json_of(capfd, "map", "edit", "moved.monoloc", "log")
    assert [edit["kind"] for edit in log["edits"]] == ["remove", "add", "move"]
    assert [edit["kind"] for edit in json_of(capfd, *EDIT, "log")["edits"]] == ["remove", "add"]
    lines = succeeds(capfd, *EDIT, "log").splitlines()
    assert len(lines) == 2 and "remove: lower_m" in lines[0] and "components 150 -> " in lines[0]
    assert json_of(capfd, *EDIT, "undo")["undone"]["kind"] == "add"
    assert "undone" in succeeds(capfd, *EDIT, "undo")
    np.testing.assert_allclose(
        read_bundle(here / "room.monoloc").original.means, mapped_room().original.means, atol=1e-6
    )


def test_edit_of_a_signed_bundle_removes_the_signature_and_says_so(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    signature = here / "room.monoloc" / SIGNATURE
    signature.write_bytes(bytes(64))
    _, err = outputs(capfd, *EDIT, "remove", "--box", BOX)
    assert "room.monoloc: its signature is void and was removed; sign it again" in err and not signature.exists()
    _, err = outputs(capfd, *EDIT, "undo")
    assert "signature" not in err


def test_warning_of_a_removal_names_the_bundle(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _, err = outputs(capfd, *EDIT, "remove", "--box", "-9,-9,-9,9,9,2.9")
    warning = err.splitlines()[0]
    assert warning.startswith("warning: room.monoloc: ") and warning.endswith("if it was a wrong one, undo")


def test_turned_object_is_at_its_place(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    json_of(capfd, *EDIT, "add", "cube.npz", "--at", "1.2,0.7,0", "--turn", "45")
    room, edited = mapped_room(), read_bundle(here / "room.monoloc")
    new = edited.original.means[len(room.original) :]
    assert np.abs(new.mean(axis=0) - [1.2, 0.7, 0.0]).max() < 0.1


def test_cloud_that_is_sparser_than_the_map_is_warned_of(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    side = np.arange(-0.4, 0.4, 0.08)
    np.savez(here / "sparse.npz", points=np.stack(np.meshgrid(side, side, 0.0), axis=-1).reshape(-1, 3))
    _, err = outputs(capfd, *EDIT, "add", "sparse.npz", "--at", "0,0,1")
    assert "warning: sparse.npz: its points are farther apart than the 3 cm of the map" in err
    _, err = outputs(capfd, *EDIT, "add", "cube.npz", "--at", "0,0,1")
    assert "warning" not in err


def test_help_says_which_axes_the_cloud_of_an_object_has(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = " ".join(succeeds(capfd, *EDIT, "add", "--help").split())
    assert "axes of an object's cloud are those of the map's world, which need not be upright" in text
    assert '"down" of monoloc inspect' in text and "down" in json_of(capfd, "inspect", "room.monoloc")


def test_object_has_the_axes_of_the_world(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Also where the world does not stand upright, and the object is turned about the vertical."""
    room = mapped_room()
    tilted = room.provenance.model_copy(update={"down_world": (0.0, 0.8, 0.6), "knows_down": True})
    write_bundle(here / "room.monoloc", replace(room, provenance=tilted))
    pole = np.zeros((400, 3))
    pole[:, 2] = np.linspace(-0.8, 0.8, 400)
    np.savez(here / "pole.npz", points=pole)
    for turn, axis in ((0.0, [0.0, 0.0, 1.0]), (180.0, [0.0, 0.96, -0.28])):
        json_of(capfd, *EDIT, "add", "pole.npz", "--turn", str(turn), "--out", "with-pole.monoloc")
        new = read_bundle(here / "with-pole.monoloc").original.covariances[len(room.original) :]
        assert abs(np.linalg.eigh(new.mean(axis=0))[1][:, -1] @ axis) > 0.99


@pytest.mark.parametrize(("turns", "option"), [(("--turn", "15"), "--turn"), (("--yaw", "15"), "--yaw"), ((), None)])
def test_turn_in_a_map_that_does_not_tell_gravity_is_warned_of(
    here: Path, capfd: pytest.CaptureFixture[str], turns: tuple[str, ...], option: str | None
) -> None:
    room = mapped_room()
    tilted = room.provenance.model_copy(update={"down_world": (0.0, 0.7, 0.7)})
    write_bundle(here / "room.monoloc", replace(room, provenance=tilted))
    _, err = outputs(capfd, *EDIT, "move", "--box", BOX, "--by", "0.5,0,0", *turns)
    problem = "is about the cameras' mean vertical, since the map does not give the direction of gravity"
    warned = f"warning: {option}: {problem}"
    assert err.startswith(warned) if option else "warning" not in err


def test_region_of_a_run_is_moved_or_removed(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    region = {
        "lower_m": (CUBE.centre - CUBE.half).tolist(),
        "upper_m": (CUBE.centre + CUBE.half).tolist(),
        "frames": 4,
    }
    run = {"digest": digest_of(here / "room.monoloc"), "changed_regions": [region]}
    (here / "run.json").write_text(json.dumps(run))
    moved = json_of(capfd, *EDIT, "move", "--changed", "run.json", "--by", "0.1,0,0")
    json_of(capfd, *EDIT, "undo")
    edited = json_of(capfd, *EDIT, "remove", "--changed", "run.json")
    assert moved["parameters"]["changed"] == edited["parameters"]["changed"] == "run.json"
    assert not CUBE.contains(read_bundle(here / "room.monoloc").landmarks.points.astype(np.float64)).any()
    # The room is another one now: what else lies in the box was not what the run saw.
    for again in (("remove",), ("move", "--by", "1,0,0")):
        refused(
            capfd, here, (*EDIT, *again, "--changed", "run.json"), "run.json", "another bundle than room", "--box"
        )


def test_edits_of_another_bundle_that_an_edit_replaces_are_noted(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    remove = (*EDIT, "remove", "--box", BOX, "--out", "other.monoloc")
    _, err = outputs(capfd, *remove)
    assert "replaces" not in err
    _, err = outputs(capfd, *remove)
    assert "note: other.monoloc: the new bundle replaces its edits (1), too\n" in err
    _, err = outputs(capfd, "map", "edit", "other.monoloc", "remove", "--box", BOX, "--out", "./other.monoloc")
    assert "replaces" not in err


def test_log_of_a_map_without_edits(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert succeeds(capfd, *EDIT, "log") == ""


def test_extend_and_merge(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_workspace(here, RoomRecording(Room(), make_path(6), SMALL_CAMERA), components=60)
    out, err = outputs(capfd, *EDIT, "extend", "flight", "--frames", "2:", "--json")
    assert "note: flight: frames that the map was made of are left out (2)" in err
    extended = json.loads(out)
    assert extended["parameters"] == {"source": "flight", "frames": "2:", "align": False}
    assert extended["changes"]["reference_poses"] == [3, 5] and extended["changes"]["frames_left_out"] == 2
    write_bundle(here / "a.monoloc", bundle_of_walk("A"))
    write_bundle(here / "b.monoloc", bundle_of_walk("B"))
    merged = json_of(capfd, "map", "edit", "a.monoloc", "merge", "b.monoloc", "--out", "both.monoloc")
    assert merged["kind"] == "merge" and merged["changes"]["overlap"] > 0.3
    assert len(read_bundle(here / "both.monoloc").reference_poses) == 28
    again = ("map", "edit", "both.monoloc", "merge", "b.monoloc")
    refused(capfd, here, again, "b.monoloc", "holds only frames that the map was made of", "another recording")
    lines = {
        ("extend", "flight", "--frames", "::2"): ("flight", "holds only frames that the map was made of", "--frames"),
        ("extend", "flight", "--align"): ("flight", "the bundle has no landmarks", "without --align"),
        ("extend", "flight", "--fix-poses", "nonsense"): ("--fix-poses", "nonsense", ""),
        ("merge", "b.monoloc"): ("b.monoloc", "the other bundle has no landmarks", "build both"),
        ("merge", "b.monoloc", "--out", "b.monoloc"): ("--out", "is read by this command", "another place"),
        ("merge", "room.monoloc"): ("OTHER", "room.monoloc is the same bundle", "another part"),
        ("merge", "none.monoloc"): ("none.monoloc", "is not a bundle", "monoloc build"),
    }
    for arguments, line in lines.items():
        refused(capfd, here, (*EDIT, *arguments), *line)


def test_extension_whose_frames_should_see_landmarks_and_do_not_is_refused(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_recording(here / "flight", RoomRecording(Room(), make_path(6), SMALL_CAMERA))  # another room
    arguments = (*EDIT, "extend", "flight", "--frames", "::2")
    problem = "contradicts the map: 0 of 3 frames see the landmarks that they should"
    refused(capfd, here, arguments, "flight", problem, "monoloc check; or align it: --align")


REFUSED = {
    "no box": (("remove",), "--box", "is missing", "--changed RUN.json"),
    "two regions": (("remove", "--box", BOX, "--changed", "run.json"), "--box", "both name a region", "give one"),
    "five numbers": (("remove", "--box", "1,2,3,4,5"), "--box", "is '1,2,3,4,5'", "in metres"),
    "no motion": (("move", "--box", BOX), "--by", "moves nothing", "--turn"),
    "no shift": (("move", "--box", BOX, "--by", "1,2"), "--by", "is '1,2'", "DX,DY,DZ"),
    "no place": (("add", "cube.npz", "--at", "here"), "--at", "is 'here'", "X,Y,Z"),
    "no cloud": (("add", "no.ply"), "no.ply", "there is no such file", "check the path"),
    "no run": (("remove", "--changed", "run.json"), "run.json", "cannot be read", "localize"),
    "empty box": (("remove", "--box", "8,8,8,9,9,9"), "--box", "holds nothing", "the map lies between"),
    "empty moved box": (
        ("move", "--box", "8,8,8,9,9,9", "--turn", "9"),
        "--box",
        "holds nothing",
        "the map lies between",
    ),
    "turn without end": (("move", "--box", BOX, "--turn", "nan"), "--turn", "is nan", "give degrees"),
    "turned cloud": (("add", "cube.npz", "--turn", "inf"), "--turn", "is inf", "give degrees"),
    "turned box": (("remove", "--box", BOX, "--yaw", "nan"), "--yaw", "is nan", "give degrees"),
    "turned moved box": (
        ("move", "--box", BOX, "--by", "1,0,0", "--yaw", "-inf"),
        "--yaw",
        "is -inf",
        "give degrees",
    ),
    "far cloud": (("add", "cube.npz", "--at", "400,1100,2000"), "cloud", "beyond the map", "are these millimetres"),
    "far move": (("move", "--box", BOX, "--by", "900,0,0"), "--by", "beyond the map", "are these millimetres"),
    "other name": (("remove", "--box", BOX, "--out", "x"), "--out", "is not named as a bundle", "NAME.monoloc"),
    "no folder": (("remove", "--box", BOX, "--out", "no/x.monoloc"), "no/x.monoloc", "does not exist", "make no"),
    "nothing to undo": (("undo",), "undo", "no edit to take back", "log"),
}


def test_bundle_comes_before_what_to_do(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    arguments = ("map", "edit", "log", "room.monoloc")
    refused(capfd, here, arguments, "BUNDLE", "comes before log", "monoloc map edit room.monoloc log")
    arguments = ("map", "edit", "merge", "room.monoloc", "my desk.monoloc", "--out", "both.monoloc")
    command = "write: monoloc map edit room.monoloc merge 'my desk.monoloc' --out both.monoloc"
    refused(capfd, here, arguments, "BUNDLE", "comes before merge", command)
    for options in (("--help",), ("--box", BOX, "--by", "1,0,0")):
        command = " ".join(("write: monoloc map edit BUNDLE move", *options))
        refused(capfd, here, ("map", "edit", "move", *options), "BUNDLE", "comes before move", command)


@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused_in_one_line(here: Path, capfd: pytest.CaptureFixture[str], name: str) -> None:
    arguments, names, problem, fix = REFUSED[name]
    refused(capfd, here, (*EDIT, *arguments), names, problem, fix)


def test_damaged_undo_is_refused(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    json_of(capfd, *EDIT, "remove", "--box", BOX)
    bundle = read_bundle(here / "room.monoloc")
    last = bundle.edits[-1]
    object.__setattr__(last, "undo", last.undo[:50])
    write_bundle(here / "room.monoloc", bundle)
    refused(capfd, here, (*EDIT, "undo"), "room.monoloc", "no whole archive", "copy the bundle")


def test_edit_of_a_bundle_that_another_command_changed_meanwhile_is_refused(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def meanwhile(bundle: Bundle, *given: object) -> Bundle:
        monkeypatch.undo()
        monkeypatch.chdir(here)
        succeeds(capfd, *EDIT, "remove", "--box", BOX)
        states.append(listing(here))
        return remove(bundle, *given)  # type: ignore[arg-type]

    states: list[dict[str, bytes | None]] = []
    monkeypatch.setattr("monoloc.cli.map_edit.remove", meanwhile)
    assert invoke([*EDIT, "remove", "--box", "-2,-1,2.5,2,1,3.2"]) == 2
    line = f"monoloc: {here / 'room.monoloc'}: was changed meanwhile by another command, so nothing is written; run"
    assert line in capfd.readouterr().err
    assert states == [listing(here)]  # the other's edit is there, and no other


def test_write_protected_bundle_is_refused_before_the_recording_is_looked_at(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(here / "walk", RoomRecording(Room(), make_path(3), SMALL_CAMERA))
    (here / "room.monoloc").chmod(0o555)
    monkeypatch.setattr("monoloc.cli.map_edit.extend", lambda *_: pytest.fail("the recording was looked at"))
    command = (*EDIT, "extend", "folder:walk")
    refused(capfd, here, command, "room.monoloc", "is write-protected", "chmod -R u\\+w")


def test_edit_that_cannot_be_written_leaves_the_bundle(
    here: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = listing(here)

    def full(self: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    refused(capfd, here, (*EDIT, "remove", "--box", BOX), "room.monoloc", "cannot be written", "make room")
    assert listing(here) == before
