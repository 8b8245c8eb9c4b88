"""NYU Depth v2's labelled .mat file, and what may be wrong with it."""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.errors import MissingExtraError
from monoloc.io import nyu
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording


def write_nyu_mat(path: Path) -> None:
    with h5py.File(path, "w") as file:
        images = np.stack([synthetic.make_color(640, 480, n).transpose(2, 1, 0) for n in range(2)])
        file["images"] = images
        depths = np.full((2, 640, 480), 3.0, dtype=np.float32)
        depths[0, :, :200] = 1.5  # MATLAB's order: the upper rows of the image
        file["depths"] = depths


def test_frames_are_cropped_and_transposed(tmp_path: Path) -> None:
    write_nyu_mat(tmp_path / "tiny.mat")
    recording = open_recording(str(tmp_path / "tiny.mat"))
    check_recording(recording, 2)
    assert recording.poses is None
    left, top, width, height = nyu.VALID_WINDOW
    expected = synthetic.make_color(640, 480, 1)[top : top + height, left : left + width]
    np.testing.assert_array_equal(recording.color(1), expected)
    assert (recording.depth(0)[: 200 - top] == 1.5).all()
    assert (recording.depth(0)[200 - top :] == 3.0).all()
    assert recording.camera.cx == pytest.approx(325.58 - left)


def test_frame_of_nan_has_no_depth(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    write_nyu_mat(path)
    with h5py.File(path, "a") as file:
        file["depths"][0] = np.nan
    recording = open_recording(str(path))
    assert not recording.depth(0).any() and recording.depth(1).all()


def test_file_that_is_not_hdf5_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    path.write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    refuses_to_open(path, path, "is cut short or not an HDF5 .mat file", "copy the file again")


def test_file_without_images_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file["labels"] = np.zeros(3)
    refuses_to_open(path, path, "has no images and depths", "nyu_depth_v2_labeled.mat")


def test_group_in_place_of_images_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file.create_group("images")
    refuses_to_open(path, path, "has no images and depths", "nyu_depth_v2_labeled.mat")


@pytest.mark.parametrize("is_link", [True, False])
def test_images_in_another_file_are_refused(tmp_path: Path, is_link: bool) -> None:
    """HDF5 would read them from there."""
    path, elsewhere = tmp_path / "nyu.mat", tmp_path / "elsewhere.mat"
    write_nyu_mat(elsewhere)
    write_nyu_mat(path)
    with h5py.File(path, "a") as file:
        del file["images"]
        if is_link:
            file["images"] = h5py.ExternalLink(elsewhere, "images")
        else:
            size = 2 * 3 * 640 * 480
            file.create_dataset("images", (2, 3, 640, 480), np.uint8, external=[(elsewhere, 0, size)])
    refuses_to_open(path, path, "has no images and depths", "nyu_depth_v2_labeled.mat")


def test_images_that_go_missing_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    write_nyu_mat(path)
    recording = open_recording(str(path))
    with h5py.File(path, "a") as file:
        del file["images"]
    refuses_data(lambda: recording.color(0), path, "frame 0 cannot be read", "copy the file again")


def test_images_of_another_size_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file["images"] = np.zeros((1, 3, 32, 24), dtype=np.uint8)
        file["depths"] = np.zeros((1, 32, 24), dtype=np.float32)
    refuses_to_open(path, path, r"holds images \(1, 3, 32, 24\)", "expected N images of 640x480")


def test_damaged_data_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "nyu.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("images", data=np.zeros((1, 3, 640, 480), np.uint8), compression="gzip")
        depths = file.create_dataset("depths", data=np.ones((1, 640, 480), np.float32), compression="gzip")
        chunk = depths.id.get_chunk_info(0)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset : chunk.byte_offset + chunk.size] = bytes(chunk.size)
    path.write_bytes(data)
    recording = open_recording(str(path))
    refuses_data(lambda: recording.depth(0), path, "frame 0 cannot be read", "copy the file again")


def test_missing_h5py_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "nyu.mat"
    path.write_bytes(b"")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r'pip install "monoloc\[train\]"'):
        open_recording(str(path))
