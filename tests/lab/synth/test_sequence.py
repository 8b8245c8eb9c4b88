"""Rendered sequences: recordings in several lights, which continue after an interruption."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli_helpers import json_of, refused
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, transform
from monoloc.io.registry import open_recording
from monoloc.io.tum_trajectory import write_tum
from monoloc.progress import NoProgress
from monoloc_lab.synth import sequence as sequences
from monoloc_lab.synth.blur import velocities
from monoloc_lab.synth.light import LIGHTS
from monoloc_lab.synth.render import Picture, Renderer
from monoloc_lab.synth.rooms import Room, read_room, write_room
from monoloc_lab.synth.sequence import RenderConfig, render_sequence
from rendered_room import CAMERA, pose_at, windowed_room

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("mitsuba") is None, reason='rendering needs Mitsuba: pip install "./lab[synth]"'
    ),
]


@pytest.fixture(scope="module")
def room() -> Room:
    return windowed_room()


@pytest.fixture(scope="module")
def poses() -> FloatArray:
    return np.stack([pose_at((1.2 + 0.05 * i, 0.5, 1.3), 80.0, 15.0) for i in range(3)])


def render(
    room: Room,
    poses: FloatArray,
    out: Path,
    lights: tuple[str, ...] = ("L2", "L3"),
    moving: FloatArray | None = None,
    **settings: object,
):
    config = RenderConfig(**{"samples": 4, **settings})
    chosen, times_s = [LIGHTS[name] for name in lights], np.arange(len(poses)) / 15.0
    moving = velocities(poses, times_s) if moving is None else moving
    return render_sequence(room, poses, times_s, moving, CAMERA, chosen, config, 7, out, NoProgress())


@pytest.fixture(scope="module")
def rendered(room, poses, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("rendered") / "flight"
    assert [folder.name for folder in render(room, poses, out)] == ["L2", "L3"]
    return out


@pytest.fixture
def flight(rendered, tmp_path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(rendered, tmp_path / "flight"))


def test_sequence_is_read_by_the_folder_reader(room: Room, poses: FloatArray, rendered: Path) -> None:
    recordings = [open_recording(f"folder:{rendered / light}") for light in ("L2", "L3")]
    for recording in recordings:
        assert len(recording) == 3 and recording.camera == CAMERA and recording.has_depth
        assert recording.poses is not None
        np.testing.assert_allclose(recording.poses, poses, atol=1e-6)
        np.testing.assert_allclose(recording.timestamps_s, np.arange(3) / 15.0, atol=1e-6)
    bright, dark = (recording.color(1).mean() for recording in recordings)
    assert bright > 1.5 * dark
    points = transform(poses[1], CAMERA.back_project(recordings[0].depth(1)).reshape(-1, 3))
    assert np.abs(room.clearance_m(points)).max() < 0.01


def test_images_are_blurred_by_the_velocities_given(room: Room, poses: FloatArray, flight: Path) -> None:
    turning = np.zeros((3, 6))
    turning[1, 4] = 6.0  # rad/s
    sharp = cv2.imread(str(flight / "L3" / "color" / "000001.jpg")), cv2.imread(str(flight / "L3/color/000000.jpg"))
    render(room, poses, flight, ("L3",), moving=turning)
    turned = cv2.imread(str(flight / "L3" / "color" / "000001.jpg")), cv2.imread(str(flight / "L3/color/000000.jpg"))
    steps = [[np.abs(np.diff(image.astype(float), axis=1)).mean() for image in pair] for pair in (sharp, turned)]
    assert steps[1][0] < 0.95 * steps[0][0] and steps[1][1] > 0.95 * steps[0][1]


def test_interrupted_sequence_continues(
    room: Room, poses: FloatArray, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = {
        path: path.read_bytes() for path in flight.rglob("*.*") if path.suffix in (".jpg", ".png", ".txt", ".toml")
    }
    seeds: list[int] = []
    original = Renderer.picture

    def recorded(self: Renderer, camera: Camera, pose: FloatArray, seed: int) -> Picture:
        seeds.append(seed)
        return original(self, camera, pose, seed)

    monkeypatch.setattr(Renderer, "picture", recorded)
    (flight / "linear" / "000001.npz").unlink()
    (flight / "L3" / "color" / "000002.jpg").unlink()
    render(room, poses, flight)
    assert seeds == [7 + 1]
    assert len(whole) == 2 * 3 + 3 + 1 + 2
    for path, content in whole.items():
        if path.suffix != ".jpg":
            assert path.read_bytes() == content, path
            continue
        before, after = (cv2.imdecode(np.frombuffer(data, np.uint8), 1) for data in (content, path.read_bytes()))
        assert np.abs(before.astype(int) - after.astype(int)).max() <= 2


def test_another_light_needs_no_rendering(
    room: Room, poses: FloatArray, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequences, "Renderer", None)
    assert [folder.name for folder in render(room, poses, flight, ("L1",))] == ["L1"]
    assert len(open_recording(f"folder:{flight / 'L1'}")) == 3
    assert (flight / "L2" / "dataset.toml").is_file()


def test_sensor_depth_has_holes_and_steps(
    room: Room, poses: FloatArray, flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = open_recording(f"folder:{flight / 'L2'}").depth(0)
    render(room, poses, flight, ("L2",), depth="sensor")
    measured = open_recording(f"folder:{flight / 'L2'}").depth(0)
    seen = measured > 0.0
    assert 0.5 < np.mean(seen) < 0.98
    assert 0.0 < np.median(np.abs(measured[seen] - exact[seen])) < 0.03


def test_folder_of_another_rendering_is_refused(room: Room, poses: FloatArray, flight: Path) -> None:
    with pytest.raises(DataError, match="has a rendering with other settings; name another folder"):
        render(room.move("cube", (0.1, 0.0, 0.0)), poses, flight)
    assert read_room(flight / "room.json") == room


def test_render_command_writes_recordings(
    room: Room, poses: FloatArray, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    write_room(tmp_path / "room.json", room)
    write_tum(tmp_path / "flight.txt", np.arange(3) / 30.0, poses)
    given = ["--room", str(tmp_path / "room.json"), "--poses", str(tmp_path / "flight.txt"), "--samples", "1"]
    options = ["--width", "64", "--every", "2", "--light", "L1", "--light", "L3"]
    described = json_of(capfd, "synth", "render", *given, *options, "--out", str(tmp_path / "out"))
    assert described == {"recordings": [str(tmp_path / "out" / light) for light in ("L1", "L3")], "frames": 2}
    for folder in described["recordings"]:
        recording = open_recording(f"folder:{folder}")
        assert (recording.camera.width, recording.camera.height) == (64, 48)
        np.testing.assert_allclose(recording.timestamps_s, [0.0, 2.0 / 30.0], atol=1e-6)
    assert read_room(tmp_path / "out" / "room.json") == room
    out = str(tmp_path / "out")
    again = ("synth", "render", *given, "--width", "64", "--every", "2", "--light", "L1", "--seed", "5")
    refused(
        capfd, tmp_path, (*again, "--out", out), out, "has a rendering with other settings", "name another folder"
    )
