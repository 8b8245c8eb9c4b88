"""Image files: what becomes of other kinds of them, and those that are damaged."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.io.registry import open_recording
from refusals import refuses_data
from synthetic_recordings import check_recording


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A described folder with three frames of JPEG colour and PNG depth, 32x24."""
    synthetic.write_folder(tmp_path)
    return tmp_path


@pytest.mark.parametrize("value", [0, 65535])
def test_depth_image_may_be_all_missing(tmp_path: Path, value: int) -> None:
    synthetic.write_folder(tmp_path)
    synthetic.write_depth(tmp_path / "depth/000015.png", np.full((24, 32), value, dtype=np.uint16))
    recording = open_recording(str(tmp_path))
    check_recording(recording, 3)
    assert not recording.depth(1).any() and recording.depth(2).any()


@pytest.mark.parametrize("kind", ["grey", "rgba", "16-bit", "16-bit grey"])
def test_colour_images_of_other_kinds_become_rgb(tmp_path: Path, kind: str) -> None:
    synthetic.write_folder(tmp_path, synthetic.SEQUENCE_TOML.replace(".jpg", ".png"))
    rgb = synthetic.make_color(32, 24)
    grey = rgb[..., 0]
    stored, expected = {
        "grey": (grey, np.repeat(grey[..., None], 3, axis=-1)),
        "rgba": (np.dstack([rgb[..., ::-1], grey]), rgb),
        "16-bit": (rgb[..., ::-1].astype(np.uint16) * 257, rgb),
        "16-bit grey": (grey.astype(np.uint16) * 257, np.repeat(grey[..., None], 3, axis=-1)),
    }[kind]
    for index in (10, 15, 20):
        cv2.imwrite(str(tmp_path / f"color/{index:06d}.png"), stored)
    np.testing.assert_array_equal(open_recording(str(tmp_path)).color(0), expected)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, None])
@pytest.mark.parametrize("kind", ["color", "depth"])
def test_truncated_image_is_refused(
    folder: Path, kind: str, share: float | None, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where only a share of the file is left, or all but its last byte; the decoder itself says nothing."""
    recording = open_recording(str(folder))
    image = folder / kind / ("000015.jpg" if kind == "color" else "000015.png")
    data = image.read_bytes()
    image.write_bytes(data[: -1 if share is None else int(share * len(data))])
    refuses_data(lambda: getattr(recording, kind)(1), image, "is cut short", "copy the file again")
    assert capfd.readouterr().err == ""


def test_image_that_vanished_is_refused(folder: Path) -> None:
    recording, image = open_recording(str(folder)), folder / "depth/000015.png"
    image.write_bytes(b"")
    refuses_data(lambda: recording.depth(1), image, "is empty", "copy the file again")
    image.unlink()
    refuses_data(lambda: recording.depth(1), image, "cannot be read", "restore the file")


def test_file_that_is_no_image_is_refused(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    recording = open_recording(str(folder))
    (folder / "color/000015.jpg").write_text("not an image")
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", "cannot be decoded", "copy or convert")
    assert capfd.readouterr().err == ""


def test_colour_of_another_size_is_refused(folder: Path) -> None:
    synthetic.write_color(folder / "color/000015.jpg", synthetic.make_color(16, 12))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.color(1), folder / "color/000015.jpg", "is 16x12.*for 32x24", "intrinsics")


def test_depth_of_another_size_is_refused(folder: Path) -> None:
    synthetic.write_depth(folder / "depth/000015.png", synthetic.constant_depth(16, 12, 1000))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(1), folder / "depth/000015.png", "is 16x12.*for 32x24", "images of that")


def test_colour_image_is_no_depth(folder: Path) -> None:
    synthetic.write_color(folder / "depth/000015.png", synthetic.make_color(32, 24))
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(1), folder / "depth/000015.png", "is not a depth image", "one channel")


def test_recording_without_depth_refuses_to_give_it(folder: Path) -> None:
    toml = synthetic.SEQUENCE_TOML.replace('depth = "', '# "')
    (folder / "dataset.toml").write_text(toml)
    recording = open_recording(str(folder))
    refuses_data(lambda: recording.depth(0), folder, "has no depth images", "predicted depth")
