"""What a user writes for a camera, and which camera it opens."""

from __future__ import annotations

import os
import sys
from contextlib import closing

import cv2
import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.errors import MissingExtraError
from monoloc.live.frame_source import EndOfStreamError
from monoloc.live.opening import is_live, open_live
from refusals import refuses, refuses_setting
from synthetic_recordings import make_color

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)


@pytest.mark.parametrize(
    "source",
    ["camera:0", "camera:12", "picamera", "realsense", "oak", "-", "rtsp://10.0.0.1/x", "https://u:p@h/x.m3u8"],
)
def test_cameras_and_streams(source: str) -> None:
    assert is_live(source)


@pytest.mark.parametrize(
    "source", ["camera", "camera:", "camera:x", "7scenes:redkitchen", "tcp", "rtsp://", "--", "a/-"]
)
def test_recordings_and_nothing(source: str) -> None:
    assert not is_live(source)
    refuses_setting(lambda: open_live(source, CAMERA), "SOURCE", "is no camera", "camera:0, rtsp://.*picamera")


def test_a_minus_is_motion_jpeg_on_standard_input_which_stays_open(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    color = make_color(CAMERA.width, CAMERA.height)
    os.write(writing, cv2.imencode(".jpg", color[..., ::-1])[1].tobytes())
    with os.fdopen(reading) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with closing(open_live("-", CAMERA)) as source:
            frame = source.next(10.0)  # it is there before the writer has ended
            assert frame is not None and np.abs(frame.color.astype(int) - color).mean() < 4.0
            os.close(writing)
            with pytest.raises(EndOfStreamError):
                source.next(10.0)
        os.fstat(reading)


def test_a_minus_without_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    refuses_setting(lambda: open_live("-", CAMERA), "SOURCE", "standard input is closed", "motion JPEG")


def test_a_stream_without_pyav_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    refuses(lambda: open_live("rtsp://127.0.0.1/x", CAMERA), MissingExtraError, r"streams .* extra \"stream\"")
