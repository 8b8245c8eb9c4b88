"""Spreads, unseen frames and plotted frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from monoloc.errors import DataError
from monoloc_lab.experiments.gather import (
    Spread,
    and_list,
    frames_of,
    nearest_build_m,
    shown_frames,
    unseen_frames,
)
from monoloc_lab.experiments.study import EvalRecording, Split
from monoloc_lab.rooms import BUILD
from synthetic_room import SMALL_CAMERA, Room, RoomRecording, make_path, write_recording


def test_spread() -> None:
    spread = Spread((0.3, 0.1, 0.2))
    assert spread.median == 0.2 and spread.range == (0.1, 0.3)
    assert spread.centimetres() == "20.0 cm (10.0 to 30.0)"
    assert Spread((0.1,)).centimetres() == "10.0 cm"
    assert Spread(()).centimetres() == "none" and np.isnan(Spread(()).median)
    assert (spread / Spread((0.1, 0.1, 0.1))).range == pytest.approx((1.0, 3.0))
    assert and_list(["a", "b", "c"]) == "a, b and c" and and_list(["a"]) == "a"


def test_build_frames_are_not_unseen() -> None:
    source = f"folder:{BUILD}"
    split = Split("interpolation", source, "::3", {})
    recording = EvalRecording(source, "1::2", None)  # 1, 3, 5, ...: every third is a build frame
    assert unseen_frames(split, recording).tolist()[:6] == [True, False, True, True, False, True]
    poses = frames_of(source, "::").poses
    assert poses is not None
    step_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert 0.0 < nearest_build_m(split, recording) <= np.max(step_m)
    assert all(index % 5 == 0 for index in shown_frames(recording))


def test_plotted_frames_have_depth(tmp_path: Path) -> None:
    write_recording(tmp_path / "room", RoomRecording(Room(), make_path(50), SMALL_CAMERA))
    recording = EvalRecording(f"folder:{tmp_path / 'room'}", "::", None)
    assert shown_frames(recording) == (15, 35)
    empty = np.zeros((SMALL_CAMERA.height, SMALL_CAMERA.width), dtype=np.uint16)
    empty[0, 1] = 1000  # readers refuse frames without any depth
    for index in (15, 10):
        cv2.imwrite(str(tmp_path / "room" / "depth" / f"{index:06d}.png"), empty)
    shown_frames.cache_clear()
    assert shown_frames(recording) == (20, 35)
    for index in range(50):
        cv2.imwrite(str(tmp_path / "room" / "depth" / f"{index:06d}.png"), empty)
    shown_frames.cache_clear()
    with pytest.raises(DataError, match="has no depth in the frames to be shown"):
        shown_frames(recording)
