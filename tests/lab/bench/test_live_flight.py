"""A live flight over sockets on a synthetic room: camera, link and process go and come back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cli_helpers import json_of, write_workspace
from monoloc.camera import Camera
from monoloc.cli.common import parse_intrinsics
from monoloc.errors import MonolocError
from monoloc.mavlink.firmware import Firmware
from monoloc_lab.soak import live_flight
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

pytest.importorskip("av")
pytest.importorskip("pymavlink")


def test_a_flight_has_the_lens_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(live_flight.subprocess, "Popen", lambda command, **_: started.append(command))
    fisheye = Camera(640, 480, 300.0, 300.0, 320.0, 240.0, (0.1, -0.02, 0.01, 0.0), "fisheye")
    live_flight._Flight(tmp_path, "7scenes:kitchen", "::", fisheye, 30.0, Firmware.PX4, tmp_path).start()
    (command,) = started
    assert parse_intrinsics(command[command.index("--camera") + 1])[0] == fisheye


class Deaf:
    """MAVSDK that waits until the other side has ended."""

    def listen(self, timeout_s: float, has_ended: Callable[[], bool]) -> None:
        assert has_ended()
        raise TimeoutError


def test_refusal_of_fly_is_passed_on(tmp_path: Path) -> None:
    """As in a room that does not show gravity; it ended in a traceback of MAVSDK's, a minute later."""
    (tmp_path / "fly.txt").write_text("note: 52 frames\nmonoloc: down: is missing\n")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    flight = live_flight._Flight(tmp_path, "", "::", SMALL_CAMERA, 30.0, Firmware.PX4, tmp_path, process=ended)
    with pytest.raises(MonolocError, match=r"^monoloc fly ended; monoloc fly said last: monoloc: down: is missing$"):
        live_flight._heard_by(Deaf(), flight)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it reads /proc")
@pytest.mark.parametrize("firmware", [each.value for each in Firmware])
def test_poses_come_again_after_every_loss(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, firmware: str
) -> None:
    write_workspace(tmp_path, RoomRecording(Room(), make_path(40), SMALL_CAMERA))
    monkeypatch.chdir(tmp_path)
    options = ("--seconds", "15", "--rate-hz", "15", "--firmware", firmware)
    figures: dict[str, Any] = json_of(capfd, "bench", "fly", "room.monoloc", "flight", *options)
    assert figures["poses"] > 100 and figures["poses_refused"] == 0
    # An independent reader sees what the decoder sees, but for what came before it listened.
    assert figures["poses_by_mavsdk"] is None or figures["poses_by_mavsdk"] > 0.9 * figures["poses"]
    assert figures["timesync_answered"] > 100
    assert figures["summary"]["reconnections"] == 1
    assert "monoloc: no image in time from the camera" in figures["texts"]
    assert figures["resident_mb_end"] < 1.2 * figures["resident_mb_start"]
    for recording in figures["recordings"]:
        assert recording["frames"] > 20
        assert recording["different_frames"] == 0 and recording["same_messages"]
