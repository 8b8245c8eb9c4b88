"""Camera files: what is written is read to the bit, and what is no camera is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.io.camera_file import read_camera, write_camera
from refusals import refuses

CAMERAS = [
    Camera(640, 480, 525.1234567, 524.0, 319.5, 239.5, (-0.08, 0.02, 1e-17, 0.1 * 3e-3, 0.0)),
    Camera(640, 480, 250.0, 251.0, 322.0, 238.0, (0.51, 0.1, 0.001, -0.001, 0.01, 0.8, 0.2, 0.03), "rational"),
    Camera(600, 460, 275.5, 276.5, 299.5, 229.5, (-0.006, 0.042, -0.04, 0.007), "fisheye"),
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.distortion_model)
def test_camera_is_read_as_it_was_written(tmp_path: Path, camera: Camera) -> None:
    path = tmp_path / "cam.toml"
    write_camera(path, camera, {"rms_px": 0.2, "views": 20, "board": "ChArUco 8x6, square 30 mm"})
    assert read_camera(path) == camera
    assert 'board = "ChArUco 8x6, square 30 mm"' in path.read_text()


def test_numbers_of_numpy_and_any_text_are_read_back(tmp_path: Path) -> None:
    camera = Camera(np.int64(640), np.int64(480), *np.array([300.0, 310.0, 320.0, 240.0]))
    assert repr(camera) == repr(Camera(640, 480, 300.0, 310.0, 320.0, 240.0))
    write_camera(tmp_path / "cam.toml", camera, {"recording": 'walk 5" \\ \U0001f600\x7f', "views": 3})
    assert read_camera(tmp_path / "cam.toml") == camera


def test_pinhole_needs_six_numbers(tmp_path: Path) -> None:
    path = tmp_path / "cam.toml"
    path.write_text("width = 640\nheight = 480\nfx = 525\nfy = 525.0\ncx = 319.5\ncy = 239.5\n")
    assert read_camera(path) == Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (("fx = 525.0", ""), "fx: is missing; correct the field named"),
        (("fx = 525.0", "fx = true"), "fx: is true or false, not a number; correct the field named"),
        (("distortion = []", "distortion = [0.1, false, 0, 0]"), "distortion.1: is true or false, not a number"),
        (("fx = 525.0", "fx = nan"), "fx: "),
        (("fx = 525.0", "fx = -1.0"), "focal lengths are positive"),
        (("fx = 525.0", 'fx = "far"'), "fx: "),
        (("fx = 525.0", "fx = = 1"), "is not valid TOML"),
        (("cx = 319.5", "cx = 9999.0"), "lies outside the 640x480 image"),
        (("distortion = []", "distortion = [1.0, 2.0]"), "distortion is .*give k1, k2, p1, p2, k3"),
        (("distortion = []", 'distortion_model = "swirl"'), "distortion_model: "),
        (("distortion = []", "zoom = 2"), "zoom: is unknown, known are width, height, .*; correct the field"),
    ],
)
def test_file_of_no_camera_is_refused(tmp_path: Path, change: tuple[str, str], match: str) -> None:
    path = tmp_path / "cam.toml"
    text = "width = 640\nheight = 480\nfx = 525.0\nfy = 525.0\ncx = 319.5\ncy = 239.5\ndistortion = []\n"
    path.write_text(text.replace(*change))
    refuses(lambda: read_camera(path), DataError, match)


def test_missing_file_is_named(tmp_path: Path) -> None:
    refuses(lambda: read_camera(tmp_path / "none.toml"), DataError, "none.toml.*monoloc calibrate")
