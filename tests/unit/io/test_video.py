"""Video files: frames in any order, their times, and what cannot be decoded."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import synthetic_recordings as synthetic
from capture_writers import tag_rotation, write_video_of
from monoloc.camera import Camera
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.registry import open_recording
from monoloc.io.video_frames import VideoFrames
from refusals import refuses_data, refuses_setting, refuses_to_open
from synthetic_recordings import VIDEO_OPTIONS, check_recording


def test_video_is_read_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO_OPTIONS)
    check_recording(recording, 6)
    assert open_recording(f"video:{path}", VIDEO_OPTIONS).camera == recording.camera == VIDEO_OPTIONS.camera
    assert recording.poses is None
    assert not recording.has_depth
    np.testing.assert_allclose(recording.timestamps_s, np.arange(6) / 10.0)
    for index in (0, 1, 4, 2, 5, 5, 0):
        assert abs(recording.color(index).mean() - 20 * (index + 1)) < 3


def test_frames_have_the_times_of_the_container(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    synthetic.write_uneven_video(path, [1, 1, 4, 2, 2, 2])
    recording = open_recording(str(path), VIDEO_OPTIONS)
    check_recording(recording, 6)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.05, 0.1, 0.3, 0.4, 0.5])


def test_rotation_tag_is_obeyed(tmp_path: Path) -> None:
    """Intrinsics are those of the turned frames; those of the stored ones are refused."""
    path = tmp_path / "flight.mp4"
    left_is_bright = np.zeros((48, 64, 3), dtype=np.uint8)
    left_is_bright[:, :32] = 200
    write_video_of(path, [left_is_bright] * 3)
    tag_rotation(path, 1)  # clockwise: left becomes top
    turned = ReaderOptions(camera=Camera(48, 64, 50.0, 50.0, 23.0, 31.0))
    image = open_recording(str(path), turned).color(1)
    assert image.shape == (64, 48, 3) and image[:30].mean() > 150.0 and image[34:].mean() < 50.0
    problem = "is for 64x48, but .* is 48x64, turned by the (90|270) degrees of its rotation tag"
    refuses_setting(lambda: open_recording(str(path), VIDEO_OPTIONS), "camera", problem, "this video's images")


def test_only_frames_that_can_be_decoded_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    synthetic.overstate_frames(path, 9)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) == 9
    check_recording(open_recording(str(path), VIDEO_OPTIONS), 6)


def test_a_name_with_a_colon_is_no_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synthetic.write_video(tmp_path / "walk.avi")
    (tmp_path / "walk.avi").rename(tmp_path / "http:10.30.avi")
    monkeypatch.chdir(tmp_path)
    assert VideoFrames(Path("http:10.30.avi")).size == (64, 48)


def test_missing_intrinsics_are_named(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    problem = "without poses, without depth, and does not state its intrinsics"
    known = "--camera FILE.toml of monoloc calibrate, or --camera 64,48,FX,FY,CX,CY"
    refuses_to_open(path, path, problem, f"{known}; .* monoloc reconstruct .*flight.avi --out flight --camera-out ")


def test_file_that_is_no_video_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "flight.mp4"
    path.write_bytes(b"not a video")
    refuses_to_open(path, path, "cannot be decoded as a video", "convert it to .mp4")
    assert capfd.readouterr().err == ""
    path.write_bytes(b"")
    refuses_to_open(path, path, "is empty", "copy it again, or record it again")


OpenCVCapture = cv2.VideoCapture


class UntimedCapture:
    """A cv2.VideoCapture of a stream without times, or with these, and a frame rate. (Subclasses of it crash.)"""

    rate_hz = 0.0
    stamps_ms = (0.0,) * 6

    def __init__(self, path: str) -> None:
        self._capture = OpenCVCapture(path)

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_POS_MSEC:
            return self.stamps_ms[int(self._capture.get(cv2.CAP_PROP_POS_FRAMES)) - 1]
        return self.rate_hz if key == cv2.CAP_PROP_FPS else self._capture.get(key)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._capture, name)


def test_video_without_times_needs_a_frame_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    monkeypatch.setattr(cv2, "VideoCapture", UntimedCapture)
    refuses_data(
        lambda: open_recording(str(path), VIDEO_OPTIONS),
        path,
        "states neither times .* nor a frame rate",
        "convert it",
    )
    monkeypatch.setattr(UntimedCapture, "rate_hz", 4.0)
    recording = open_recording(str(path), VIDEO_OPTIONS)
    np.testing.assert_allclose(recording.timestamps_s, np.arange(6) / 4.0)
    assert recording.notes == [
        "time stamps of the video do not increase at 5 of 6 frames; all are taken to be at its mean rate, 4 Hz"
    ]


def test_video_of_a_code_that_is_not_decoded_is_to_be_converted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as AV1, which phones write as .mp4, too."""
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    monkeypatch.setattr(cv2, "VideoCapture", UntimedCapture)
    monkeypatch.setattr(UntimedCapture, "grab", lambda _: False, raising=False)
    problem, fix = "has no frame that can be decoded", r"convert it to H\.264 \(\.mp4\)"
    refuses_data(lambda: open_recording(str(path), VIDEO_OPTIONS), path, problem, fix)


def test_one_doubled_time_stamp_of_a_file_is_interpolated(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    synthetic.write_uneven_video(path, [1, 3, 0, 4, 2, 2])
    recording = open_recording(str(path), VIDEO_OPTIONS)
    np.testing.assert_allclose(recording.timestamps_s, [0.0, 0.05, 0.2, 0.3, 0.4, 0.5])
    assert recording.notes == ["time stamps of the video do not increase at 1 of 6 frames; they are interpolated"]


@pytest.mark.parametrize(
    ("stamps_ms", "expected_s"),
    [
        ((0, 100, 300, 300, 500, 900), (0.0, 0.1, 0.3, 0.4, 0.5, 0.9)),  # doubled: the second is wrong
        ((0, 100, 9e6, 300, 400, 900), (0.0, 0.1, 0.2, 0.3, 0.4, 0.9)),  # one that is far ahead
        ((0, 100, 200, 300, 0, 500), (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)),  # one that is far behind
        ((0, 100, 200, 400, 400, 400), None),
        ((200, 300, 400, 500, 600, 600), (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)),  # the last: at the mean rate
        ((9e6, 100, 200, 300, 400, 600), (-0.025, 0.1, 0.2, 0.3, 0.4, 0.6)),  # the first
    ],
)
def test_few_wrong_time_stamps_leave_the_others(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    stamps_ms: tuple[float, ...],
    expected_s: tuple[float, ...] | None,
) -> None:
    """Where more than a quarter are wrong, none is used."""
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    monkeypatch.setattr(cv2, "VideoCapture", UntimedCapture)
    monkeypatch.setattr(UntimedCapture, "stamps_ms", stamps_ms)
    monkeypatch.setattr(UntimedCapture, "rate_hz", 4.0)
    recording = open_recording(str(path), VIDEO_OPTIONS)
    np.testing.assert_allclose(recording.timestamps_s, np.arange(6) / 4.0 if expected_s is None else expected_s)
    assert ("interpolated" if expected_s else "mean rate, 4 Hz") in recording.notes[0]


def test_video_without_frames_is_empty(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path, frames=0)
    refuses_data(
        lambda: open_recording(str(path), VIDEO_OPTIONS), path, "is empty: it has no frame", "record it again"
    )


def test_video_cut_short_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO_OPTIONS)
    synthetic.write_video(path, frames=4)
    recording.color(3)
    recording.color(0)  # from the beginning, of what is there now
    refuses_data(lambda: recording.color(5), path, "cannot be decoded after frame 3", "0:4")


def test_video_that_was_cut_when_it_was_copied_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path, frames=12)
    assert open_recording(str(path), VIDEO_OPTIONS).notes == []
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    recording = open_recording(str(path), VIDEO_OPTIONS)
    assert 1 <= len(recording) < 11
    (note,) = recording.notes
    assert note.startswith(f"only {len(recording)} of the 12 frames")


def test_video_of_a_varying_rate_that_is_whole_is_not_noted_as_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """OpenCV makes up Matroska's number of frames: 0.6 s of at most 30 Hz are 18."""
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    synthetic.overstate_frames(path, 18)
    monkeypatch.setattr(cv2, "VideoCapture", UntimedCapture)
    monkeypatch.setattr(UntimedCapture, "rate_hz", 30.0)
    monkeypatch.setattr(UntimedCapture, "stamps_ms", (0, 33, 100, 133, 400, 580))
    assert open_recording(str(path), VIDEO_OPTIONS).notes == []
    monkeypatch.setattr(UntimedCapture, "stamps_ms", (0, 33, 67, 100, 133, 167))
    (note,) = open_recording(str(path), VIDEO_OPTIONS).notes
    assert note.startswith("only 6 of the 18 frames")


def test_name_that_opencv_cannot_take_is_refused(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9.avi")
    path.write_bytes(b"")
    refuses_data(
        lambda: open_recording(str(path), VIDEO_OPTIONS), path, "has a name that is not UTF-8", "rename the file"
    )


def test_camera_of_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    options = ReaderOptions(camera=Camera(640, 480, 500.0, 500.0, 320.0, 240.0))
    refuses_setting(
        lambda: open_recording(str(path), options), "camera", "for 640x480, but .* is 64x48", "intrinsics"
    )


def test_video_has_no_depth(tmp_path: Path) -> None:
    path = tmp_path / "flight.avi"
    synthetic.write_video(path)
    recording = open_recording(str(path), VIDEO_OPTIONS)
    refuses_data(lambda: recording.depth(0), path, "is a video and has no depth", "use predicted depth")
