"""``monoloc inspect``: what a recording holds, read as far as its first frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from cli_helpers import json_of, refused, succeeds
from monoloc.bundle import read_bundle, write_bundle
from monoloc.bundle_manifest import PLACE_MANIFEST
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.supervision.integrity import Classes, IntegrityModel
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    synthetic.write_folder(tmp_path / "flight")
    synthetic.write_video(tmp_path / "flight.avi")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_recording_is_described(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    content = json_of(capfd, "inspect", "flight", "--frames", "0:2")
    assert content["kind"] == "recording" and content["frames"] == 2
    assert content["image"] == [32, 24] and content["intrinsics"] == [30.0, 31.0, 15.5, 11.5]
    assert content["has_poses"] and content["has_depth"]
    assert content["first_frame_depth_share"] == pytest.approx(23 / 24)
    assert content["seconds"] == pytest.approx(0.1)
    step = np.diff(synthetic.make_poses(2)[:, :3, 3], axis=0)
    assert content["path_m"] == pytest.approx(np.linalg.norm(step), abs=1e-6)
    assert content["first_frame_depth_median_m"] == pytest.approx(1.5)


@pytest.mark.filterwarnings("error")
def test_frame_without_depth_has_no_median_depth(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    synthetic.write_depth(here / "flight/depth/000010.png", np.zeros((24, 32), dtype=np.uint16))
    content = json_of(capfd, "inspect", "flight")
    assert content["first_frame_depth_share"] == 0.0 and content["first_frame_depth_median_m"] is None


def test_video_is_described_with_its_distortion(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    command = ("inspect", "flight.avi", "--intrinsics", "64,48,50,50,31,23,-0.08,0.01,0.001,-0.002,0.0004")
    content = json_of(capfd, *command)
    assert content["frames"] == 6 and content["intrinsics"] == [50.0, 50.0, 31.0, 23.0]
    assert content["distortion"] == [-0.08, 0.01, 0.001, -0.002, 0.0004]
    assert not content["has_poses"] and not content["has_depth"]
    assert "-0.08, 0.01, 0.001, -0.002, 0.0004" in succeeds(capfd, *command)


def test_a_person_is_shown_no_settings_of_a_bundle(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    """A hundred lines would hide what a bundle is of; JSON has them."""
    recording = RoomRecording(Room(), make_path(4), SMALL_CAMERA)
    write_bundle(here / "room.monoloc", make_bundle(room_mixture(Room()), recording))
    table = succeeds(capfd, "inspect", "room.monoloc")
    assert "landmarks" in table and "particles" not in table
    assert json_of(capfd, "inspect", "room.monoloc")["settings"]["particles"] > 0
    refused(capfd, here, ("inspect", "text.monoloc"), "text.monoloc", "is not a bundle", "monoloc build")


def test_bundle_says_what_tells_right_from_wrong_beliefs(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    room = Room()
    recording = RoomRecording(room, make_path(4), SMALL_CAMERA)
    scan = Classes(edges=(-1.5,), right=(0.1, 0.9), wrong=(0.75, 0.25))
    integrity = IntegrityModel(scan=scan, unseen_share=0.2, scan_search_precision=0.8)
    bundle = replace(
        make_bundle(room_mixture(room, 20), recording),
        integrity=integrity,
        reference_poses=ReferencePoses.without_bias(recording.poses),
    )
    write_bundle(here / "room.monoloc", bundle)
    content = json_of(capfd, "inspect", "room.monoloc")
    assert content["supports_relocalization"] and content["supports_scan_search"]
    assert content["integrity"]["unseen_share"] == 0.2
    assert content["integrity"]["scan_search_precision"] == 0.8
    assert content["integrity"]["scan"] == {"edges": [-1.5], "right": [0.1, 0.9], "wrong": [0.75, 0.25]}
    assert content["sensor"]["thresholds"] is None
    np.testing.assert_allclose(content["down"], read_bundle(here / "room.monoloc").down)
    table = succeeds(capfd, "inspect", "room.monoloc")
    assert table.index("down ") < table.index("mean camera down") < table.index("monoloc version")
    assert "supports relocalization" in table and "scan_search_precision" not in table
    write_bundle(here / "mute.monoloc", replace(bundle, integrity=IntegrityModel()))
    content = json_of(capfd, "inspect", "mute.monoloc")
    assert not content["supports_relocalization"] and not content["supports_scan_search"]


@pytest.mark.parametrize(
    ("components", "told", "by", "mean"),
    [
        (20, {}, "floor and walls", [0.0, 1.0, 0.0]),
        (20, {"knows_down": True}, "the recording", None),
        (1, {}, None, [0.0, 1.0, 0.0]),
        (1, {"kept_down": (0.0, 1.0, 0.0)}, "floor and walls before an edit", [0.0, 1.0, 0.0]),
    ],
)
def test_bundle_says_what_told_gravity(
    capfd: pytest.CaptureFixture[str],
    here: Path,
    components: int,
    told: dict[str, object],
    by: str | None,
    mean: list[float] | None,
) -> None:
    room = Room()
    bundle = make_bundle(room_mixture(room, components), RoomRecording(room, make_path(2), SMALL_CAMERA))
    provenance = bundle.provenance.model_copy(update={"down_world": (0.0, 1.0, 0.0), **told})
    write_bundle(here / "room.monoloc", replace(bundle, provenance=provenance))
    content = json_of(capfd, "inspect", "room.monoloc")
    assert (content["down"] is None, content["down_by"], content["mean_camera_down"]) == (by is None, by, mean)
    assert not {"down_world", "knows_down", "kept_down"} & set(content)


def test_missing_file_is_named(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "flight/color/000020.jpg").unlink()
    refused(capfd, here, ("inspect", "flight"), "flight/color/000020.jpg", "is missing", "restore it")


def test_place_is_left_to_its_own_command(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "house.place").mkdir()
    (here / "house.place" / PLACE_MANIFEST).write_text("{}")
    fix = "monoloc place info house.place"
    refused(capfd, here, ("inspect", "house.place"), "house.place", "is a place of several rooms", fix)
