"""What a user may say in place of a recording's files: intrinsics, distortion and depth scale."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import synthetic_recordings as synthetic
from monoloc.camera import Camera
from monoloc.io import seven_scenes
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_setting

DISTORTED, UNDISTORTED = (0.02, -0.01, 0.001, 0.0, 0.0), (0.0,) * 5


@pytest.mark.parametrize(
    ("format_name", "own"),
    [
        ("7scenes", seven_scenes.COLOR_CAMERA.distortion),
        ("tum", (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
        ("rgbd-scenes-v2", UNDISTORTED),
        ("folder", (0.1, -0.2, 0.0, 0.001, 0.0)),
    ],
)
def test_given_intrinsics_replace_distortion_only_where_they_name_it(
    tmp_path: Path, format_name: str, own: tuple[float, ...]
) -> None:
    folder = tmp_path / "freiburg1_desk"
    write = {
        "7scenes": synthetic.write_seven_scenes,
        "tum": synthetic.write_tum,
        "rgbd-scenes-v2": synthetic.write_rgbd_scenes_v2,
        "folder": synthetic.write_folder,
    }
    folder.mkdir()
    write[format_name](folder)
    width, height = (32, 24) if format_name == "folder" else (640, 480)
    given = Camera(width, height, 0.9 * width, 0.9 * width, (width - 1) / 2, (height - 1) / 2)
    for distortion, keeps_distortion, expected in (
        (UNDISTORTED, True, own),
        (DISTORTED, False, DISTORTED),
        (UNDISTORTED, False, UNDISTORTED),
    ):
        options = ReaderOptions(replace(given, distortion=distortion), keeps_distortion)
        assert open_recording(f"{format_name}:{folder}", options).camera == replace(given, distortion=expected)


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf, 1e-300, 1e300])
def test_impossible_depth_scale_is_refused(scale: float) -> None:
    problem = re.escape(f"is {scale!r}, not from 1e-06 to 1e+09")
    refuses_setting(lambda: ReaderOptions(depth_scale=scale), "depth_scale", problem, "such as 1000")


def test_option_that_a_format_does_not_take_is_refused(tmp_path: Path) -> None:
    for name in ("nyu", "video"):
        refuses_setting(
            lambda name=name: open_recording(f"{name}:{tmp_path}", ReaderOptions(depth_scale=1000.0)),
            "depth_scale",
            f"no meaning for a {name} recording",
            "leave this option out",
        )


def test_given_intrinsics_that_do_not_fit_the_images_are_refused(tmp_path: Path) -> None:
    synthetic.write_folder(tmp_path)
    options = ReaderOptions(camera=Camera(64, 48, 50.0, 50.0, 32.0, 24.0))
    refuses_data(
        lambda: open_recording(str(tmp_path), options),
        tmp_path / "color/000010.jpg",
        "is 32x24, but the intrinsics are for 64x48",
        "give the intrinsics of these images",
    )
