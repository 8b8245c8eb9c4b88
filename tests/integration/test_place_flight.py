"""``monoloc fly`` and ``monoloc replay`` in a place of two rooms, and what they refuse there."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from contextlib import closing, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from pymavlink import mavutil

from cli_helpers import json_of, refused
from monoloc.bundle_manifest import NETWORK, PLACE_MANIFEST, manifest_content
from monoloc.bundle_signature import SIGNATURE, make_keys, signature_of
from monoloc.cli.main import invoke
from monoloc.flight.flight_settings import Mount
from monoloc.geometry import FloatArray, invert, make_pose, pose_distance_m, quaternion_to_rotation
from monoloc.io.pose_table import COLUMNS, ROOM
from monoloc.live.replayed_recording import UnpacedRecording
from monoloc.mavlink.autopilot_frames import AutopilotFrames
from monoloc.place.place_files import make_place, write_place
from monoloc.ros.ros_frames import pose_of
from monoloc.ros.step_messages import POSE, STATE
from place_rooms import LEFT, RIGHT, T_LEFT_RIGHT, true_door, turning, write_rooms
from ros_stage import Stage
from synthetic_room import Room, RoomRecording, write_recording

Capture = pytest.CaptureFixture[str]
FRAMES = 26
POSES = turning(-46.0, 46.0, FRAMES)  # through the door
# There is no time between texts, since the flight is short, and the networks count as tuned.
PATCHED = {"monoloc.flight.pose_sender._TEXT_S": 0.0, "monoloc.place.place_flight.tells_obstacles": lambda room: True}
NAMES = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rooms as ``house.place``, without their door as ``apart.place``; a flight through the door, ``log``."""
    folder = tmp_path_factory.mktemp("workspace")
    bundles = write_rooms(folder, 2)
    write_place(make_place(folder / "house.place", bundles).with_door(true_door()))
    write_place(make_place(folder / "apart.place", bundles))
    write_recording(folder / "walk", RoomRecording(Room(), POSES))
    (folder / "flight.toml").write_text('room = "house.place"\nsource = "folder:walk"\ndown = [0, 1, 0]\n')
    sent = ("--mavlink", "udpout:127.0.0.1:9", "--firmware", "px4", "--budget-ms", "10000")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr("monoloc.cli.flight_options.PacedRecording", UnpacedRecording)  # an autopilot forbids --fast
        for name, value in PATCHED.items():
            patch.setattr(name, value)
        with (folder / "said.txt").open("w") as said, redirect_stdout(said):
            written = ("--out", "poses.csv", "--mcap", "a.mcap", "--record", "log", "--json")
            assert invoke(["fly", "flight.toml", *written, *sent]) == 0
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert all(tuple(row) == (*COLUMNS, ROOM) and None not in row.values() for row in rows)
    return rows


def in_left(row: dict[str, str]) -> FloatArray:
    """The pose of a row in the world of the first room, (4, 4)."""
    numbers = np.array([float(row[name]) for name in NAMES])
    T_room_camera = make_pose(quaternion_to_rotation(numbers[3:]), numbers[:3])
    return {LEFT: np.eye(4), RIGHT: T_LEFT_RIGHT}[row[ROOM]] @ T_room_camera


def messages_of(path: Path, kind: str) -> Iterator[Any]:
    with closing(mavutil.mavlink_connection(str(path))) as read:
        while (message := read.recv_match(type=kind)) is not None:
            yield message


def test_a_flight_goes_through_a_door(here: Path) -> None:
    """Each pose is in the world of its room, which table, JSON and ROS messages name."""
    figures = json.loads((here / "said.txt").read_text())
    assert [(each["before"], each["after"]) for each in figures["switches"]] == [(None, LEFT), (LEFT, RIGHT)]
    rows = rows_of(here / "poses.csv")
    assert figures["frames"] == len(rows) == FRAMES
    assert figures["rooms"] == {name: sum(row[ROOM] == name for row in rows) for name in (LEFT, RIGHT)}
    unknown = {(row["state"], row["reasons"], row["tx_m"], row[ROOM]) for row in rows[:3]}
    assert unknown == {("lost", "searching", "", "")}
    for row, pose in zip(rows[3:], POSES[3:], strict=True):
        assert pose_distance_m(pose, in_left(row)[None])[0] < 0.1
    with (here / "a.mcap").open("rb") as file:
        read = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/monoloc/state")
        values = [{each.key: each.value for each in state.status[0].values} for *_, state in read]
    assert [each.get("room", "") for each in values] == [row[ROOM] for row in rows]


def test_an_autopilot_has_one_frame_in_all_rooms(here: Path) -> None:
    """It is the first room's; the pilot hears the room, and a hand-over counts as a jump."""
    T_body_camera = Mount().T_body_camera
    frames = AutopilotFrames(T_body_camera, [0.0, 1.0, 0.0], 0.0)
    known = {round(1e6 * float(row["time_s"])): row for row in rows_of(here / "poses.csv") if row[ROOM]}
    counts: dict[str, set[int]] = {LEFT: set(), RIGHT: set()}
    for message in messages_of(here / "log" / "messages.tlog", "ODOMETRY"):
        row = known[message.time_usec]
        T_ned_body = frames.T_ned_world @ in_left(row) @ invert(T_body_camera)
        np.testing.assert_allclose([message.x, message.y, message.z], T_ned_body[:3, 3], atol=1e-4)
        counts[row[ROOM]].add(message.reset_counter)
    assert all(counts.values()) and not counts[LEFT] & counts[RIGHT]
    assert len(list(messages_of(here / "log" / "messages.tlog", "OBSTACLE_DISTANCE"))) > 10
    texts = [message.text for message in messages_of(here / "log" / "messages.tlog", "STATUSTEXT")]
    assert texts == ["monoloc: lost: searching", *(f"monoloc: tracking in {name}" for name in (LEFT, RIGHT))]


def test_a_flight_in_a_place_is_replayed_to_the_last_bit(
    capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in PATCHED.items():
        monkeypatch.setattr(name, value)
    shutil.move("house.place", "moved.place")
    replayed = json_of(capfd, "replay", "log", "--room", "moved.place", "--out", "again.csv")
    assert (replayed["frames"], replayed["different_frames"], replayed["same_messages"]) == (FRAMES, 0, True)
    assert (here / "again.csv").read_bytes() == (here / "poses.csv").read_bytes()


FLY = ("fly", "house.place", "walk")


@pytest.mark.parametrize(
    ("arguments", "names", "problem", "fix"),
    [
        (("fly", "absent.place", "walk"), "absent.place", "is not a place", "monoloc place new"),
        ((*FLY, "--start", "0,0,0,0,0,0,1"), "--start", "a place is searched for the camera", "leave it out"),
        (
            (*FLY, "--settings", "marked.toml"),
            "marked.toml: marker",
            "a place is searched for the camera",
            "leave markers out",
        ),
        (("fly", "apart.place", "walk"), "apart.place", f"no doors lead from room {RIGHT} to {LEFT}", "place door"),
        ((*FLY, "--out", "house.place/poses.csv"), "--out", "lies in the place house.place", "another place"),
        (("doctor", "apart.place", "walk"), "apart.place", "no doors lead from room", "place door"),
        (("doctor", "house.place", "walk", "--settings", "marked.toml"), "marked.toml: marker", "is given", "leave"),
        (("replay", "log", "--room", "apart.place"), "apart.place", "is not the place of this flight", "--room"),
    ],
)
def test_what_makes_no_sense_in_a_place_is_refused(
    capfd: Capture, here: Path, arguments: tuple[str, ...], names: str, problem: str, fix: str
) -> None:
    marker = "[[marker]]\nid = 7\nsize_m = 0.25\nposition_m = [0, 0, 1]\nquaternion = [0, 0, 0, 1]\n"
    Path("marked.toml").write_text(marker)
    refused(capfd, here, arguments, names, problem, fix)


def test_a_flight_that_does_not_begin_for_a_damaged_room_leaves_no_trace(capfd: Capture, here: Path) -> None:
    """Files of earlier flights stay, whichever room it is; no folder or file is begun."""
    written = ("--out", "poses.csv", "--mcap", "a.mcap", "--record", "log-2")
    localize = ("place", "localize", "house.place", "walk", "--out", "poses.csv")
    for room in (LEFT, RIGHT):
        file = here / f"{room}.monoloc" / "landmarks.npz"
        whole = file.read_bytes()
        file.write_bytes(whole[:-1])
        for command in ((*FLY, "--fast", *written), localize):
            refused(capfd, here, command, str(file), "is not what was written", "copy the bundle again")
        file.write_bytes(whole)


def test_the_ros_node_goes_through_a_door_in_one_frame(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its poses are in the world of the first room, which is ``room``; the state names the room."""
    stage = Stage(monkeypatch, RoomRecording(Room(), POSES), here / "flight.toml")
    stage.begin()
    stage.give_camera()
    for index in range(FRAMES):
        stage.give_image(index)
    stage.give_start(np.eye(4))
    assert stage.ros.said == ["/initialpose is not used: a place is searched for the camera"]
    rooms = [
        {each.key: each.value for each in message.status[0].values}.get("room", "") for message in stage.ros.of(STATE)
    ]
    assert list(dict.fromkeys(rooms)) == ["", LEFT, RIGHT]
    poses = [pose_of(message) for message in stage.ros.of(POSE)]
    assert len(poses) >= FRAMES - 4
    tree = stage.tree(-1)
    T_room_camera = invert(tree["map", "room"]) @ poses[-1] @ tree["base_link", "cam_optical"]
    assert pose_distance_m(POSES[-1], T_room_camera[None])[0] < 0.1


def test_the_ros_node_outlives_a_room_that_cannot_be_read(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It says so, finds the camera in another room, and goes on through the door when the room is back."""
    monkeypatch.setattr("monoloc.place.loaded_rooms._RETRY_S", 0.5)
    stage = Stage(monkeypatch, RoomRecording(Room(), POSES), here / "flight.toml")
    stage.begin()
    stage.give_camera()
    shutil.move(f"{RIGHT}.monoloc", "away.monoloc")
    for index in range(6):
        stage.give_image(index)
    assert len(set(stage.ros.said)) == 1 and f"{RIGHT}.monoloc" in stage.ros.said[0] and stage.ros.of(POSE)
    shutil.move("away.monoloc", f"{RIGHT}.monoloc")
    for index in range(6, FRAMES):
        stage.give_image(index)
    assert {each.key: each.value for each in stage.ros.of(STATE)[-1].status[0].values}["room"] == RIGHT


def test_the_doctor_looks_through_a_place(capfd: Capture, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And names no room in a report, which is for others to read."""
    monkeypatch.setattr("monoloc.cli.flight_options.PacedRecording", UnpacedRecording)
    assert invoke(["doctor", "flight.toml", "--seconds", "60", "--report", "report.json", "--json"]) == 1
    content = json.loads(capfd.readouterr().out)
    findings = {finding["name"]: finding for finding in content["findings"]}
    assert content["frames"] == FRAMES and set(content["rooms"]) == {LEFT, RIGHT}
    assert "2 of the place" in findings["rooms"]["value"]
    assert findings["landmarks"]["level"] == findings["gravity"]["level"] == "good"
    report = (here / "report.json").read_text()
    assert len(json.loads(report)["maps"]) == 2 and "rooms" not in json.loads(report)
    assert f'"{LEFT}"' not in report and f'"{RIGHT}"' not in report


def test_a_place_and_every_bundle_of_it_must_be_signed(capfd: Capture, here: Path) -> None:
    """But a place that is made or gets a door, which its signature would cover, needs only signed bundles."""
    make_keys(here / "team.key", here / "team.pub")
    left, right = Path.cwd() / f"{LEFT}.monoloc", Path.cwd() / f"{RIGHT}.monoloc"
    (left / SIGNATURE).write_bytes(signature_of(manifest_content(left), here / "team.key"))
    key = ("--require-signature", "team.pub")
    read = [
        (*FLY, "--fast", "--frames", "0:1"),
        ("place", "localize", "house.place", "walk", "--frames", "0:1"),
        ("place", "info", "house.place"),
    ]
    new = ("place", "new", "new.place", str(left), str(right))
    for command in (*read, new, ("place", "door", "house.place", LEFT, RIGHT, "--same-world")):
        refused(capfd, here, (*command, *key), str(right), "is not signed", "signed copy")
    (right / SIGNATURE).write_bytes(signature_of(manifest_content(right), here / "team.key"))
    json_of(capfd, *new, *key)
    for command in read:
        refused(capfd, here, (*command, *key), "house.place", "is not signed", "signed copy")
    json_of(capfd, "signature", "sign", "house.place", "--key", "team.key")
    json_of(capfd, "signature", "verify", "house.place", "--key", "team.pub")
    for command in read:
        json_of(capfd, *command, *key)
    manifest = here / "house.place" / PLACE_MANIFEST
    manifest.write_text(manifest.read_text().replace('"radius_m": 1.0', '"radius_m": 2.0'))
    refused(capfd, here, (*read[2], *key), "house.place", "was changed", "copy it again")
    network = right / NETWORK
    network.write_bytes(network.read_bytes() + b"x")  # its manifest, and so its signature, are as they were
    verify = ("signature", "verify", "house.place", "--key", "team.pub")
    for command in (*((*command, *key) for command in read), read[2], verify):
        refused(capfd, here, command, str(network), "is not what was written", "copy the bundle again")
