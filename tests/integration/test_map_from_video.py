"""A plain video becomes a recording, a camera file and a bundle."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from cli_helpers import QUICK, json_of
from monoloc.io.camera_file import read_camera
from monoloc.structure_from_motion import reconstruction
from monoloc.structure_from_motion.levelling import levelled
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path


@pytest.fixture(autouse=True)
def _walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A working folder with a video, whose camera nobody states."""
    monkeypatch.chdir(tmp_path)
    recording = RoomRecording(Room(), make_path(14, rate_hz=3.0), SMALL_CAMERA)
    writer = cv2.VideoWriter("walk.avi", cv2.VideoWriter.fourcc(*"FFV1"), 3.0, (160, 128))
    for index in range(len(recording)):
        writer.write(cv2.cvtColor(recording.color(index), cv2.COLOR_RGB2BGR))
    writer.release()


def test_video_is_reconstructed_checked_and_built_from(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The small room's surfaces leave the vertical open.
    monkeypatch.setattr(reconstruction, "levelled", lambda *given: (levelled(*given)[0], True))
    outputs = ("--out", "walk", "--camera-out", "cam.toml", "--plot", "walk.png")
    found = json_of(capfd, "reconstruct", "walk.avi", *outputs)
    assert found["frames"] >= 9 and found["scale_by"].startswith("predicted depth of ")
    camera = read_camera(Path("cam.toml"))
    assert abs(camera.fx - SMALL_CAMERA.fx) < 2.0 * found["camera_sd"]["f"]
    assert cv2.imread("walk.png") is not None
    read = json_of(capfd, "inspect", "walk")
    assert read["has_poses"] and read["has_depth"] and read["frames"] == found["frames"]
    built = json_of(capfd, "build", "walk", "--no-landmarks", "--out", "room.monoloc", *QUICK)
    assert built["scale_sd"] == found["scale_sd"] >= 0.3
    bundle = json_of(capfd, "inspect", "room.monoloc")
    assert bundle["scale_sd"] == found["scale_sd"]
    assert bundle["down_by"] == "the recording" and bundle["down"] == [0.0, 0.0, -1.0]


@pytest.mark.slow
def test_build_takes_a_video(capfd: pytest.CaptureFixture[str]) -> None:
    camera = "160,128,136,136,79.5,63.5"
    built = json_of(capfd, "build", "walk.avi", "--camera", camera, "--out", "room.monoloc", *QUICK)
    assert built["scale_sd"] >= 0.3
    read = json_of(capfd, "inspect", "room.monoloc")
    assert read["intrinsics"] == [136.0, 136.0, 79.5, 63.5] and read["recording"] == "walk"
