"""A flight on disk: as it was to the last bit, whole after a kill, and never in the flight's way."""

from __future__ import annotations

import json
import re
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavlink_helpers import CAMERA, result_at, step_at
from monoloc.errors import DataError
from monoloc.flight import flight_recording
from monoloc.flight.flight_loop import FlightStep
from monoloc.flight.flight_recording import (
    FlightHeader,
    FlightRecorder,
    RecordedFrame,
    RecordedIdle,
    RecordedStart,
    image_path,
    read_events,
    read_header,
)
from monoloc.flight.flight_settings import FlightSettings, Mount
from monoloc.geometry import se3_exp, so3_exp
from monoloc.mavlink.firmware import Firmware
from monoloc.odometry.motion import Motion
from monoloc.start import Start
from monoloc.step_budget import Level
from refusals import refuses_data

POSE = se3_exp(np.array([0.1, -0.7, 1.0 / 3.0, 0.3, 2.0, -0.4]))
HEADER = FlightHeader(
    bundle="/rooms/kitchen.monoloc",
    digest="ab" * 32,
    camera=replace(CAMERA, distortion=(-0.08, 0.01, 0.0, 1e-4, 0.0)),
    start=RecordedStart.of(Start(POSE, 0.1, 1.0 / 3.0)),
    seed=7,
    settings=FlightSettings(mount=Mount(pitch_deg=-30.1), down=(0.0, 0.1, 1.0)),
    firmware=Firmware.PX4,
)


def result(index: int) -> FlightStep:
    """A frame of noise, whose times are no round numbers, and every second one with gravity and a rotation."""
    rng = np.random.default_rng(index)
    color = rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    step = replace(step_at(POSE), level=Level.IN_TURN if index % 2 else Level.FULL)
    made = result_at(1234.5 + index / 3.0, step)
    down = None if index % 2 else rng.standard_normal(3)
    motion = None if index % 2 else Motion.rotation(so3_exp(rng.standard_normal(3)), 1.0 / 300.0)
    frame = replace(made.frame, color=color)
    return replace(made, frame=frame, elapsed_s=index / 7.0, down_camera=down, measured_motion=motion)


def record(folder: Path, frames: int = 4) -> list[FlightStep]:
    """A flight in which once no frame came, after the first two."""
    results = [result(index) for index in range(frames)]
    recorder = FlightRecorder(folder, HEADER)
    for index, each in enumerate(results):
        if index == 2:
            recorder.idle(0.1 + 0.2)
        recorder.take(each)
    recorder.close()
    return results


def lines(folder: Path) -> list[bytes]:
    return (folder / "frames.jsonl").read_bytes().splitlines(keepends=True)


def test_what_is_read_is_what_was_recorded_to_the_last_bit(tmp_path: Path) -> None:
    results = record(tmp_path / "new" / "flight")
    assert read_header(tmp_path / "new" / "flight") == HEADER
    header = FlightHeader.model_validate_json(HEADER.model_dump_json())
    assert header.start is not None
    assert (header.start.start.pose == POSE).all() and header.start.error_rad == 1.0 / 3.0
    events = list(read_events(tmp_path / "new" / "flight", CAMERA))
    assert events.pop(2) == RecordedIdle(idle_s=0.1 + 0.2)
    for event, before in zip(events, results, strict=True):
        assert isinstance(event, tuple)
        color, frame = event
        np.testing.assert_array_equal(color, before.frame.color)
        assert (frame.captured_s, frame.elapsed_s) == (before.frame.captured_s, before.elapsed_s)
        assert frame.done_s == before.done_s and frame.level is before.step.level
        assert (frame.down is None) == (before.down_camera is None)
        if frame.down is not None:
            np.testing.assert_array_equal(frame.down, before.down_camera)
        assert (frame.motion is None) == (before.measured_motion is None)
        if frame.motion is not None and before.measured_motion is not None:
            expected = before.measured_motion
            np.testing.assert_array_equal(frame.motion.T_previous_current, expected.T_previous_current)
            assert frame.motion.rotation_sd_rad == expected.rotation_sd_rad and frame.motion.translation == "unknown"


def test_a_folder_that_holds_something_or_cannot_be_made_is_refused_and_unchanged(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes").write_text("mine")
    refuses_data(lambda: FlightRecorder(tmp_path / "full", HEADER), tmp_path / "full", "is not empty", "new folder")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["notes"]
    (tmp_path / "file").write_text("mine")
    refuses_data(lambda: FlightRecorder(tmp_path / "file", HEADER), tmp_path / "file", "cannot be made", "new folder")
    (tmp_path / "empty").mkdir()
    FlightRecorder(tmp_path / "empty", HEADER).close()


@pytest.mark.parametrize("cut", [1, 5, 40])
def test_a_last_line_that_a_kill_cut_is_left_out(tmp_path: Path, cut: int) -> None:
    record(tmp_path)
    data = (tmp_path / "frames.jsonl").read_bytes()
    (tmp_path / "frames.jsonl").write_bytes(data[:-cut])
    assert len(list(read_events(tmp_path, CAMERA))) == 4


def test_a_line_is_written_after_its_image_and_its_pose(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So a kill leaves no line without them."""
    write_whole, states = flight_recording.write_whole, []

    def slowly(path: Path, content: bytes, **options: bool) -> None:
        if path.suffix == ".png":
            rows = (tmp_path / "poses.csv").read_bytes().splitlines()[1:]
            states.append((len(lines(tmp_path)), len(rows)))
        write_whole(path, content, **options)

    monkeypatch.setattr(flight_recording, "write_whole", slowly)
    record(tmp_path)
    assert states == [(0, 0), (1, 1), (3, 2), (4, 3)]
    assert not list(tmp_path.rglob("*.partial"))


def test_the_same_folder_is_taken_once_a_full_disk_has_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, content: bytes) -> None:
        raise DataError(path, "cannot be written (No space left on device)", "make room")

    with monkeypatch.context() as full:
        full.setattr(flight_recording, "write_whole", refuse)
        refuses_data(lambda: record(tmp_path / "flight"), tmp_path / "flight" / "flight.json", "No space", "room")
    record(tmp_path / "flight")
    assert len(lines(tmp_path / "flight")) == 5


def test_damaged_files_are_named(tmp_path: Path) -> None:
    record(tmp_path)
    events, whole = tmp_path / "frames.jsonl", (tmp_path / "frames.jsonl").read_bytes()
    first, *rest = lines(tmp_path)
    no_start = json.dumps({"pose": [1.0] * 16, "error_m": 0.1, "error_rad": 0.1}).encode()
    far_start = json.dumps({"pose": np.eye(4).ravel().tolist(), "error_m": 1e300, "error_rad": 0.1}).encode()
    for damaged in (
        b"{}\n",
        b"not JSON\n",
        b"\xff\xfe\n",
        first.replace(b'"elapsed_s":0.0', b'"elapsed_s":-1.0'),
        first.replace(b'"elapsed_s":0.0', b'"elapsed_s":NaN'),
        first.replace(b'"elapsed_s":0.0', b'"elapsed_s":1e300'),
        first.replace(b'"done_s":', b'"more":1,"done_s":'),
        re.sub(rb'"captured_s":[^,]*,', b'"captured_s":1e300,', first),
        re.sub(rb'"done_s":[^,]*,', b'"done_s":-1e300,', first),
        first.replace(b'"start":null', b'"start":' + no_start),
        first.replace(b'"start":null', b'"start":' + far_start),
        re.sub(rb'"down_camera":[^"]*,"', b'"down_camera":[0.0,0.0,0.0],"', first),
        re.sub(rb'"down_camera":[^"]*,"', b'"down_camera":[1e308,1e308,1e308],"', first),
        first.replace(b'"sd_rad":0.0', b'"sd_rad":-1.0'),
        first.replace(b'"R_previous_current":[', b'"R_previous_current":[2'),
        b"[" * 100_000 + b"\n",
    ):
        assert damaged != first
        events.write_bytes(first + damaged + b"".join(rest))
        refuses_data(lambda: list(read_events(tmp_path, CAMERA)), events, "is damaged in line 2", "another flight")
    events.write_bytes(whole)
    image = image_path(tmp_path, 3)
    data = image.read_bytes()
    image.write_bytes(data[:-20])
    refuses_data(lambda: list(read_events(tmp_path, CAMERA)), image, "is cut short", "copy")
    image.write_bytes(data)
    small = replace(CAMERA, width=20, cx=9.5)
    refuses_data(lambda: list(read_events(tmp_path, small)), image_path(tmp_path, 0), "is 40x30, but", "intrinsics")
    image.write_bytes(b"")  # as after a loss of power
    assert sum(isinstance(event, tuple) for event in read_events(tmp_path, CAMERA)) == 3
    image.unlink()
    assert sum(isinstance(event, tuple) for event in read_events(tmp_path, CAMERA)) == 3
    events.unlink()
    refuses_data(lambda: list(read_events(tmp_path, CAMERA)), events, "is missing", "monoloc fly --record")


def test_damaged_headers_are_named(tmp_path: Path) -> None:
    folder, path = tmp_path / "flight", tmp_path / "flight" / "flight.json"
    refuses_data(lambda: read_header(folder), folder, "is no recorded flight", "--record")
    record(folder)
    whole = json.loads(path.read_text())
    for changes, problem in (
        ({"seed": "x"}, "seed: "),
        ({"seed": -1}, "seed: "),
        ({"digest": None}, "digest: "),
        ({"more": 1}, "more: "),
        ({"camera": {**whole["camera"], "fx": -1.0}}, "camera.fx/fy"),
        ({"start": {"pose": [1.0] * 15, "error_m": 0.1, "error_rad": 0.1}}, "start.pose: .*at least 16"),
        ({"start": {"pose": [1.0] * 16, "error_m": 0.1, "error_rad": 0.1}}, "pose must be a rigid"),
        ({"settings": {"rate_hz": 0}}, "settings.rate_hz: "),
    ):
        path.write_text(json.dumps({**whole, **changes}))
        refuses_data(lambda: read_header(folder), path, f"is damaged .{problem}", "another flight")
    path.write_bytes(b"\xff\xfe{}")
    refuses_data(lambda: read_header(folder), path, "is not a text file", "copy")


def test_a_full_disk_ends_the_recording_once_and_leaves_whole_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_whole = flight_recording.write_whole

    def write(path: Path, content: bytes, **options: bool) -> None:
        if path == image_path(tmp_path, 2):
            raise DataError(path, "cannot be written (No space left on device)", "make room")
        write_whole(path, content, **options)

    recorder = FlightRecorder(tmp_path, HEADER)
    monkeypatch.setattr(flight_recording, "write_whole", write)
    with pytest.raises(DataError, match=r"000002\.png: cannot be written \(No space left on device\)"):
        for index in range(1000):
            recorder.take(result(index))
            time.sleep(0.002)
    for index in range(100):  # a flight that went on all the same would not be held up
        recorder.take(result(index))
    recorder.close()
    assert len([event for event in read_events(tmp_path, CAMERA) if isinstance(event, tuple)]) == 2


def test_what_fails_at_the_last_frame_is_said_when_the_flight_closes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bug, too: nothing of the thread may vanish, and nothing wait for it."""
    recorder = FlightRecorder(tmp_path, HEADER)
    monkeypatch.setattr(flight_recording, "image_path", lambda *_: 1 / 0)
    recorder.take(result(0))
    with pytest.raises(ZeroDivisionError):
        recorder.close()
    recorder.close()


def test_a_disk_that_stands_still_ends_the_recording_and_not_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight_recording, "_MOST_WAIT_S", 0.05)
    write_whole, goes_on = flight_recording.write_whole, threading.Event()

    def write(path: Path, content: bytes, **options: bool) -> None:
        goes_on.wait(30.0)
        write_whole(path, content, **options)

    recorder = FlightRecorder(tmp_path, HEADER)
    monkeypatch.setattr(flight_recording, "write_whole", write)
    began_s = time.monotonic()
    with pytest.raises(DataError, match="cannot be written as fast"):
        for index in range(1000):
            recorder.take(result(index))
    assert time.monotonic() - began_s < 10.0
    goes_on.set()
    recorder.close()
    for event in read_events(tmp_path, CAMERA):
        assert isinstance(event, tuple) and isinstance(event[1], RecordedFrame)
