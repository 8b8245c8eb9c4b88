"""A file that holds everything of a flight."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from monoloc.flight.flight_file import read_flight_file
from monoloc.flight.flight_settings import FlightSettings, Mount
from monoloc.io.registry import open_recording
from monoloc.mavlink.firmware import Firmware
from refusals import refuses_data
from repository import REPOSITORY

MARKER = "[[marker]]\nid = 7\nsize_m = 0.16\nposition_m = [1.0, 2.0, 0.5]\n"
TEXT = f"""
room = "kitchen.monoloc"
source = "7scenes:kitchen"
camera = "cam.toml"
mavlink = "udpout:127.0.0.1:14540"
firmware = "px4"
start = "0,0,1,0,0,0,1"
start_error_cm = 20
record = "flight-%Y"
mcap = "logs/%Y.mcap"
north_deg = 75.5
most_age_s = 0.3
dictionary = "apriltag_25h9"

[mount]
pitch_deg = -90

{MARKER}rpy_deg = [90, 0, 0]
"""


def test_everything_is_read_and_paths_are_beside_the_file(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(TEXT)
    flight = read_flight_file(path)
    assert flight.room == tmp_path / "kitchen.monoloc" and flight.record == tmp_path / "flight-%Y"
    assert flight.mcap == tmp_path / "logs" / "%Y.mcap"
    assert (flight.source, flight.camera) == (f"7scenes:{tmp_path}/kitchen", str(tmp_path / "cam.toml"))
    assert (flight.mavlink, flight.firmware) == ("udpout:127.0.0.1:14540", Firmware.PX4)
    assert (flight.start, flight.start_error_cm) == ("0,0,1,0,0,0,1", 20.0)
    assert flight.settings == FlightSettings(mount=Mount(pitch_deg=-90), north_deg=75.5, most_age_s=0.3)
    assert flight.markers is not None and flight.markers.dictionary == "apriltag_25h9"
    # On a wall: what is up on the sheet is up in the world, whose z axis points up.
    np.testing.assert_allclose(flight.marker[0].T_world_marker[:3, 1], [0.0, 0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("source", ["camera:1", "rtsp://10.0.0.1/x", "picamera", "-"])
def test_a_live_source_is_no_path(tmp_path: Path, source: str) -> None:
    (tmp_path / "flight.toml").write_text(f'source = "{source}"\ncamera = "640,480,525,525,319.5,239.5"\n')
    flight = read_flight_file(tmp_path / "flight.toml")
    assert (flight.source, flight.camera) == (source, "640,480,525,525,319.5,239.5")
    assert flight.markers is None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('mavlnik = "udpin:0.0.0.0:14550"\n', "mavlnik: is unknown, the nearest is mavlink"),
        (MARKER + "siz_m = 1\n", "marker.0.siz_m: is unknown, the nearest is size_m"),
        ('firmware = "inav"\n', "firmware: .*'px4' or 'ardupilot'"),
        (MARKER, "give either quaternion or rpy_deg"),
        (MARKER + "rpy_deg = [0, 0, 0]\nquaternion = [0, 0, 0, 1]\n", "give either quaternion or rpy_deg"),
        (MARKER + "rpy_deg = [1e200, 0, 0]\n", "marker.0.rpy_deg.0: must be less than or equal to 360"),
        ("out = 1\n", "out: must be a path, in quotes"),
        ("[marker]\nid = 7\n", r"marker: must be a list, .*\[\[\.\.\.\]\]"),
        ("[[mount]]\npitch_deg = -15\n", r"mount: must be one table, as \[\.\.\.\] and not \[\[\.\.\.\]\]"),
        ("mount = -15\n", r"mount: must be one table, as \[\.\.\.\]"),
        ('record = "a\\u0000b"\n', "record: holds a null character"),
        ('source = "7scenes:a\\u0000b"\n', "source: holds a null character"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(text)
    refuses_data(lambda: read_flight_file(path), path, problem, "correct the field named")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (2 * (MARKER + "rpy_deg = [0, 0, 0]\n"), "two markers have the same id"),
        (
            MARKER.replace("7", "587") + "rpy_deg = [0, 0, 0]\n",
            "a marker has the id 587, but those of apriltag_36h11 are 0 to 586",
        ),
    ],
)
def test_what_is_wrong_with_several_markers_names_no_field(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "flight.toml"
    path.write_text(text)
    refuses_data(lambda: read_flight_file(path), path, f"^: {problem}", "correct it$")


@pytest.mark.parametrize("page", ["fly", "mavlink", "companion-computer", "start-by-a-marker"])
def test_the_documents_examples_are_flights(tmp_path: Path, page: str) -> None:
    text = (REPOSITORY / "docs" / "how-to" / f"{page}.md").read_text(encoding="utf-8")
    examples = re.findall(r"^ *```toml\n(.*?)^ *```", text, re.DOTALL | re.MULTILINE)
    assert examples
    for example in examples:
        (tmp_path / "flight.toml").write_text(example)
        read_flight_file(tmp_path / "flight.toml")


def test_the_home_of_an_unknown_user_is_a_path_that_is_not_found(tmp_path: Path) -> None:
    path = tmp_path / "flight.toml"
    path.write_text('room = "~nobody-here/room.monoloc"\nsource = "~nobody-here/flight"\nout = "~/poses.csv"\n')
    flight = read_flight_file(path)
    assert flight.room == tmp_path / "~nobody-here" / "room.monoloc" and flight.out == Path.home() / "poses.csv"
    refuses_data(lambda: open_recording(flight.source), tmp_path / "~nobody-here" / "flight", "does not exist", "")
    refuses_data(lambda: open_recording("~nobody-here/x"), Path("~nobody-here/x").absolute(), "does not exist", "")
