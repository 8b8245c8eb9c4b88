"""A sensor's depth is compared with the landmarks' where the camera sees them; another unit is named with its fix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from monoloc.depth.predictor import DepthPrediction
from monoloc.editing.depth_comparison import depth_ratios, scale_problem
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from monoloc.io.registry import open_recording
from synthetic_room import CAMERA, SMALL_CAMERA, Room, RoomRecording, make_path, write_recording

POSE = make_pose(so3_exp(np.array([0.1, 0.4, -0.2])), np.array([1.0, -2.0, 0.5]))
DEPTH_M = 2.0


def ratios(count: int, factor: float) -> list[FloatArray]:
    """Of two frames, with landmarks among them that were confused."""
    every = factor * np.linspace(0.99, 1.01, count)
    every[: count // 8], every[-(count // 8) :] = 0.1 * factor, 10.0 * factor
    return [every[::2], every[1::2]]


def test_ratio_is_of_depth_to_that_of_the_landmark_in_the_camera() -> None:
    pixels = np.array([[20.0, 30.0], [100.0, 60.0], [60.0, 90.0]])
    points = transform(POSE, DEPTH_M * CAMERA.rays(pixels)).astype(np.float32)
    depth = np.full((CAMERA.height, CAMERA.width), 1.25 * DEPTH_M, dtype=np.float32)
    depth[85:95, 55:65] = 0.0  # where the sensor sees nothing
    found = depth_ratios(DepthPrediction(depth, CAMERA), CAMERA, pixels, POSE, points)
    np.testing.assert_allclose(found, [1.25, 1.25], rtol=1e-5)


@pytest.mark.parametrize(("factor", "scale"), [(1.25, "1250"), (0.06, "60"), (4.02, "4000")])
def test_depth_in_another_unit_is_named_with_the_value_of_a_metre(tmp_path: Path, factor: float, scale: str) -> None:
    write_recording(tmp_path / "flight", RoomRecording(Room(), make_path(3), SMALL_CAMERA))
    recording = open_recording(f"folder:{tmp_path / 'flight'}")
    found = scale_problem(recording, ratios(200, factor))
    assert found == (f"its depth is {factor:.3g} times as far as the map's landmarks", f"give --depth-scale {scale}")


def test_a_reader_without_such_a_value_is_not_told_to_give_one() -> None:
    found = scale_problem(RoomRecording(Room(), make_path(3), SMALL_CAMERA), ratios(200, 2.0))
    assert found is not None and found[1] == "correct its depth"


@pytest.mark.parametrize("seen", [ratios(200, 1.04), ratios(200, 0.96), ratios(28, 2.0), []])
def test_a_sensors_error_and_too_few_landmarks_say_nothing(seen: list[FloatArray]) -> None:
    assert scale_problem(RoomRecording(Room(), make_path(3), SMALL_CAMERA), seen) is None
