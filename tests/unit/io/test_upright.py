"""Images of a phone that was held in portrait are turned upright, where the format tells gravity."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from altered_recordings import Altered
from capture_writers import (
    Y_UP,
    Z_UP,
    Capture,
    FloatArray,
    doubled,
    halved,
    in_world,
    on_its_side,
    write_polycam,
    write_rtabmap,
    write_stray_scanner,
)
from monoloc.camera import Camera
from monoloc.io.corrected import DEPTH_FIXES, Fixes, corrected
from monoloc.io.folder_writer import write_folder
from monoloc.io.recording import Selection, recorded_down
from monoloc.io.registry import open_recording
from monoloc.io.upright import upright, walk_lies_on_side
from monoloc.recording_check.explanations import depth_scale_option
from refusals import refuses_to_open
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

TURNS = {
    1: "sideways: its images are turned by 90° counter-clockwise",
    2: "upside down: its images are turned by 180°",
    3: "sideways: its images are turned by 90° clockwise",
}


@pytest.mark.parametrize("quarter_turns", TURNS)
@pytest.mark.parametrize(("write", "up"), [(write_polycam, Y_UP), (write_stray_scanner, Y_UP), (write_rtabmap, Z_UP)])
def test_images_on_their_side_are_turned(
    write: Callable[[Path, Capture], None], up: FloatArray, capture: Capture, tmp_path: Path, quarter_turns: int
) -> None:
    room = in_world(capture, up)
    write(tmp_path / "walk", on_its_side(room, quarter_turns))
    recording = open_recording(str(tmp_path / "walk"))
    assert recording.notes == [f"the camera was held {TURNS[quarter_turns]}"]
    assert (recording.camera.width, recording.camera.height) == (room.camera.width, room.camera.height)
    np.testing.assert_allclose(recording.camera.matrix, room.camera.matrix, atol=1e-9)
    np.testing.assert_allclose(recording.poses, room.poses, atol=1e-6)
    np.testing.assert_allclose(recorded_down(recording), np.linalg.inv(up)[:3, :3].T @ [0.0, 1.0, 0.0])
    for index in (0, 11):
        assert np.abs(recording.color(index).astype(float) - room.colors[index]).mean() < 4.0
        stored_mm = doubled(halved(np.rot90(room.depths_mm[index], -quarter_turns)))
        depth_m, expected_m = recording.depth(index), np.rot90(stored_mm, quarter_turns) / 1000.0
        assert (depth_m > 0.0).mean() > 0.9  # the rest is of low confidence
        np.testing.assert_allclose(depth_m[depth_m > 0.0], expected_m[depth_m > 0.0], atol=1e-6)


class Stored(RoomRecording):
    """Of a camera that is turned counter-clockwise by quarter turns, frame by frame; the world's y points down."""

    def __init__(self, poses: FloatArray, quarter_turns: list[int], tells_down: bool = True) -> None:
        turns = np.tile(np.eye(4), (len(poses), 1, 1))
        turns[:, :3, :3] = Rotation.from_euler(
            "z", [[-90 * each] for each in quarter_turns], degrees=True
        ).as_matrix()
        super().__init__(Room(), poses @ turns, Camera(64, 48, 54.0, 55.0, 30.0, 25.0))
        self.notes: list[str] = []
        self.down_world = np.array([0.0, 1.0, 0.0]) if tells_down else None


PATH = make_path(4, rate_hz=5.0)
LOOKS_DOWN = PATH @ np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    "recording",
    [
        Stored(PATH, [0] * 4),
        Stored(PATH, [1] * 4, tells_down=False),
        Stored(PATH, [1, 1, 0, 0]),
        Stored(LOOKS_DOWN, [1] * 4),
    ],
    ids=["upright", "gravity unknown", "turned on the way", "looks down"],
)
def test_other_images_are_left_as_they_are(recording: Stored) -> None:
    assert upright(recording) is recording


def test_one_frame_held_otherwise_does_not_count() -> None:
    assert upright(Stored(PATH, [3, 3, 0, 3])).notes == [f"the camera was held {TURNS[3]}"]


def test_poses_of_another_convention_do_not_tell_gravity() -> None:
    recording = Stored(PATH, [1] * 4)
    fixed = corrected(upright(recording), Fixes(poses="opengl"))
    assert fixed.camera == recording.camera and recorded_down(fixed) is None
    np.testing.assert_array_equal(fixed.color(2), recording.color(2))


def test_depth_is_fixed_as_it_is_stored() -> None:
    """A Kinect's depth camera stands as its colour camera does, not as the images that were turned."""
    recording = Stored(PATH, [1] * 4)
    for name in DEPTH_FIXES:
        if name != "registered":  # only of 7-Scenes
            stored, turned = (corrected(each, Fixes(depth=name)) for each in (recording, upright(recording)))
            np.testing.assert_array_equal(turned.depth(2), np.rot90(stored.depth(2)))
            assert turned.notes == [f"the camera was held {TURNS[1]}"]
    both = [corrected(each, Fixes(poses="opengl", depth="range")) for each in (recording, upright(recording))]
    np.testing.assert_array_equal(both[1].poses, both[0].poses)
    np.testing.assert_array_equal(both[1].depth(2), both[0].depth(2))


def test_depth_of_a_wrong_scale_has_its_option(capture: Capture, tmp_path: Path) -> None:
    for name, write in (("polycam", write_polycam), ("stray", write_stray_scanner)):
        write(tmp_path / name, on_its_side(in_world(capture, Y_UP), 1))
        recording = open_recording(str(tmp_path / name))
        assert depth_scale_option(Selection(recording, range(3)), 10.0) == "--depth-scale 10000"


def test_folder_keeps_gravity(tmp_path: Path) -> None:
    """What is written was turned, and is not turned again."""
    turned = upright(Stored(PATH, [1] * 4))
    write_folder(tmp_path / "walk", turned, [turned.depth(index) for index in range(4)])
    again = open_recording(str(tmp_path / "walk"))
    assert again.notes == [] and again.camera == turned.camera
    np.testing.assert_array_equal(recorded_down(again), recorded_down(turned))
    described = tmp_path / "walk/dataset.toml"
    content = described.read_text()
    described.write_text(content.replace("[0.0, 1.0, 0.0]", "[0, -2, 0]"))
    assert open_recording(str(tmp_path / "walk")).notes == [f"the camera was held {TURNS[2]}"]
    for value in ("[0, 0, 0]", "[0, 1]", '"down"', "[0, 1, inf]"):
        described.write_text(content.replace("[0.0, 1.0, 0.0]", value))
        refuses_to_open(tmp_path / "walk", described, "down is .*, not a direction", r"write down = \[0, 0, -1\]")


@pytest.mark.parametrize("yaw_deg", [60.0, 160.0, 360.0])
@pytest.mark.parametrize("roll_deg", [0.0, 90.0, 180.0, 270.0])
def test_walk_tells_images_on_their_side_where_the_camera_turned_far(yaw_deg: float, roll_deg: float) -> None:
    """Level on average, nodding by 20 degrees, in a world that is tilted as that of a first camera is."""
    yaws = np.linspace(0.0, yaw_deg, 40)
    angles = np.stack([yaws, 20.0 * np.sin(0.2 * yaws), np.full(40, roll_deg)], axis=1)
    poses = np.tile(np.eye(4), (40, 1, 1))
    tilt = Rotation.from_euler("XZ", [-30.0, 40.0], degrees=True)
    poses[:, :3, :3] = (tilt * Rotation.from_euler("YXZ", angles, degrees=True)).as_matrix()
    recording = Altered(RoomRecording(Room(), PATH, SMALL_CAMERA), poses=poses)
    assert walk_lies_on_side(recording) == (roll_deg in (90.0, 270.0) and yaw_deg > 150.0)
