"""``monoloc bench recovery`` and ``faults``: JSON keys, plausible values, tables and refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cli_helpers import json_of, outputs, refused
from edit_helpers import in_another_world
from monoloc.bundle import write_bundle
from monoloc.geometry import se3_exp
from synthetic_room import (
    SETTINGS,
    SMALL_CAMERA,
    Room,
    RoomRecording,
    make_bundle,
    make_path,
    room_mixture,
    write_recording,
)

FRAMES = 300  # 20 s, so that 10 s may be missing
RECOVERY_KEYS = {
    "starts", "supports_starts", "global_start_rate", "kidnaps", "kidnap_recovery_rate", "lost_reported_rate",
    "false_tracking_rate", "wrong_place_rate", "false_alarm_rate", "coverage_95", "coverage_99", "nees",
    "recovery_s_median", "map_edits", "map_changed_rate", "map_changed_false_rate",
    "near", "away",
}  # fmt: skip
RATES = {key for key in RECOVERY_KEYS if key.endswith("_rate") or key.startswith("coverage")}
# One fault of each kind.
FLOWN = ["none", "black", "dropped-10s", "time-backwards", "other-room", "intrinsics-minus-30"]
PART_KEYS = {"frames", "states", "silent_frames", "silent_share", "coverage_95"}
STATES = {"tracking", "uncertain", "lost", "map-changed", "refused"}
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recording ``flight`` and a bundle built from every second frame of it."""
    path = tmp_path_factory.mktemp("flights")
    recording = RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)
    write_recording(path / "flight", recording)
    bundle = make_bundle(room_mixture(Room(), 100), recording, range(0, FRAMES, 2))
    write_bundle(path / "room.monoloc", replace(bundle, settings=SETTINGS.model_copy(update={"particles": 200})))
    return path


@pytest.mark.slow
def test_recovery_and_faults_report_every_figure(capfd: Capture, folder: Path) -> None:
    arguments = (str(folder / "room.monoloc"), str(folder / "flight"))
    figures = json_of(capfd, "bench", "recovery", *arguments, "--kidnaps", "2", "--starts", "1", "--map-edits", "1")
    assert set(figures) == RECOVERY_KEYS
    assert (figures["kidnaps"], figures["starts"]) == (2, 1)
    assert all(figures[key] is None or 0.0 <= figures[key] <= 1.0 for key in RATES)
    assert figures["false_alarm_rate"] < 0.2 and figures["nees"] > 0.0
    only = [argument for name in FLOWN for argument in ("--only", name)]
    found = json_of(capfd, "bench", "faults", *arguments, *only, "--flights", "1")
    assert set(found) == {"faults", "totals", "left_out"} and found["left_out"] == []
    assert list(found["faults"]) == FLOWN
    assert set(found["totals"]) == {"frames", "silent_frames", "silent_share", "silent_frames_blind"}
    for figures in found["faults"].values():
        assert set(figures) == {"during", "after", "reported_s", "recovery_s", "silent_frames_blind"}
        for part in (figures["during"], figures["after"]):
            assert set(part) == PART_KEYS and set(part["states"]) <= STATES
            assert sum(part["states"].values()) == part["frames"]
    faults = found["faults"]
    assert faults["none"]["during"]["silent_frames"] == 0 and faults["none"]["recovery_s"] == 0.0
    assert faults["black"]["reported_s"] < 0.2 and faults["black"]["during"]["silent_frames"] == 0
    assert faults["time-backwards"]["during"]["states"] == {"refused": faults["none"]["during"]["frames"]}
    assert faults["dropped-10s"]["during"]["frames"] == 0


def test_recovery_and_faults_print_tables(capfd: Capture, folder: Path) -> None:
    """Of few frames, of which those for ten seconds without images are too few."""
    arguments = (str(folder / "room.monoloc"), str(folder / "flight"), "--frames", "0:240")
    out, _ = outputs(capfd, "bench", "recovery", *arguments, "--kidnaps", "0", "--starts", "0", "--map-edits", "0")
    assert "false tracking rate" in out
    moved = se3_exp([40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    elsewhere = in_another_world(RoomRecording(Room(), make_path(100), SMALL_CAMERA), moved)
    write_recording(folder / "elsewhere", elsewhere)
    of_other = (str(folder / "room.monoloc"), str(folder / "elsewhere"), "--kidnaps", "0", "--map-edits", "0")
    _, err = outputs(capfd, "bench", "recovery", *of_other, "--starts", "1")
    assert "was found after no start and no kidnap; monoloc check" in err
    out, err = outputs(
        capfd, "bench", "faults", *arguments, "--only", "black", "--only", "dropped-10s", "--flights", "1"
    )
    assert out.count("black") == 2 and "uncertain" in out and "recovery" in out
    assert "too few unseen frames in a row, so these are left out: dropped-10s" in err
    assert "frames are silent" in err


def test_bad_requests_are_refused(capfd: Capture, folder: Path, tmp_path: Path) -> None:
    arguments = (str(folder / "room.monoloc"), str(folder / "flight"))
    refused(capfd, tmp_path, ("bench", "faults", *arguments, "--only", "rain"), "--only", "is 'rain'", "name one of")
    short = ("bench", "faults", *arguments, "--frames", "0:60")
    refused(capfd, tmp_path, short, "flight", "has no 11 s of unseen frames in a row", "give more frames")
