"""Known cameras are recovered from rendered views of the board, and views that say too little are refused."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from board_images import board_image, board_poses
from cli_helpers import json_of, outputs, succeeds
from monoloc.calibration.board import Board
from monoloc.calibration.board_source import BoardViews, read_views
from monoloc.calibration.board_views import BoardDetector, BoardView, diverse_views
from monoloc.calibration.intrinsics_solver import Calibration, calibrate_camera
from monoloc.calibration.sufficiency import assess, require_views
from monoloc.camera import Camera
from monoloc.cli.main import invoke
from monoloc.errors import DataError, SettingError
from monoloc.io.camera_file import read_camera
from monoloc.progress import NoProgress

CAMERAS = {
    "brown": Camera(640, 480, 520.0, 518.0, 318.0, 243.0, (-0.25, 0.09, 0.001, -0.0007, -0.01)),
    "rational": Camera(
        640, 480, 360.0, 361.0, 321.0, 238.0, (0.51, 0.1, 1e-3, -1e-3, 0.01, 0.8, 0.2, 0.03), "rational"
    ),
    "fisheye": Camera(640, 480, 305.0, 306.0, 318.0, 242.0, (-0.006, 0.042, -0.04, 0.007), "fisheye"),
}
SIZE = (640, 480)
BOARD = Board()


@cache
def images_of(name: str, count: int = 16, tilt_deg: float = 35.0) -> list[NDArray[np.uint8]]:
    camera, rng = CAMERAS[name], np.random.default_rng(0)
    return [board_image(camera, BOARD, pose, rng) for pose in board_poses(camera, BOARD, count, rng, tilt_deg)]


@cache
def views_of(name: str, count: int = 16, tilt_deg: float = 35.0) -> list[BoardView]:
    detect = BoardDetector(BOARD)
    views = (detect(str(index), image) for index, image in enumerate(images_of(name, count, tilt_deg)))
    return [view for view in views if view is not None]


@cache
def calibration_of(name: str) -> Calibration:
    return calibrate_camera(views_of(name), BOARD, SIZE, CAMERAS[name].distortion_model)


def test_files_that_macos_adds_on_other_disks_are_no_pictures(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), images_of("brown")[0])
    (tmp_path / "._1.png").write_bytes(b"\0\5\26\7\0\2\0\0Mac OS X")
    assert read_views(str(tmp_path), BOARD, NoProgress()).images == 1


@pytest.mark.parametrize("name", CAMERAS)
def test_known_camera_is_recovered_within_its_stated_error(name: str) -> None:
    camera, calibration = CAMERAS[name], calibration_of(name)
    found = calibration.camera
    for index, key in enumerate(("fx", "fy", "cx", "cy")):
        assert abs(getattr(found, key) - getattr(camera, key)) < 3.0 * calibration.sd[index], key
    assert np.all(calibration.sd[:4] < 0.8)
    if name != "rational":  # whose coefficients trade among each other
        error = np.abs(np.subtract(found.distortion, camera.distortion))
        assert np.all(error < 3.0 * calibration.sd[4:])
    # Rays are right where the board was.
    pixels = np.stack(np.meshgrid(np.linspace(40, 600, 9), np.linspace(40, 440, 7)), axis=-1).reshape(-1, 2)
    assert np.linalg.norm(found.project(camera.rays(pixels)) - pixels, axis=1).max() < 1.0
    assert calibration.rms_px < 0.1 and calibration.held_out_rms_px < 0.1
    assert assess("views", calibration) == []


@pytest.mark.parametrize("name", ["brown", "fisheye"])
def test_coefficients_that_the_views_do_not_determine_are_left_out(name: str) -> None:
    """Views of the middle alone: higher coefficients would fold the rest of the image."""
    views = [view for view in views_of(name) if np.abs(view.outline.mean(axis=0) - [320, 240]).max() < 200]
    calibration = calibrate_camera(views, BOARD, SIZE, CAMERAS[name].distortion_model)
    assert calibration.camera.fx == pytest.approx(CAMERAS[name].fx, rel=0.01)
    np.testing.assert_array_equal(calibration.sd[4:] == 0.0, np.array(calibration.camera.distortion) == 0.0)


def test_fit_is_that_of_opencv() -> None:
    calibration = calibration_of("brown")
    points = [BOARD.corners[view.ids].astype(np.float32) for view in calibration.views]
    pixels = [view.pixels.astype(np.float32)[:, None] for view in calibration.views]
    library: Any = cv2
    rms, K, distortion, *_ = library.calibrateCamera(points, pixels, SIZE, None, None)
    found = calibration.camera
    assert calibration.rms_px == pytest.approx(rms, rel=1e-3)
    np.testing.assert_allclose(found.matrix, K, atol=0.01)
    np.testing.assert_allclose(found.distortion, distortion.ravel(), atol=1e-3)


def test_a_model_that_does_not_fit_is_said() -> None:
    bent = calibrate_camera(views_of("fisheye"), BOARD, SIZE, "brown")
    with pytest.raises(DataError, match=r"open to \d %.*come closer; another --model may fit better"):
        assess("views", bent)
    known = replace(bent, sd=np.full(9, 0.1))
    assert any(
        re.match(r"corners are off by 0\.\d+ pixels; another --model", text) for text in assess("views", known)
    )


def test_square_size_changes_distances_and_not_the_camera() -> None:
    assert BOARD.square_mm == 30.0
    one, half = calibration_of("brown"), calibrate_camera(views_of("brown"), Board(15.0), SIZE, "brown")
    np.testing.assert_allclose(half.camera.matrix, one.camera.matrix, atol=1e-3)
    np.testing.assert_allclose(half.distances_m, 0.5 * one.distances_m, rtol=1e-4)


# --- Views that say too little ---


def test_flat_views_are_refused() -> None:
    """A board that is parallel to the image leaves focal length and distance open."""
    views = views_of("brown", 12, 0.0)
    with pytest.raises(DataError, match=r"leaves the focal length open to \d+ %: .* flat .*; tilt the board by"):
        assess("views", calibrate_camera(views, BOARD, SIZE, "brown"))


def test_views_at_two_zooms_are_said_to_disagree() -> None:
    """Each view fits, as the board seems nearer or farther."""
    zoomed = replace(CAMERAS["brown"], fx=1.07 * CAMERAS["brown"].fx, fy=1.07 * CAMERAS["brown"].fy)
    rng, detect = np.random.default_rng(1), BoardDetector(BOARD)
    images = [board_image(zoomed, BOARD, pose, rng) for pose in board_poses(zoomed, BOARD, 10, rng, 35.0)]
    views = [*views_of("brown"), *(view for image in images if (view := detect("zoomed", image)) is not None)]
    (warning,) = assess("views", calibrate_camera(views, BOARD, SIZE, "brown"))
    assert re.match(r"views agree on the focal length only to 0\.\d %; fix focus and zoom, ", warning)


def test_views_in_one_corner_are_refused() -> None:
    """The image is twice as large as what the board was shown in."""
    calibration = calibrate_camera(views_of("brown"), BOARD, (1280, 960), "brown")
    with pytest.raises(
        DataError, match=r"in only \d+% of the image; bring the board into all corners, first to the "
    ):
        assess("views", calibration)


def test_views_that_no_camera_explains_are_refused() -> None:
    """As where the board was bent, or the focus moved."""
    rng = np.random.default_rng(0)
    bent = [
        BoardView(
            view.name, view.ids, view.pixels + rng.normal(scale=2.0, size=(len(view.ids), 2)), view.outline, 1.0
        )
        for view in views_of("brown")
    ]
    with pytest.raises(DataError, match=r"fits the calibration only to \d\.\d pixels; keep the board flat"):
        assess("views", calibrate_camera(bent, BOARD, SIZE, "brown"))


def test_lens_that_sees_too_much_is_refused_with_how_much_to_crop() -> None:
    wide = Camera(640, 480, 305.0, 305.0, 319.5, 239.5, distortion_model="fisheye")
    rng = np.random.default_rng(0)
    detect = BoardDetector(BOARD)
    images = [board_image(wide, BOARD, pose, rng) for pose in board_poses(wide, BOARD, 8, rng)]
    views = [view for index, image in enumerate(images) if (view := detect(str(index), image)) is not None]
    with pytest.raises(SettingError, match=r"more than 85 degrees .*; crop the images to within 4\d\d pixels"):
        calibrate_camera(views, BOARD, (760, 600), "fisheye")


def test_too_few_views_and_another_board_are_refused() -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_50)
    other = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.0225, dictionary).generateImage((640, 480), marginSize=20)
    assert BoardDetector(BOARD)("other", np.asarray(other)) is None
    larger = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    other = cv2.aruco.CharucoBoard((10, 7), 0.03, 0.0225, larger).generateImage((640, 480), marginSize=20)
    assert BoardDetector(BOARD)("other", np.asarray(other)) is None
    with pytest.raises(DataError, match=r"pictures: shows the board in 3 of 40 images, and 10 are needed; print the"):
        require_views("pictures", BoardViews(views_of("brown")[:3], SIZE, 40))
    with pytest.raises(DataError, match=r"shows the board in 3 of 4 images, and 10 are needed; take more pictures"):
        require_views("pictures", BoardViews(views_of("brown")[:3], SIZE, 4))


def test_views_that_remain_without_outliers_are_counted() -> None:
    rng = np.random.default_rng(0)
    views = views_of("brown")[:11]
    views[:2] = [
        replace(view, pixels=view.pixels + rng.normal(scale=6.0, size=view.pixels.shape)) for view in views[:2]
    ]
    with pytest.raises(
        DataError, match=r"leaves 9 views that one camera explains, and 10 are needed; keep the board"
    ):
        assess("views", calibrate_camera(views, BOARD, SIZE, "brown"))


# --- Sources ---


def test_sharp_and_diverse_frames_of_a_video_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, SIZE)
    for image in images_of("brown")[4:6]:
        for width in (7, 7, 1, 7, 7, 7):  # moving, then still
            writer.write(cv2.cvtColor(cv2.blur(image, (width, 1)), cv2.COLOR_GRAY2BGR))
    writer.release()
    found = read_views(str(path), BOARD, NoProgress())
    assert found.size == SIZE and found.images == 12
    names = [view.name.rpartition(" ")[2] for view in found.views]
    assert names and all(int(name) % 6 == 2 for name in names)


def test_views_are_spread_over_what_there_is() -> None:
    views = views_of("brown")
    repeated = [*views[:1] * 40, *views]
    chosen = diverse_views(repeated, len(views))
    assert len(chosen) == len(views)
    assert len({view.name for view in chosen}) >= len(views) - 1


class Device:
    """What ``cv2.VideoCapture`` returns for a camera that shows the board."""

    def __init__(self, index: int) -> None:
        self.shown = iter(images_of("brown")[:8])

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        return True

    def get(self, key: int) -> float:
        return 0.0

    def grab(self) -> bool:
        self.image = next(self.shown, None)
        return self.image is not None

    def retrieve(self) -> tuple[bool, NDArray[np.uint8]]:
        assert self.image is not None
        return True, np.asarray(cv2.cvtColor(self.image, cv2.COLOR_GRAY2BGR), np.uint8)

    def release(self) -> None:
        pass


def test_a_camera_is_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", Device)
    with pytest.raises(DataError, match=r"camera:0: gives no more images; check its cable"):
        read_views("camera:0", BOARD, NoProgress(), seconds=60.0)
    times_s = iter(range(100))
    monkeypatch.setattr(time, "monotonic", lambda: float(next(times_s)))
    found = read_views("camera:0", BOARD, NoProgress(), seconds=11.0)
    assert found.size == SIZE and 0 < len(found.views) <= found.images <= 11


# --- Commands ---


def test_camera_command_writes_the_camera_that_other_commands_read(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("pictures").mkdir()
    for index, image in enumerate(images_of("brown")):
        cv2.imwrite(f"pictures/{index:02d}.png", image)
    figures = json_of(capfd, "calibrate", "camera", "pictures", "--out", "cam.toml", "--plot", "coverage.png")
    assert figures["views"] >= 14 and figures["coverage"] > 0.7
    written = read_camera(Path("cam.toml"))
    assert written.fx == figures["camera"]["fx"] == pytest.approx(520.0, abs=3.0 * figures["sd"]["fx"])
    assert Path("coverage.png").stat().st_size > 10_000
    text = Path("cam.toml").read_text()
    assert 'board = "ChArUco 8x6 DICT_4X4_50, square 30 mm"' in text and "sd_fx = " in text
    out, err = outputs(capfd, "calibrate", "camera", "pictures", "--out", "cam.toml", "--square-mm", "15")
    assert "fx" in out and "m away; RMS" in err

    cv2.imwrite("pictures/99.png", np.zeros((100, 100), np.uint8))
    assert invoke(["calibrate", "camera", "pictures", "--out", "x.toml"]) == 2
    assert "99.png: is 100x100, and others are 640x480" in capfd.readouterr().err
    Path("pictures/00.png").write_bytes(b"no image")
    assert invoke(["calibrate", "camera", "pictures", "--out", "x.toml"]) == 2
    assert "00.png: cannot be decoded as an image; " in capfd.readouterr().err
    assert not Path("x.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nowhere"], "nowhere: does not exist; give a folder of pictures, a video, or camera:0"),
        (["rtsp://u:secret@camera/1"], "monoloc: SOURCE: is a camera that calibrate does not watch; record a video"),
        (["."], ".: holds no images; give a folder of pictures"),
        (["camera:0", "--size", "640"], "--size: is '640'; write width and height"),
        ([".", "--square-mm", "0"], "--square-mm: is 0.0; measure the side"),
    ],
)
def test_camera_command_refuses(
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    problem: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert invoke(["calibrate", "camera", *arguments, "--out", "x.toml"]) == 2
    assert problem in capfd.readouterr().err
    assert not Path("x.toml").exists()


def test_board_command_refuses_what_the_paper_does_not_hold(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "board.pdf"
    assert invoke(["calibrate", "board", "--out", str(out), "--square-mm", "60"]) == 2
    assert "makes the board 480 x 360 mm, too large for a4; give at most 31 mm" in capfd.readouterr().err
    assert not out.exists()
    succeeds(capfd, "calibrate", "board", "--out", str(out), "--square-mm", "31")
