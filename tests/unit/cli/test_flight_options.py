"""What a user asks for of a flight, and its frames: turned upright once, by the mount or by a recording's gravity."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from monoloc.cli.flight_options import flight_of, note_of_mount, open_frames
from monoloc.flight.flight_file import FlightFile
from monoloc.flight.flight_settings import Mount
from monoloc.io.folder_writer import write_folder
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

ROLLED = np.diag([-1.0, -1.0, 1.0, 1.0])  # of a camera upside down, in a world whose y axis points down


def test_a_percent_sign_in_the_folder_of_a_flight_is_no_time(tmp_path: Path) -> None:
    folder = tmp_path / "run%d"
    folder.mkdir()
    (folder / "flight.toml").write_text('room = "a%Y.monoloc"\nout = "poses-%Y.csv"\nrecord = "log"\n')
    room, flight, *_ = flight_of(folder / "flight.toml", None)
    assert (room, flight.out) == (folder / "a%Y.monoloc", folder / f"poses-{datetime.now():%Y}.csv")
    assert flight.record == folder / "log"


def test_mount_and_heading_are_said_to_be_assumed_where_nobody_states_them(tmp_path: Path) -> None:
    toml = tmp_path / "flight.toml"

    def said(content: str, measures_north: bool = False, **options: object) -> list[str]:
        toml.write_text('room = "a.monoloc"\n' + content)
        asked = flight_of(toml, None, **options)
        return list(note_of_mount(asked.flight, asked.stated, measures_north))

    to_autopilot = {"mavlink": "udpin:127.0.0.1:14550"}
    (note,) = said("", **to_autopilot)
    assert note.startswith("note: no [mount] and no north_deg: the camera is taken to look forward, upright, from")
    assert note.endswith("x axis is taken to point north; write [mount] and north_deg into flight.toml")
    (note,) = said("north_deg = 0.0\n", **to_autopilot)
    assert note.startswith("note: no [mount]: ") and "north" not in note
    assert said("[mount]\nyaw_deg = 0.0\n", measures_north=True, **to_autopilot) == []
    assert said("north_deg = 0.0\n[mount]\n", **to_autopilot) == []
    assert said("") == []  # nothing rests on them
    assert len(said('mcap = "a.mcap"\n')) == 1


def test_an_error_of_a_start_that_the_command_line_takes_back_is_left_alone(tmp_path: Path) -> None:
    toml = tmp_path / "flight.toml"
    toml.write_text('room = "a.monoloc"\nstart = "truth"\nstart_error_cm = 5.0\n')
    assert flight_of(toml, None, start="unknown").flight.start == "unknown"


@pytest.mark.parametrize("tells_down", [True, False])
def test_images_of_a_recording_are_turned_once(tmp_path: Path, tells_down: bool) -> None:
    recording = RoomRecording(Room(), make_path(3) @ ROLLED, SMALL_CAMERA)
    write_folder(tmp_path / "walk", recording, [recording.depth(index) for index in range(3)])
    if tells_down:
        with (tmp_path / "walk/dataset.toml").open("a") as file:
            file.write("down = [0, 1, 0]\n")
    flight = FlightFile(source=str(tmp_path / "walk"), mount=Mount(roll_deg=180.0))
    source, camera, first_pose, are_upright = open_frames(flight, "::", fast=True)
    frame = source.next(1.0)
    assert frame is not None and camera == SMALL_CAMERA.turned(2) and are_upright
    np.testing.assert_array_equal(frame.color, np.rot90(recording.color(0), 2))
    np.testing.assert_allclose(first_pose, recording.poses[0] @ ROLLED, atol=1e-6)


@pytest.mark.parametrize(("mount", "is_known"), [(Mount(), False), (Mount(forward_m=0.1), True)])
def test_without_mount_and_gravity_images_are_not_known_to_be_upright(
    tmp_path: Path, mount: Mount, is_known: bool
) -> None:
    recording = RoomRecording(Room(), make_path(3), SMALL_CAMERA)
    write_folder(tmp_path / "walk", recording, [recording.depth(index) for index in range(3)])
    assert open_frames(FlightFile(source=str(tmp_path / "walk"), mount=mount), "::", fast=True)[3] is is_known
