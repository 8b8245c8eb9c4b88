"""A flight that ``monoloc fly --record`` kept, as a recording: its images and times, and what may be wrong."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording, select_frames
from monoloc.io.upright import is_upright
from refusals import refuses_data, refuses_setting, refuses_to_open
from synthetic_recordings import check_recording, make_color, write_color

CAMERA = Camera(64, 48, 50.0, 50.0, 31.0, 23.0, (0.1, 0.0, 0.0, 0.0, 0.0))
TIMES_S = [100.0, 100.5, 100.75]


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    folder = tmp_path / "monday"
    lines = [{"captured_s": time_s, "elapsed_s": 0.1, "done_s": time_s} for time_s in TIMES_S]
    for index in range(len(lines)):
        write_color(folder / "images" / f"{index:06d}.png", make_color(64, 48, index))
    (folder / "flight.json").write_text(json.dumps({"monoloc_version": "0.1.0", "camera": asdict(CAMERA)}))
    events = [lines[0], {"idle_s": 100.2}, *lines[1:]]
    (folder / "frames.jsonl").write_text("".join(json.dumps(event) + "\n" for event in events))
    return folder


def test_images_and_times_are_those_of_the_flight(flight: Path) -> None:
    for source in (str(flight), f"flight:{flight}"):
        recording = open_recording(source)
        check_recording(recording, 3)
        assert recording.timestamps_s.tolist() == TIMES_S
        assert (recording.name, recording.camera, recording.poses) == ("monday", CAMERA, None)
        assert recording.frame_names == ["000000", "000001", "000002"]
        np.testing.assert_array_equal(recording.color(2), make_color(64, 48, 2))


@pytest.mark.parametrize("is_known", [True, False])
def test_images_that_a_flight_knew_to_be_upright_are_not_turned_again(flight: Path, is_known: bool) -> None:
    header = json.loads((flight / "flight.json").read_text())
    (flight / "flight.json").write_text(json.dumps(header | {"stands_upright": is_known}))
    assert is_upright(open_recording(str(flight))) is is_known
    assert is_upright(select_frames(open_recording(str(flight)), "1:")) is is_known


def test_a_flight_that_broke_off_is_read_as_far_as_it_is_whole(flight: Path) -> None:
    lines = flight / "frames.jsonl"
    lines.write_text(lines.read_text()[:-5])  # a kill
    assert open_recording(str(flight)).timestamps_s.tolist() == TIMES_S[:2]
    (flight / "images" / "000001.png").write_bytes(b"")  # a loss of power
    recording = open_recording(str(flight))
    assert recording.timestamps_s.tolist() == TIMES_S[:1]
    assert recording.notes == ["1 of 2 frames are left out: 1 from the first one without an image on"]


def test_other_intrinsics_may_be_given_but_no_scale_of_depth(flight: Path) -> None:
    other = Camera(64, 48, 60.0, 60.0, 31.0, 23.0)
    assert open_recording(str(flight), ReaderOptions(camera=other)).camera == other
    refuses_setting(lambda: open_recording(str(flight), ReaderOptions(depth_scale=5.0)), "depth_scale", "flight", "")


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("{", "is damaged in line 5"),
        ("[1]", "is damaged in line 5"),
        ('{"captured_s": "1"}', "is damaged in line 5"),
        ('{"captured_s": NaN}', "is damaged in line 5"),
        ('{"captured_s": 99.0}', "the time stamp of entry 4 does not increase"),
    ],
)
def test_damaged_lines_are_refused(flight: Path, line: str, problem: str) -> None:
    lines = flight / "frames.jsonl"
    lines.write_text(lines.read_text() + line + "\n")
    refuses_to_open(flight, lines, problem, "")


@pytest.mark.parametrize("camera", [None, {}, asdict(CAMERA) | {"fx": -1.0}])
def test_a_flight_without_its_camera_is_refused(flight: Path, camera: object) -> None:
    header = flight / "flight.json"
    header.write_text(json.dumps({"camera": camera}))
    refuses_to_open(flight, header, "does not tell the camera", "give another flight")


def test_a_flight_without_frames_is_refused(flight: Path) -> None:
    (flight / "frames.jsonl").write_text('{"idle_s": 100.2}\n')
    refuses_to_open(flight, flight, "it has no frames", "give another flight")
    (flight / "frames.jsonl").unlink()
    missing = flight / "frames.jsonl"
    refuses_data(lambda: open_recording(f"flight:{flight}"), missing, "is missing", "monoloc fly --record")
