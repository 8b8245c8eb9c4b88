"""COLMAP's models, text and binary, with one camera or one for each image, and what may be wrong with them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from capture_writers import Capture, ColmapCamera, check_opened, pinhole_of, write_colmap
from monoloc.camera import Camera
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Remark
from monoloc.io.registry import open_recording
from refusals import refuses_data, refuses_to_open
from synthetic_recordings import check_recording

NOTES = [
    "the files state no times; frames are taken to be 0.2 s apart",
    "the model's unit is taken to be one metre; if it is not, scale the model with colmap model_aligner",
]


@pytest.mark.parametrize("binary", [False, True])
def test_model_opens(tmp_path: Path, capture: Capture, binary: bool) -> None:
    write_colmap(tmp_path / "room", capture, binary, [pinhole_of(capture.camera)])
    for place in ("", "sparse", "sparse/0"):
        recording = open_recording(str(tmp_path / "room" / place))
        check_recording(recording, len(capture))
        check_opened(recording, capture, None)
        assert recording.camera == capture.camera and recording.notes == NOTES
        assert all(isinstance(note, Remark) for note in recording.notes)  # no warnings: all of its recordings are so
        assert recording.frame_names == [f"left/frame {index}.jpg" for index in range(12)]
        np.testing.assert_allclose(recording.timestamps_s, np.arange(12) / 5.0)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize(
    ("model", "parameters", "expected"),
    [
        ("SIMPLE_PINHOLE", (136.0, 76.0, 66.5), Camera(160, 128, 136.0, 136.0, 75.5, 66.0)),
        ("SIMPLE_RADIAL", (136.0, 76.0, 66.5, 0.1), Camera(160, 128, 136.0, 136.0, 75.5, 66.0, (0.1, 0, 0, 0))),
        ("RADIAL", (136.0, 76.0, 66.5, 0.1, 0.01), Camera(160, 128, 136.0, 136.0, 75.5, 66.0, (0.1, 0.01, 0, 0))),
        (
            "OPENCV",
            (136.0, 138.0, 76.0, 66.5, 0.1, 0.01, 0.002, 0.003),
            Camera(160, 128, 136.0, 138.0, 75.5, 66.0, (0.1, 0.01, 0.002, 0.003)),
        ),
        (
            "OPENCV_FISHEYE",
            (136.0, 138.0, 76.0, 66.5, 0.1, 0.01, 0.002, 0.003),
            Camera(160, 128, 136.0, 138.0, 75.5, 66.0, (0.1, 0.01, 0.002, 0.003), "fisheye"),
        ),
        (
            "FULL_OPENCV",
            (136.0, 138.0, 76.0, 66.5, 0.1, 0.01, 0.002, 0.003, 0.01, 0.02, 0.01, 0.005),
            Camera(
                160, 128, 136.0, 138.0, 75.5, 66.0, (0.1, 0.01, 0.002, 0.003, 0.01, 0.02, 0.01, 0.005), "rational"
            ),
        ),
    ],
)
def test_camera_models(
    tmp_path: Path, capture: Capture, binary: bool, model: str, parameters: tuple[float, ...], expected: Camera
) -> None:
    write_colmap(tmp_path, capture, binary, [ColmapCamera(model, 160, 128, parameters)])
    assert open_recording(str(tmp_path)).camera == expected


@pytest.mark.parametrize("binary", [False, True])
def test_unsupported_camera_model_is_refused_by_name(tmp_path: Path, capture: Capture, binary: bool) -> None:
    write_colmap(tmp_path, capture, binary, [ColmapCamera("FOV", 160, 128, (136.0, 138.0, 76.0, 66.5, 0.9))])
    file = tmp_path / f"sparse/0/cameras.{'bin' if binary else 'txt'}"
    refuses_to_open(tmp_path, file, "camera model FOV is not supported", "colmap image_undistorter")


def test_images_with_cameras_of_their_own_are_rendered_as_one(tmp_path: Path, capture: Capture) -> None:
    """As COLMAP estimates by default. The median focal length stands for all; another lens is left out."""
    cameras = [
        ColmapCamera("SIMPLE_RADIAL", 160, 128, (136.0 * factor, 76.0, 66.5, k1))
        for factor, k1 in [(1.0, 0.0), (0.98, 0.05), (1.02, -0.05), (1.3, 0.0)]
    ]
    write_colmap(tmp_path, capture, False, cameras)
    recording = open_recording(str(tmp_path))
    assert recording.camera == Camera(160, 128, 136.0, 136.0, 75.5, 66.0) and len(recording) == 9
    assert recording.notes[0] == "3 of 12 frames are left out: 3 of another image size or lens"
    own = Camera(160, 128, 136.0 * 1.02, 136.0 * 1.02, 75.5, 66.0, (-0.05, 0.0, 0.0, 0.0))
    v, u = np.mgrid[10:118:9, 10:150:7]
    x, y = np.moveaxis(own.project(recording.camera.rays(np.stack([u, v], axis=-1))), -1, 0)
    stored = capture.colors[2][np.rint(y).astype(int), np.rint(x).astype(int)].astype(float)
    assert recording.frame_names[2] == "left/frame 2.jpg"
    assert np.abs(recording.color(2)[v, u] - stored).mean() < 5.0
    given = ReaderOptions(camera=Camera(160, 128, 150.0, 150.0, 80.0, 64.0))
    assert len(open_recording(str(tmp_path), given)) == 12


def test_largest_part_of_a_model_is_read(tmp_path: Path, capture: Capture) -> None:
    write_colmap(tmp_path, capture, False, [pinhole_of(capture.camera)])
    part = tmp_path / "sparse/1"
    shutil.copytree(tmp_path / "sparse/0", part)
    lines = (tmp_path / "sparse/0/images.txt").read_text().splitlines()
    (tmp_path / "sparse/0/images.txt").write_text("\n".join(lines[:6]))
    recording = open_recording(str(tmp_path))
    assert len(recording) == 12
    assert recording.notes == ["the model has 2 parts; the largest, 1, is used", *NOTES]
    assert open_recording(str(part)).notes == NOTES


def test_images_without_a_file_are_counted(tmp_path: Path, capture: Capture) -> None:
    write_colmap(tmp_path, capture, True, [pinhole_of(capture.camera)])
    (tmp_path / "images/left/frame 3.jpg").unlink()
    assert open_recording(str(tmp_path)).notes[0] == "1 of 12 frames are left out: 1 without an image file"
    (tmp_path / "images").rename(tmp_path / "pictures")
    fix = f"put the images into {tmp_path / 'images'}"
    problem = "none of its 12 frames can be used: 12 without an image file"
    refuses_to_open(tmp_path, tmp_path / "sparse/0/images.bin", problem, fix)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.97])
def test_truncated_binary_is_refused(tmp_path: Path, capture: Capture, name: str, share: float) -> None:
    write_colmap(tmp_path, capture, True, [pinhole_of(capture.camera)])
    path = tmp_path / "sparse/0" / name
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    refuses_to_open(tmp_path, path, "is cut short", "colmap model_converter")


@pytest.mark.parametrize(
    ("name", "text", "problem", "fix"),
    [
        ("cameras.txt", "1 PINHOLE 160\n", "'1 PINHOLE 160' is not a camera", "model_converter"),
        ("cameras.txt", "1 PINHOLE 160 128 5 5 5\n", "a PINHOLE has 3 parameters instead of 4", "model_converter"),
        ("cameras.txt", "1 PINHOLE 160 128 -5 5 5 5\n", "camera.fx/fy: is", "positive"),
        ("cameras.txt", "2 PINHOLE 160 128 136 138 76 66.5\n", None, ""),
        ("images.txt", "100 1 0 0 0 0 0 0 one a.jpg\n\n", "is not an image", "model_converter"),
        ("images.txt", "100 1 0 0 0\n\n", "is not an image", "model_converter"),
        ("images.txt", "100 2 0 0 0 0 0 0 1 left/frame 1.jpg\n\n", "pose 1 is not rigid", "unit quaternions"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n2 1 0 0 0 0 0 0 1 b.jpg\n", "has '2 1 0.* points", "may be empty"),
        ("images.txt", "# none\n", "holds no images", "registered images"),
    ],
)
def test_malformed_text_is_refused(
    tmp_path: Path, capture: Capture, name: str, text: str, problem: str | None, fix: str
) -> None:
    write_colmap(tmp_path, capture, False, [pinhole_of(capture.camera)])
    (tmp_path / "sparse/0" / name).write_text(text)
    if problem is None:
        problem, name = "is of camera 1, which cameras.txt lacks", "images.txt"
    refuses_to_open(tmp_path, tmp_path / "sparse/0" / name, problem, fix)


def test_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    refuses_data(lambda: open_recording(f"colmap:{tmp_path}"), tmp_path, "has no COLMAP model", "sparse/0")
