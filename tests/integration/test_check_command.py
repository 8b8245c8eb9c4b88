"""The command ``check``: its exit code, table, JSON and picture; and builds that it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from altered_recordings import POSES
from cli_helpers import QUICK, outputs, refused, write_workspace
from monoloc.cli.main import invoke
from monoloc.geometry import rotation_to_quaternion
from plot_helpers import check_picture
from synthetic_recordings import tum_lines
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

FRAMES = 30


@pytest.fixture(scope="module")
def flight() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, flight: RoomRecording) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, flight)
    return folder


def write_poses(here: Path, flight: RoomRecording, poses: np.ndarray, times: np.ndarray | None = None) -> None:
    text = tum_lines(flight.timestamps_s if times is None else times, poses)
    (here / "flight" / "poses.txt").write_text(text)


def checked(capfd: pytest.CaptureFixture[str], code: int, *arguments: str) -> tuple[dict[str, Any], str]:
    """The JSON and stderr of a check that ends with an exit code."""
    capfd.readouterr()
    assert invoke(["check", *arguments, "--json"]) == code
    out, err = capfd.readouterr()
    result = json.loads(out)
    assert isinstance(result, dict)
    return result, err


def test_right_recording_is_good(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result, err = checked(capfd, 0, "flight", "--plot", "pictures.png")
    assert result["level"] == "good" and result["poses"]["verdict"] == "agree"
    assert {finding["level"] for finding in result["findings"]} == {"good"}
    assert "flight: good" in err and "focal length" in err and "written: pictures.png" in err
    (here / "drawn").mkdir()
    (here / "pictures.png").rename(here / "drawn" / "pictures.png")
    check_picture(here / "drawn" / "pictures.png", 1200, 800)


def test_what_was_found_is_on_stdout_unless_json_is(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert invoke(["check", "flight"]) == 0
    assert capfd.readouterr().out.startswith("flight: good\n")
    assert "flight: good\n" in checked(capfd, 0, "flight")[1]


def test_other_convention_is_bad_is_not_built_and_is_good_once_fixed(
    here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    assert flight.poses is not None
    write_poses(here, flight, POSES["COLMAP"].poses(flight.poses))
    fix = "--fix-poses w-first,world-to-camera"
    result, err = checked(capfd, 2, "flight")
    assert result["poses"]["explanation"]["option"] == fix and "w first" in err
    problem = r"disagree: by poses and depth, corners land \d+% .* quaternions with w first and world-to-camera"
    refused(capfd, here, ("build", "flight", "--out", "a.monoloc", *QUICK), "flight: ", problem, f"give {fix}$")
    assert checked(capfd, 0, "flight", *fix.split())[0]["level"] == "good"


@pytest.mark.slow  # that poses are fixed, the check above has, and that right ones are built from, test_commands.py
def test_other_convention_is_built_from_once_it_is_fixed(
    here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    assert flight.poses is not None
    write_poses(here, flight, POSES["COLMAP"].poses(flight.poses))
    fix = "--fix-poses w-first,world-to-camera"
    outputs(capfd, "build", "flight", "--out", "a.monoloc", "--no-landmarks", *fix.split(), *QUICK)
    assert (here / "a.monoloc" / "manifest.json").is_file()


@pytest.mark.slow
def test_localize_and_evaluate_warn_of_another_convention_and_fix_it(
    here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    """The bundle's world is the right poses'. Frames are localised all the same: images need no poses."""
    assert flight.poses is not None
    start = ",".join(map(repr, flight.poses[0, :3, 3].tolist()))
    turn = ",".join(map(repr, rotation_to_quaternion(flight.poses[0, :3, :3]).tolist()))
    localize = ("localize", "room.monoloc", "flight", "--start", f"{start},{turn}")
    outputs(capfd, *localize, "--out", "right.txt")
    write_poses(here, flight, POSES["COLMAP"].poses(flight.poses))
    fix = ("--fix-poses", "w-first,world-to-camera")
    warning = (
        r"warning: flight: errors against its poses mean nothing: .*; give --fix-poses w-first,world-to-camera\n"
    )
    errors = {}
    for command in (localize, ("evaluate", "right.txt", "flight")):
        out, err = outputs(capfd, *command, "--json")
        assert re.search(warning, err), err
        fixed, silent = outputs(capfd, *command, *fix, "--json")
        assert "warning" not in silent
        errors[command[0]] = json.loads(out)["ate_rmse_m"], json.loads(fixed)["ate_rmse_m"]
    for wrong, right in errors.values():
        assert right < 0.3 < 0.6 < wrong


def test_times_in_milliseconds_are_not_built(
    here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    assert flight.poses is not None
    write_poses(here, flight, flight.poses, 1000.0 * flight.timestamps_s)
    arguments = ("build", "flight", "--out", "a.monoloc", *QUICK)
    refused(capfd, here, arguments, "flight: ", "they look like milliseconds", "divide them by 1000")


def test_frame_numbers_give_exit_code_1(here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]) -> None:
    assert flight.poses is not None
    write_poses(here, flight, flight.poses, np.arange(float(FRAMES)))
    result, err = checked(capfd, 1, "flight")
    assert result["level"] == "warning" and "they look like frame numbers" in " ".join(err.split())


def test_doubled_times_are_called_doubled(
    here: Path, flight: RoomRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    assert flight.poses is not None
    times = flight.timestamps_s.copy()
    times[7] = times[6]
    write_poses(here, flight, flight.poses, times)
    refused(capfd, here, ("check", "flight"), "flight/poses.txt: ", "entry 8 .* it is doubled", "keep one of the two")


def test_unusable_arguments_are_refused(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for arguments, names, problem, fix in (
        (("flight", "--fix-poses", "sideways"), "--fix-poses: ", "'sideways' is no fix", "names are w-first"),
        (("flight", "--fix-depth", "sideways"), "--fix-depth: ", "is 'sideways'", "choose one of range"),
        (("room.monoloc",), "SOURCE: ", "is missing after the bundle", "give the recording"),
        (("flight", "room.monoloc"), "SOURCE: ", "is a bundle", "monoloc check room.monoloc flight"),
        (("flight", "--plot", "check.jpg"), "--plot: ", "would be a PNG by another name", "name it"),
    ):
        refused(capfd, here, ("check", *arguments), names, problem, fix)


def test_bundle_without_landmarks_in_sight_is_bad(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    result, _ = checked(capfd, 2, "room.monoloc", "flight")
    assert result["map"] == {
        "frames": 24, "found": 0, "agreeing": None, "offset_m": None, "offset_deg": None, "T_map_world": None,
        "focal": None, "aspect": None,
    }  # fmt: skip


def test_recording_without_poses_is_warned_of_before_a_build_and_not_before_a_flight(
    here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    description = here / "flight/dataset.toml"
    description.write_text(description.read_text().replace('poses = "poses.txt"', "rate_hz = 15"))
    for arguments, level in ((("flight",), "warning"), (("room.monoloc", "flight"), "good")):
        capfd.readouterr()
        invoke(["check", *arguments, "--json"])
        findings = json.loads(capfd.readouterr().out)["findings"]
        assert [each["level"] for each in findings if each["name"] == "poses"] == [level]
