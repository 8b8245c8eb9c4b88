"""Recordings of a user's own are checked where they are used."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from monoloc.builder.build_config import BuildConfig
from monoloc.builder.start_network import checked_network
from monoloc.io.recording import check_arrays
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path

_COLOR = np.zeros((SMALL_CAMERA.height, SMALL_CAMERA.width, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("frame_names", ["0"], "frame_names must be 6, one a frame, got 1"),
        ("frame_names", list(range(6)), "frame_names must be strings, got int"),
        ("timestamps_s", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "timestamps_s must be an array, got list"),
        ("poses", list(make_path(6)), "poses must be an array, got list"),
        ("color", lambda index: _COLOR / 255.0, r"color must .* \(128, 160, 3\) as uint8, RGB, got .* float64"),
        ("color", lambda index: _COLOR[..., 0], r"color must .* got \(128, 160\) uint8"),
        (
            "depth",
            lambda index: np.ones((30, 40), np.float32),
            r"depth must .* got \(30, 40\) float32",
        ),
        (
            "depth",
            lambda index: np.full(_COLOR.shape[:2], 1500, np.uint16),
            "depth must .* metres, got .* uint16",
        ),
        ("timestamps_s", np.arange(7.0), r"timestamps_s must have shape \(6,\), got \(7,\)"),
        ("timestamps_s", np.arange(6.0)[::-1], "timestamps_s must be finite, and none before the previous one"),
        ("timestamps_s", np.full(6, np.nan), "timestamps_s must be finite"),
        ("poses", make_path(7), r"poses must have shape \(6, 4, 4\), got \(7, 4, 4\)"),
        ("poses", 2.0 * make_path(6), "poses must be rigid, T_world_camera"),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(name: str, value: Any, problem: str) -> None:
    recording = RoomRecording(Room(), make_path(6), SMALL_CAMERA)
    check_arrays(recording)
    setattr(recording, name, value)
    with pytest.raises(ValueError, match=problem):
        check_arrays(recording)
    with pytest.raises(ValueError, match=problem):
        checked_network(recording, BuildConfig(), "full-0.35")
