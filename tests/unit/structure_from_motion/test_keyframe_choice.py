"""Keyframes are apart, sharp, and never far from each other in time."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from monoloc.geometry import make_pose
from monoloc.structure_from_motion.keyframe_choice import choose_keyframes
from synthetic_room import SMALL_CAMERA, Room, RoomRecording


def sideways(step_m: float, count: int) -> RoomRecording:
    positions = np.outer(np.arange(count) - count / 2, [step_m, 0.0, 0.0])
    return RoomRecording(Room(), make_pose(np.tile(np.eye(3), (count, 1, 1)), positions), SMALL_CAMERA)


def test_faster_motion_gives_more_keyframes() -> None:
    counts = [len(choose_keyframes(sideways(step_m, 16))) for step_m in (0.01, 0.03, 0.3)]
    assert counts[0] < counts[1] < counts[2] == 16


def test_camera_at_rest_has_a_keyframe_a_second() -> None:
    assert choose_keyframes(sideways(0.0, 46)).tolist() == [0, 15, 30, 45]


def test_blurred_neighbours_are_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = sideways(0.04, 24)
    sharp = recording.color
    monkeypatch.setattr(
        recording, "color", lambda i: sharp(i) if i % 2 == 0 else cv2.GaussianBlur(sharp(i), (0, 0), 2)
    )
    assert np.all(choose_keyframes(recording) % 2 == 0)


def test_required_and_dark_frames() -> None:
    recording = sideways(0.03, 16)
    chosen = set(choose_keyframes(recording).tolist())
    required = min(set(range(16)) - chosen)
    assert set(choose_keyframes(recording, [required]).tolist()) == chosen | {required}
    recording.color = lambda index: np.zeros((128, 160, 3), dtype=np.uint8)  # type: ignore[method-assign]
    assert choose_keyframes(recording).tolist() == [0, 15]
