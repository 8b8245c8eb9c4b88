"""``monoloc fly`` and ``monoloc replay``, end to end on a synthetic room."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import pty
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cli_helpers import json_of, listing, outputs, refused, succeeds, write_workspace
from marker_images import with_marker
from monoloc.bundle import read_bundle, write_bundle
from monoloc.cli.main import invoke
from monoloc.errors import DataError, SettingError
from monoloc.flight.flight_recording import FlightRecorder, image_path
from monoloc.flight.flight_settings import FlightSettings
from monoloc.flight.mcap_log import ros_frames_of
from monoloc.flight.pose_log import PoseLog
from monoloc.geometry import make_pose, quaternion_to_rotation, rotation_angle, rotation_to_quaternion, so3_exp
from monoloc.io.pose_table import COLUMNS, read_pose_table
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.rosbag import read as read_rosbag
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.live.replayed_recording import UnpacedRecording
from monoloc.localizer import Localizer
from monoloc.mavlink.autopilot_link import Attitude, AutopilotLink
from monoloc.odometry.gyroscope import Gyroscope
from monoloc.step import Step
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, plausible_integrity

FRAMES = 12
INTRINSICS = f"{SMALL_CAMERA.width},{SMALL_CAMERA.height},{SMALL_CAMERA.fx},{SMALL_CAMERA.fy}," + (
    f"{SMALL_CAMERA.cx},{SMALL_CAMERA.cy}"
)
RUN = [sys.executable, "-c", "from monoloc.cli.main import run; run()"]
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory, recording: RoomRecording) -> Path:
    """A folder with a recording, a bundle built from every second frame of it, and its fast flight ``log``."""
    folder = tmp_path_factory.mktemp("workspace")
    write_workspace(folder, recording)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        fly = ["fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--out", "poses.csv", "--record", "log"]
        assert invoke(fly) == 0
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert all(tuple(row) == COLUMNS and None not in row.values() for row in rows)
    return rows


# --- Fly and replay ---


def test_a_flight_is_where_the_camera_was(here: Path, recording: RoomRecording) -> None:
    rows = rows_of(here / "poses.csv")
    assert [row["state"] for row in rows].count("tracking") >= FRAMES - 1
    positions = np.array([[float(row[name]) for name in ("tx_m", "ty_m", "tz_m")] for row in rows])
    assert np.linalg.norm(positions - recording.poses[:, :3, 3], axis=1).max() < 0.15
    quaternions = np.array([[float(row[name]) for name in ("qx", "qy", "qz", "qw")] for row in rows])
    turns = np.swapaxes(quaternion_to_rotation(quaternions), 1, 2) @ recording.poses[:, :3, :3]
    assert np.rad2deg(rotation_angle(turns)).max() < 6.0
    times_s = np.array([float(row["time_s"]) for row in rows])
    np.testing.assert_allclose(np.diff(times_s), np.diff(recording.timestamps_s), atol=1e-6)
    assert (here / "log" / "poses.csv").read_bytes() == (here / "poses.csv").read_bytes()
    assert len(list((here / "log" / "images").iterdir())) == FRAMES


def test_a_recorded_flight_is_a_recording(capfd: Capture, here: Path, recording: RoomRecording) -> None:
    start = ",".join(map(str, [*recording.poses[0, :3, 3], *rotation_to_quaternion(recording.poses[0, :3, :3])]))
    figures = json_of(capfd, "localize", "room.monoloc", "log", f"--start={start}", "--out", "again.csv")
    assert figures["states"]["tracking"] >= FRAMES - 1
    times_s = [row["time_s"] for row in rows_of(here / "again.csv")]
    assert times_s == [row["time_s"] for row in rows_of(here / "poses.csv")]


def test_replay_computes_every_pose_to_the_last_bit(capfd: Capture, here: Path) -> None:
    (here / "again.csv").write_text("of a flight")
    figures = json_of(capfd, "replay", "log", "--out", "again.csv")
    assert (here / "again-1.csv").read_text() == "of a flight"
    expected = {"frames": FRAMES, "different_frames": 0, "first_different_frame": None, "same_messages": None}
    assert figures == expected
    assert (here / "again.csv").read_bytes() == (here / "poses.csv").read_bytes()
    shutil.move("room.monoloc", "elsewhere.monoloc")
    out, _ = outputs(capfd, "replay", "log", "--room", "elsewhere.monoloc")
    assert out == f"{FRAMES} frames: every pose is the same to the last bit\n"


def test_replay_of_a_moved_bundle_asks_for_it(capfd: Capture, here: Path) -> None:
    header = here / "log" / "flight.json"
    moved = str(here / "moved.monoloc")
    header.write_text(json.dumps(json.loads(header.read_bytes()) | {"bundle": moved}))
    refused(
        capfd,
        here,
        ("replay", "log"),
        moved,
        "was the bundle of this flight, and is no longer there",
        "path with --room",
    )


def test_replay_says_which_pose_is_not_the_same(capfd: Capture, here: Path) -> None:
    path = image_path(here / "log", 4)
    image = cv2.imread(str(path))
    assert image is not None and cv2.imwrite(str(path), image // 2)
    out, _ = outputs(capfd, "replay", "log")
    assert f"{FRAMES} frames: " in out and " differ from the flight, the first is 4\n" in out


def test_a_flight_that_was_killed_is_replayed_up_to_there(capfd: Capture, here: Path) -> None:
    """Its last line is cut, and the next pose and image are there already."""
    events = here / "log" / "frames.jsonl"
    lines = events.read_bytes().splitlines(keepends=True)
    events.write_bytes(b"".join(lines[:6]) + lines[6][:-10])
    poses = here / "log" / "poses.csv"
    out, err = outputs(capfd, "replay", "log")
    assert f"holds 6 whole frames and {FRAMES} poses" in err and "6 frames: every pose is the same" in out
    poses.write_bytes(b"".join(poses.read_bytes().splitlines(keepends=True)[:8]))  # a header and seven poses
    out, err = outputs(capfd, "replay", "log", "--json")
    assert "note" not in err
    assert json.loads(out) == {
        "frames": 6,
        "different_frames": 0,
        "first_different_frame": None,
        "same_messages": None,
    }


def test_what_a_budget_left_out_is_replayed_to_the_last_bit(capfd: Capture, here: Path) -> None:
    """No step takes a millisecond, so everything is left out that can be; with another budget, up to the fifth."""
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--out", "kept.csv", "--record", "kept")
    figures = json_of(capfd, *fly, "--budget-ms", "1")
    assert figures["levels"] == {"landmarks and depth in turn": FRAMES}
    assert [row["level"] for row in rows_of(here / "kept.csv")] == ["3"] * FRAMES
    assert json_of(capfd, "replay", "kept", "--out", "again.csv")["different_frames"] == 0
    assert (here / "again.csv").read_bytes() == (here / "kept.csv").read_bytes()
    assert json_of(capfd, "replay", "kept", "--budget-ms", "10000")["first_different_frame"] == 5


@pytest.mark.slow
def test_replay_uses_the_rotations_that_the_flight_was_given(
    capfd: Capture, here: Path, recording: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the images are black only the rotation moves the pose; without it, the poses are others."""
    for index in (6, 7, 8):
        assert cv2.imwrite(str(here / "flight" / "color" / f"{index:06d}.png"), np.zeros((128, 160, 3), np.uint8))
    rates = Gyroscope()
    for time_s in np.arange(-0.1, 2.0, 0.01):
        rates.add(time_s, [0.1, 0.7, -0.2])
    monkeypatch.setattr("monoloc.cli.fly.turns_of", lambda link: rates.between)
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--out", "turned.csv", "--record", "turned")
    assert json_of(capfd, *fly)["frames"] == FRAMES
    assert json_of(capfd, "replay", "turned", "--out", "again.csv")["different_frames"] == 0
    assert (here / "again.csv").read_bytes() == (here / "turned.csv").read_bytes()
    lines = (here / "turned" / "frames.jsonl").read_text()
    (here / "turned" / "frames.jsonl").write_text(re.sub(r'"rotation":\{.*?\}', '"rotation":null', lines))
    assert json_of(capfd, "replay", "turned")["different_frames"] > 0


def test_a_flight_at_the_recordings_pace_says_how_it_went(capfd: Capture, here: Path) -> None:
    _, err = outputs(capfd, "fly", "room.monoloc", "flight", "--start", "truth")
    *_, frames, dropped = err.splitlines()
    assert "tracking" in frames and " Hz, " in frames and " ms after capture (95 %: " in frames
    assert dropped.startswith("dropped: ") and dropped.endswith("; reconnections of the camera: 0")
    figures = json_of(capfd, "fly", "room.monoloc", "flight", "--start", "truth")
    assert figures["frames"] + sum(figures["dropped"].values()) == FRAMES
    assert sum(figures["states"].values()) == figures["frames"] > 0
    assert 0.0 < figures["latency_s_median"] <= figures["latency_s_p95"]
    assert figures["reconnections"] == 0


def test_messages_are_recorded_beside_the_flight_and_replayed_to_the_last_bit(capfd: Capture, here: Path) -> None:
    Path("flight.toml").write_text("down = [0, 1, 0]\nmost_age_s = 10.0\n")
    fly = ("fly", "room.monoloc", "flight", "--settings", "flight.toml", "--start", "truth", "--record", "sent")
    figures = json_of(capfd, *fly, "--mavlink", "udpout:127.0.0.1:9", "--firmware", "px4")
    assert figures["frames"] > 0 and figures["unwritten"] == {}
    assert (here / "sent" / "messages.tlog").stat().st_size > 100 * figures["frames"]
    replayed = json_of(capfd, "replay", "sent")
    assert replayed["different_frames"] == 0 and replayed["same_messages"]


def test_a_measurement_of_north_says_that_no_autopilot_is_heard(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("monoloc.flight.link_watch._SILENT_S", 0.0)
    (here / "down.toml").write_text("down = [0, 1, 0]\n")
    link = ("--mavlink", "udpout:127.0.0.1:9", "--firmware", "px4")
    assert (
        invoke(["fly", "room.monoloc", "flight", "--start", "truth", "--settings", "down.toml", *link, "--align"])
        == 2
    )
    err = capfd.readouterr().err
    assert "autopilot: no heartbeat" in err and "only 0 frames had a pose and an attitude" in err


def test_a_fast_flight_claims_no_latency(capfd: Capture, here: Path) -> None:
    _, err = outputs(capfd, "fly", "room.monoloc", "flight", "--fast", "--start", "truth")
    assert f"{FRAMES} frames: " in err and "after capture" not in err
    assert "dropped: none; reconnections of the camera: 0\n" in err


def test_systemd_hears_of_the_end_before_the_rest_is_written(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which may take longer than its watchdog waits."""
    heard: list[bytes] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0monoloc test of the end")
        systemd.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", "@monoloc test of the end")
        close = FlightRecorder.close

        def spy(recorder: FlightRecorder) -> None:
            with contextlib.suppress(BlockingIOError):
                while True:
                    heard.append(systemd.recv(100))
            close(recorder)

        monkeypatch.setattr(FlightRecorder, "close", spy)
        succeeds(capfd, "fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--record", "other")
    assert heard[0] == b"READY=1" and heard[-1] == b"STOPPING=1"


def test_a_flights_mcap_file_is_a_recording_with_its_poses(capfd: Capture, here: Path) -> None:
    """The room's y axis is down, the map's z axis is up; read back, the flight differs by that turn alone."""
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--out", "poses.csv", "--mcap", "a.mcap")
    assert json_of(capfd, *fly)["frames"] == FRAMES
    recording = read_rosbag(here / "a.mcap", ReaderOptions())
    times_s, poses = read_pose_table(here / "poses.csv")
    T_map_room = ros_frames_of(read_bundle(here / "room.monoloc"), FlightSettings()).T_map_room
    assert recording.poses is not None and len(recording) == len(times_s) // 3 == 4  # images come 5 times a second
    np.testing.assert_allclose(recording.timestamps_s, times_s[::3], atol=1e-6)
    np.testing.assert_allclose(recording.poses, T_map_room @ poses[::3], atol=1e-9)
    flight = RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)
    differences = [np.abs(recording.color(1).astype(int) - flight.color(index)).mean() for index in range(FRAMES)]
    assert np.argmin(differences) == 3
    succeeds(capfd, "localize", "room.monoloc", "flight", "--start", "truth", "--out", "b.mcap")
    assert len(read_rosbag(here / "b.mcap", ReaderOptions())) == 4


def test_files_of_an_earlier_flight_are_kept_under_a_number(capfd: Capture, here: Path) -> None:
    """A service that is restarted in flight, with the same file, flies."""
    before = (here / "poses.csv").read_bytes()
    (here / "a.mcap").write_bytes(b"of the flight before")
    content = 'room = "room.monoloc"\nsource = "flight"\nout = "poses.csv"\nmcap = "a.mcap"\n'
    (here / "flight.toml").write_text(content + "[mount]\n")
    _, err = outputs(capfd, "fly", "flight.toml", "--fast", "--frames", "0:2")
    assert "note: poses.csv: is there already, and is kept as poses-1.csv\n" in err
    assert "note: a.mcap: is there already, and is kept as a-1.mcap\n" in err and "taken to" not in err
    assert (here / "poses-1.csv").read_bytes() == before and len(rows_of(here / "poses.csv")) == 2
    assert (here / "a-1.mcap").read_bytes() == b"of the flight before"


# --- A file that holds the flight ---

FLIGHT = 'room = "room.monoloc"\nsource = "folder:flight"\nstart = "truth"\nout = "file-%Y.csv"\nrecord = "log-%Y"\n'


def test_a_file_alone_starts_a_flight_and_the_command_line_wins(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / "flight.toml").write_text(FLIGHT)
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")  # paths are beside the file
    outputs(capfd, "fly", "../flight.toml", "--fast")
    assert (here / f"file-{datetime.now():%Y}.csv").read_bytes() == (here / "poses.csv").read_bytes()
    assert (here / f"log-{datetime.now():%Y}" / "poses.csv").is_file()
    figures = json_of(capfd, "fly", "../flight.toml", "--start", "unknown", "--out", "other.csv", "--record", "log")
    assert figures["frames"] > 0 and rows_of(here / "elsewhere" / "other.csv")[0]["state"] == "lost"
    assert json_of(capfd, "replay", "log")["different_frames"] == 0


def test_a_marker_starts_a_flight_in_a_room_that_cannot_be_searched(
    capfd: Capture, here: Path, recording: RoomRecording
) -> None:
    """It is seen in the fourth frame alone; before, nothing is localised, and then the camera is where it was."""
    bundle = read_bundle(here / "room.monoloc")
    integrity = plausible_integrity(bundle.thresholds, search_precision=0.1)
    shutil.rmtree(here / "room.monoloc")
    write_bundle(here / "room.monoloc", replace(bundle, landmarks=Landmarks.none(), integrity=integrity))
    T_camera_marker = make_pose(so3_exp([2.6, 0.4, 0.3]), [0.05, 0.0, 0.7])
    image = with_marker(recording.color(3), SMALL_CAMERA, T_camera_marker, 0.25, 7)
    assert cv2.imwrite(str(here / "flight" / "color" / "000003.png"), image[..., ::-1])
    T_world_marker = recording.poses[3] @ T_camera_marker
    place, turn = T_world_marker[:3, 3].tolist(), rotation_to_quaternion(T_world_marker[:3, :3]).tolist()
    marker = f"[[marker]]\nid = 7\nsize_m = 0.25\nposition_m = {place}\nquaternion = {turn}\n"
    (here / "flight.toml").write_text('room = "room.monoloc"\nsource = "flight"\n' + marker)
    figures = json_of(capfd, "fly", "flight.toml", "--fast", "--out", "file.csv", "--record", "marked")
    assert figures["dropped"] == {"skipped": 0, "without start": 3}
    rows = rows_of(here / "file.csv")
    positions = np.array([[float(row[name]) for name in ("tx_m", "ty_m", "tz_m")] for row in rows])
    assert np.linalg.norm(positions - recording.poses[3:, :3, 3], axis=1).max() < 0.2
    again = json_of(capfd, "replay", "marked")
    assert (again["frames"], again["different_frames"]) == (FRAMES - 3, 0)


def test_a_doctors_report_is_written(capfd: Capture, here: Path) -> None:
    assert invoke(["doctor", "room.monoloc", "flight", "--seconds", "1", "--report", "report.json"]) in (0, 1, 2)
    report = json.loads((here / "report.json").read_text())
    assert report["findings"] and report["source"] == "recording"
    assert str(here) not in (here / "report.json").read_text()


def test_a_doctor_compares_the_mount_with_a_pose_that_knows_nothing_of_the_autopilots_attitude(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no landmark is seen, gravity by a mount that is 10 degrees wrong would turn the pose by seven of them."""
    bundle = read_bundle("room.monoloc")
    level = bundle.provenance.model_copy(update={"down_world": (0.0, 1.0, 0.0), "knows_down": True})
    write_bundle("level.monoloc", replace(bundle, provenance=level))
    used: list[object] = []
    step = Localizer.step

    def watched(self: Localizer, *frame: Any, down: object = None, **given: Any) -> Step:
        used.append(down)
        return step(self, *frame, **given)

    monkeypatch.setattr(Localizer, "step", watched)
    monkeypatch.setattr(AutopilotLink, "attitude_at", lambda self, time_s: Attitude(time_s, 0.0, 0.0, 0.0))
    link = ("--mavlink", "udpout:127.0.0.1:9", "--firmware", "px4")
    assert invoke(["doctor", "level.monoloc", "flight", "--seconds", "1", *link]) in (0, 1, 2)
    assert used and set(used) == {None}


def test_a_doctor_reports_a_camera_that_cannot_be_opened(capfd: Capture, here: Path) -> None:
    camera = ("camera:987", "--intrinsics", INTRINSICS)
    assert invoke(["doctor", "room.monoloc", *camera, "--report", "report.json", "--json"]) == 2
    report = json.loads((here / "report.json").read_text())
    assert report["camera"] is None and report["source"] == "camera:987"
    findings = {each["name"]: each for each in report["findings"]}
    assert findings["camera"]["level"] == "bad" and "cannot be opened" in findings["camera"]["value"]
    assert "gravity" in findings  # the room is looked at all the same
    assert json.loads(capfd.readouterr().out)["level"] == "bad"


# --- What is refused, with nothing half-written ---

LIVE = ("fly", "room.monoloc", "camera:987")


@pytest.mark.parametrize(
    ("arguments", "names", "problem", "fix"),
    [
        (LIVE, "--camera", "is missing", "monoloc calibrate"),
        ((*LIVE, "--intrinsics", INTRINSICS, "--fast"), "--fast", "no meaning for a live camera", "leave it out"),
        ((*LIVE, "--intrinsics", INTRINSICS, "--frames", "0:5"), "--frames", "no meaning for a live", "leave it out"),
        ((*LIVE, "--intrinsics", INTRINSICS), "camera:987", "cannot be opened", "plugged in"),
        (("fly",), "ROOM", "is missing", "name a bundle"),
        (("fly", "absent.monoloc", "flight"), "absent.monoloc", "", "monoloc build"),
        (("fly", "absent.toml"), "absent.toml", "there is no such flight file", "check the path"),
        (
            ("fly", "room.monoloc", "flight", "--start-error-deg", "5"),
            "--start-error-deg",
            "has no effect without a start",
            "give a start too",
        ),
        (("fly", "room.monoloc", "absent"), "", "does not exist", ""),
        (("fly", "room.monoloc", "flight", "--start", "1,2"), "--start", "is '1,2'", "TX,TY,TZ"),
        (("fly", "room.monoloc", "flight", "--settings", "absent.toml"), "absent.toml", "cannot be read", "TOML"),
        (("fly", "room.monoloc", "flight", "--record", "log"), "--record", "log is not empty", "new folder"),
        (("doctor", "room.monoloc", "flight", "--settings", "used.toml"), "used.toml: record", "not empty", "new"),
        (
            ("fly", "room.monoloc", "flight", "--settings", "used.toml", "--record", "poses.csv"),
            "--record",
            "poses.csv is a file",
            "name a folder",
        ),
        (("fly", "room.monoloc", "flight", "--record", "poses.csv"), "--record", "is a file", "name a folder"),
        (("fly", "room.monoloc", "flight", "--record", "x/y"), "--record", "does not exist", "make the folder"),
        (
            ("fly", "room.monoloc", "flight", "--record", "room.monoloc/x"),
            "--record",
            "lies in the bundle",
            "another",
        ),
        (
            ("fly", "room.monoloc", "flight", "--mcap", "a.bag"),
            "--mcap",
            "a.bag would be MCAP by another name",
            "NAME.mcap",
        ),
        (("fly", "room.monoloc", "flight", "--mcap", "x/y.mcap"), "--mcap", "does not exist", "make the folder"),
        (("fly", "room.monoloc", "flight", "--out", "x/y.csv"), "--out", "does not exist", "make the folder"),
        (("fly", "room.monoloc", "flight", "--out", "poses.csv", "--record", "log"), "--record", "not empty", "new"),
        (("fly", "room.monoloc", "flight", "--out", "poses.txt"), "--out", "would be a table by another", "NAME.csv"),
        (
            ("fly", "room.monoloc", "flight", "--out", "new/poses.csv", "--record", "new"),
            "--out",
            "lies in the folder of --record",
            "another place",
        ),
        (
            ("fly", "room.monoloc", "flight", "--out", "new.csv", "--record", "new.csv"),
            "--record",
            "new.csv is what --out writes",
            "another folder",
        ),
        (("replay", "log", "--out", "poses.txt"), "--out", "poses.txt would be a table by another name", "NAME.csv"),
        (("replay", "absent"), "absent", "is no recorded flight", "monoloc fly --record"),
        (("replay", "flight"), "flight", "is no recorded flight", "monoloc fly --record"),
        (("replay", "log", "--room", "flight"), "flight", "is not a bundle", "monoloc build"),
        (("replay", "log", "--out", "log/poses.csv"), "--out", "lies in log, which is read", "a new file"),
    ],
)
def test_wrong_arguments_are_refused(
    capfd: Capture, here: Path, arguments: tuple[str, ...], names: str, problem: str, fix: str
) -> None:
    (here / "used.toml").write_text('record = "log"\n')
    (here / "new").mkdir()
    refused(capfd, here, arguments, names, problem, fix)


@pytest.mark.parametrize("command", ["fly", "doctor"])
@pytest.mark.parametrize(
    ("field", "value", "problem", "fix"),
    [
        ("out", "x/y.csv", "x does not exist", "make the folder"),
        ("out", "poses.txt", "would be a table by another name", "NAME.csv"),
        ("mcap", "flight", "would be MCAP by another name", "NAME.mcap"),
        ("record", "poses.csv", "is a file", "name a folder"),
        ("camera", "640,480", "is '640,480'", "a .toml of monoloc calibrate"),
        ("start", "1,2", "is '1,2'", "TX,TY,TZ"),
        ("start_error_cm", 5.0, "has no effect without a start", "or leave it out"),
        ("mavlink", "here", "is 'here'", "udpin"),
        ("firmware", "px4", "is given without an autopilot", "give the autopilot's address"),
        ("source", "camera:x", "unknown format 'camera'", "known formats"),
    ],
)
def test_what_a_file_sets_is_refused_by_its_name_there(
    capfd: Capture, here: Path, command: str, field: str, value: str | float, problem: str, fix: str
) -> None:
    content = {"room": "room.monoloc", "source": "flight", "down": [0, 1, 0], field: value}
    content |= {"firmware": "px4"} if field == "mavlink" else {}
    content |= {"camera": INTRINSICS} if field == "source" else {}
    (here / "flight.toml").write_text("".join(f"{name} = {json.dumps(given)}\n" for name, given in content.items()))
    refused(capfd, here, (command, "flight.toml"), f"flight.toml: {field}: ", problem, fix)


def test_a_view_that_cannot_be_shown_leaves_nothing_that_refuses_the_next_flight(capfd: Capture, here: Path) -> None:
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--record", "seen")
    with socket.create_server(("0.0.0.0", 0)) as taken:
        port = str(taken.getsockname()[1])
        refused(capfd, here, (*fly, "--view-port", port), "--view-port", "is not free", "another one")


def test_a_view_names_a_camera_without_its_password(
    capfd: Capture, here: Path, recording: RoomRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its page is open to the whole network."""
    camera = UnpacedRecording(recording)
    camera.name = "rtsp://camera/1"
    names = []

    def view(name: str, *_: object) -> None:
        names.append(name)
        raise SettingError("--view-port", "is seen", "go on")

    monkeypatch.setattr("monoloc.cli.flight_options.open_live", lambda *_: camera)
    monkeypatch.setattr("monoloc.cli.fly.flight_view", view)
    fly = ("fly", "room.monoloc", "rtsp://user:secret@camera/1", "--camera", INTRINSICS, "--view-port", "9090")
    refused(capfd, here, fly, "--view-port", "is seen", "go on")
    assert names == ["room.monoloc: rtsp://camera/1"]


def test_a_disk_that_is_full_at_the_last_row_takes_no_summary(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: PoseLog, values: tuple[str, ...]) -> None:
        raise DataError("last.csv", "cannot be written (No space left on device)", "make room")

    monkeypatch.setattr(PoseLog, "_write_row", full)
    assert invoke(["fly", "room.monoloc", "flight", "--fast", "--frames", "0:1", "--out", "last.csv", "--json"]) == 2
    out, err = capfd.readouterr()
    assert json.loads(out)["frames"] == 1 and "monoloc: last.csv: cannot be written" in err


def test_another_bundle_and_damaged_flights_are_refused(capfd: Capture, here: Path) -> None:
    log, again = here / "log", ("replay", "log", "--room", "room.monoloc", "--out", "again.csv")
    manifest = here / "room.monoloc" / "manifest.json"
    whole = manifest.read_bytes()
    manifest.write_bytes(whole + b"\n")
    refused(capfd, here, again, "room.monoloc", "is not the bundle of this flight", "--room")
    manifest.write_bytes(whole)

    def is_refused_without(path: Path, content: bytes | None, names: str, problem: str, fix: str) -> None:
        before = path.read_bytes()
        path.unlink() if content is None else path.write_bytes(content)
        refused(capfd, here, again, names, problem, fix)
        path.write_bytes(before)

    events, poses, image = log / "frames.jsonl", log / "poses.csv", image_path(log, 7)
    lines = events.read_bytes().splitlines(keepends=True)
    rows = poses.read_bytes().splitlines(keepends=True)
    is_refused_without(log / "flight.json", b"{", "log/flight.json", "is damaged", "another flight")
    is_refused_without(events, None, "log/frames.jsonl", "is missing", "monoloc fly --record")
    is_refused_without(events, b"", "log", "holds no frame", "another flight")
    is_refused_without(events, b"".join([*lines[:5], b"\xff\n", *lines[5:]]), "log/frames.jsonl", "line 6", "another")
    is_refused_without(poses, None, "log/poses.csv", "cannot be read", "another flight")
    is_refused_without(poses, rows[0], "log/poses.csv", "holds no pose", "another flight")
    is_refused_without(image, image.read_bytes()[:-20], "log/images/000007.png", "is cut short", "copy")


def test_a_flight_that_broke_off_is_replayed_as_far_as_the_disk_had_taken_it(capfd: Capture, here: Path) -> None:
    """As after a loss of power, when the latest images are empty, and the tables end at other places."""
    shutil.copytree(here / "log", here / "short")
    for index in range(9, FRAMES):
        image_path(here / "short", index).write_bytes(b"")
    again = ("replay", "short", "--room", "room.monoloc", "--json")
    out, err = outputs(capfd, *again)
    assert (json.loads(out)["frames"], json.loads(out)["different_frames"]) == (9, 0)
    assert f"note: short: holds 9 whole frames and {FRAMES} poses: it was cut short, or not copied whole" in err
    poses = here / "short" / "poses.csv"
    poses.write_bytes(b"".join(poses.read_bytes().splitlines(keepends=True)[:6]) + b"0.25,1.0")
    out, err = outputs(capfd, *again)
    assert (json.loads(out)["frames"], json.loads(out)["different_frames"]) == (5, 0)
    assert "holds 9 whole frames and 5 poses" in err


def test_images_of_another_size_than_the_intrinsics_end_the_flight(capfd: Capture, here: Path) -> None:
    with (here / "small.jpg").open("wb") as file:
        file.write(cv2.imencode(".jpg", np.zeros((20, 30, 3), np.uint8))[1].tobytes())
    process = fly_in_process(here, "fly", "room.monoloc", "-", "--intrinsics", INTRINSICS)
    _, err = process.communicate((here / "small.jpg").read_bytes(), timeout=120)
    assert process.returncode == 2
    assert err.decode() == (
        "monoloc: standard input: gives images of 30x20, but the camera is 160x128; "
        "give the intrinsics of these images\n"
    )


def test_a_flight_that_the_camera_ends_says_what_it_came_to(capfd: Capture, here: Path) -> None:
    right = [path.read_bytes() for path in sorted((here / "flight" / "color").iterdir())[:3]]
    images = [cv2.imencode(".jpg", cv2.imdecode(np.frombuffer(each, np.uint8), 1))[1].tobytes() for each in right]
    small = cv2.imencode(".jpg", np.zeros((20, 30, 3), np.uint8))[1].tobytes()
    process = fly_in_process(here, "fly", "room.monoloc", "-", "--intrinsics", INTRINSICS, "--json")
    out, err = process.communicate(b"".join([*images, small, small]), timeout=120)
    assert process.returncode == 2
    assert json.loads(out)["frames"] >= 1
    assert err.decode().endswith("but the camera is 160x128; give the intrinsics of these images\n")


# --- In a process of its own ---


def heed_signals() -> None:
    """Background jobs and nohup ignore signals, and a child inherits that."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def fly_in_process(folder: Path, *arguments: str) -> subprocess.Popen[bytes]:
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [*RUN, *arguments], cwd=folder, stdin=pipe, stdout=pipe, stderr=pipe, preexec_fn=heed_signals
    )


def wait_for_rows(path: Path, count: int) -> None:
    end_s = time.monotonic() + 60.0
    while not path.exists() or path.read_bytes().count(b"\n") <= count:
        assert time.monotonic() < end_s
        time.sleep(0.02)


def stay_at_frame(recording: Path, index: int) -> None:
    """Make an hour pass before a frame of a recording."""
    poses = recording / "poses.txt"
    comment, *lines = poses.read_text().splitlines()
    times_s = [float(line.split()[0]) for line in lines]
    later = [line.replace(f"{t:.9f}", f"{t + 3600.0:.9f}") for line, t in zip(lines, times_s, strict=True)]
    poses.write_text("\n".join([comment, *lines[:index], *later[index:]]) + "\n")


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        signal.SIGKILL,
        *(pytest.param(number, marks=pytest.mark.slow) for number in (signal.SIGINT, signal.SIGHUP)),
    ],
)
def test_a_signal_ends_a_flight_with_whole_files_and_a_summary(capfd: Capture, here: Path, number: int) -> None:
    """A recording of an hour would not have ended. A kill takes the summary and the last frames, but no file."""
    stay_at_frame(here / "flight", 4)
    fly = ("fly", "room.monoloc", "flight", "--start", "truth", "--out", "live.csv", "--record", "live", "--json")
    process = fly_in_process(here, *fly)
    wait_for_rows(here / "live.csv", 2)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    rows = rows_of(here / "live.csv")
    again = json_of(capfd, "replay", "live")
    assert again["different_frames"] == 0
    if number == signal.SIGKILL:
        assert process.returncode == -number
        assert again["frames"] > 0  # and not those that waited to be written
    else:
        assert process.returncode == 0, err
        assert again["frames"] == len(rows) == json.loads(out)["frames"] < FRAMES
    assert not [name for name in listing(here) if "partial" in name]


def test_a_terminal_that_hangs_up_ends_a_flight_as_a_signal_does(capfd: Capture, here: Path) -> None:
    """As a dropped ssh session: writing to the terminal fails, too, and the kernel signals a second time."""
    stay_at_frame(here / "flight", 4)
    terminal, side = pty.openpty()
    fly = ("fly", "room.monoloc", "flight", "--start", "truth", "--out", "live.csv", "--record", "live")
    streams = {"stdin": side, "stdout": side, "stderr": side}
    process = subprocess.Popen([*RUN, *fly], cwd=here, **streams, start_new_session=True, preexec_fn=heed_signals)
    os.close(side)
    wait_for_rows(here / "live.csv", 2)
    process.send_signal(signal.SIGHUP)
    os.close(terminal)
    process.send_signal(signal.SIGHUP)
    assert process.wait(60) == 0
    again = json_of(capfd, "replay", "live")
    assert (again["frames"], again["different_frames"]) == (len(rows_of(here / "live.csv")), 0)


def test_a_flight_does_not_wait_for_those_who_should_read_its_lines(here: Path) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 4096)
    os.set_blocking(writing, True)
    fly = ("fly", "room.monoloc", "flight", "--fast", "--start", "truth", "--out", "live.csv")
    process = subprocess.Popen([*RUN, *fly], cwd=here, stderr=writing)
    assert process.wait(60) == 0
    assert len(rows_of(here / "live.csv")) == FRAMES
    os.close(reading)
    os.close(writing)


def test_motion_jpeg_on_standard_input(here: Path, recording: RoomRecording) -> None:
    """Two frames are localised while the writer still writes; then it ends, and so does the flight."""
    jpegs = [
        cv2.imencode(".jpg", recording.color(index)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
        for index in range(FRAMES)
    ]
    process = fly_in_process(here, "fly", "room.monoloc", "-", "--intrinsics", INTRINSICS, "--out", "live.csv")
    assert process.stdin is not None
    for index, jpeg in enumerate(jpegs[:2]):
        process.stdin.write(jpeg)
        process.stdin.flush()
        wait_for_rows(here / "live.csv", index + 1)
    _, err = process.communicate(b"".join(jpegs[2:]), timeout=60)
    assert process.returncode == 0, err
    rows = rows_of(here / "live.csv")
    assert len(rows) >= 3 and rows[0]["state"] == "lost"  # it was told no start
    times_s = [float(row["time_s"]) for row in rows]
    assert (np.diff(times_s) > 0.0).all()
    assert f"{len(rows)} frames: " in err.decode()
