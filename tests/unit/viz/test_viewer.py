"""The viewer's window and file, and what happens where they cannot be opened or written."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import rerun
import rerun_cli

from monoloc.errors import DataError, SettingError
from monoloc.viz import viewer
from monoloc.viz.viewer import require_window, run_viewer
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_bundle, make_path, room_mixture
from viewer_helpers import RUN_ENTITIES, Recorded, file_names, show_run

FRAMES = 4


def free_port() -> int:
    with socket.socket() as chosen:
        chosen.bind(("127.0.0.1", 0))
        return int(chosen.getsockname()[1])


@pytest.fixture
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without a display, on which no viewer listens."""
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(viewer, "WINDOW_PORT", free_port())


def test_missing_display_is_reported(no_display: None) -> None:
    with pytest.raises(SettingError, match=r"^--view: there is no display; give --record FILE\.rrd"):
        require_window()


def test_window_that_does_not_open_is_reported(monkeypatch, no_display):
    monkeypatch.setenv("DISPLAY", ":77")
    monkeypatch.setattr(rerun, "spawn", lambda **_: None)
    viewing = run_viewer("a run", view=True, record=None)
    with pytest.raises(SettingError, match="--view: Rerun did not open its window"), viewing:
        pytest.fail("the run began")


def test_lost_window_is_not_reported_as_a_problem_of_the_file(monkeypatch, tmp_path, no_display):
    def lost(stream: rerun.RecordingStream, window: rerun.GrpcSink, file: Any, **_: Any) -> None:
        raise RuntimeError("no connection")

    monkeypatch.setattr(viewer, "open_window", lambda: None)
    monkeypatch.setattr(rerun.RecordingStream, "set_sinks", lost)
    viewing = run_viewer("a run", view=True, record=tmp_path / "run.rrd")
    with pytest.raises(SettingError, match=r"^--view: the window is lost \(no connection\); try again$"), viewing:
        pytest.fail("the run began")
    assert file_names(tmp_path) == []


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # while the listener still writes it
def test_listening_viewer_receives_the_run(tmp_path, no_display):
    """The same as is recorded at the same time."""
    recording = RoomRecording(Room(), make_path(FRAMES), SMALL_CAMERA)
    bundle = make_bundle(room_mixture(Room(), 60), recording)
    program = Path(rerun_cli.__file__).with_name("rerun")
    live = tmp_path / "live.rrd"
    command = [program, "--save", live, "--port", str(viewer.WINDOW_PORT)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as listener:
        while not viewer._is_listening():
            assert listener.poll() is None
            time.sleep(0.05)
        with run_viewer("a run", view=True, record=tmp_path / "file.rrd") as both:
            show_run(bundle, recording, both)
        recorded = Recorded(tmp_path / "file.rrd")
        expected, until = recorded.frames("/world/camera", "Transform3D:translation"), time.monotonic() + 20.0
        while Recorded(live).frames("/world/camera", "Transform3D:translation") != expected:
            assert time.monotonic() < until
            time.sleep(0.1)
        listener.terminate()
    assert len(expected) == FRAMES
    assert Recorded(live).entities >= RUN_ENTITIES


def test_missing_folder_is_named(tmp_path):
    viewing = run_viewer("a run", view=False, record=tmp_path / "gone" / "a.rrd")
    with pytest.raises(DataError, match=r"gone/a\.rrd: cannot be written .*; name a file"), viewing:
        pytest.fail("the run began")


def test_truncated_recording_is_removed(tmp_path):
    """As on a full disk, which Rerun does not report to its caller."""
    viewing = run_viewer("a run", view=False, record=tmp_path / "run.rrd")
    with pytest.raises(DataError, match=r"run\.rrd: cannot be written"), viewing:
        (partial,) = tmp_path.iterdir()
        partial.write_bytes(b"")
    assert file_names(tmp_path) == []
