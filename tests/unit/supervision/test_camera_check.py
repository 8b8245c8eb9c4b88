"""Landmarks' focal length against the build's."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.landmarks.pnp import LandmarkPose
from monoloc.supervision.camera_check import WELL_OBSERVED_SD, CameraCheck

FRAME_S = 0.1


def by_landmarks(log_focal: float, sd: float = 0.01, count: int = 30) -> LandmarkPose:
    return LandmarkPose(np.eye(4), 1e-6 * np.eye(6), np.zeros((count, 3)), log_focal, sd)


def after(check: CameraCheck, pose: LandmarkPose | None, frames: int) -> bool:
    for _ in range(frames):
        check.update(pose, FRAME_S)
    return check.mismatch


@pytest.mark.parametrize(
    ("log_focal", "is_another"), [(0.01, False), (0.045, False), (-0.025, False), (0.06, True), (-0.04, True)]
)
def test_camera_is_another_where_focal_length_differs_from_the_builds(log_focal: float, is_another: bool) -> None:
    """By more than 4 %, where the build's own frames differ by less than a third of that."""
    assert after(CameraCheck(0.01, 0.005), by_landmarks(log_focal), 20) == is_another
    assert not after(CameraCheck(0.01, 0.05), by_landmarks(log_focal), 20)


def test_nothing_is_said_before_half_a_second_of_measurements() -> None:
    check = CameraCheck(0.0, 0.01)
    assert not check.mismatch
    assert not after(check, by_landmarks(0.3), 4)
    assert not after(check, None, 50)  # frames without landmarks do not count
    assert after(check, by_landmarks(0.3), 2)


def test_flat_views_say_nothing() -> None:
    check = CameraCheck(0.0, 0.01)
    assert not after(check, by_landmarks(0.3, WELL_OBSERVED_SD * 1.01), 100)
    assert not after(check, by_landmarks(0.3, np.inf), 100)
    assert after(check, by_landmarks(0.3, WELL_OBSERVED_SD), 100)


def test_many_landmarks_of_one_surface_do_not_make_a_flat_view_tell_more() -> None:
    """Their common error does not average out: it takes half the deviation of 30."""
    check = CameraCheck(0.0, 0.01)
    assert not after(check, by_landmarks(0.3, WELL_OBSERVED_SD / 1.98, 300), 100)
    assert after(check, by_landmarks(0.3, WELL_OBSERVED_SD / 2.02, 300), 100)


def test_what_was_measured_is_forgotten_within_seconds() -> None:
    """Single wrong frames do not make another camera, and a second of them is outvoted by ten of right ones."""
    check = CameraCheck(0.0, 0.01)
    assert not after(check, by_landmarks(0.0), 30)
    assert not after(check, by_landmarks(0.3), 2)
    assert after(check, by_landmarks(0.3), 10)
    assert not after(check, by_landmarks(0.0), 100)


def test_better_observed_frames_count_more() -> None:
    check = CameraCheck(0.0, 0.01)
    for _ in range(30):
        check.update(by_landmarks(0.0, 0.002), FRAME_S)
        check.update(by_landmarks(0.2, 0.02), FRAME_S)
    assert not check.mismatch
