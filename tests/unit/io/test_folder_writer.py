"""A written folder is read as the recording that it was written from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.io.folder_writer import write_folder
from monoloc.io.recording import scale_sd_of
from monoloc.io.registry import open_recording, select_frames
from refusals import refuses_data
from synthetic_room import Room, RoomRecording, make_path

CAMERA = Camera(64, 48, 50.0, 51.0, 31.0, 23.0, (-0.1, 0.02, 0.001, 0.002, 0.0))


@pytest.fixture
def recording() -> RoomRecording:
    recording = RoomRecording(Room(), make_path(3), CAMERA)
    recording.scale_sd = 0.07  # type: ignore[attr-defined]
    return recording


def test_folder_is_read_as_it_was_written(tmp_path: Path, recording: RoomRecording) -> None:
    depths = [recording.depth(index)[::2, ::2] for index in range(3)]
    depths[1][0, 0], depths[1][0, 1] = 0.0, 70.0  # farther than 16 bits of millimetres
    folder = tmp_path / "walk"
    folder.mkdir()
    write_folder(folder, recording, depths)
    read = open_recording(str(folder))
    assert read.camera == CAMERA
    assert recording.poses is not None and read.poses is not None
    np.testing.assert_allclose(read.poses, recording.poses, atol=1e-7)
    np.testing.assert_allclose(read.timestamps_s, recording.timestamps_s, atol=1e-9)
    for index in range(3):
        np.testing.assert_array_equal(read.color(index), recording.color(index))
    expected = np.where(depths[1] > 65.0, 0.0, depths[1]).repeat(2, axis=0).repeat(2, axis=1)
    np.testing.assert_allclose(read.depth(1), expected, atol=0.0006)
    assert scale_sd_of(select_frames(read, "1:")) == 0.07


def test_folder_that_holds_something_is_left_alone(tmp_path: Path, recording: RoomRecording) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    refuses_data(lambda: write_folder(tmp_path, recording, []), tmp_path, "holds files", "a new folder")
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]
