"""Motion blur against geometry."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc.geometry import se3_exp
from monoloc_lab.synth.blur import motion_blurred, velocities

CAMERA = Camera(160, 120, 136.6, 136.6, 79.5, 59.5)


def line_at(column: int) -> np.ndarray:
    """A bright vertical line on black."""
    light = np.zeros((120, 160, 3), dtype=np.float32)
    light[:, column] = 100.0
    return light


def flat(depth_m: float) -> np.ndarray:
    return np.full((120, 160), depth_m, dtype=np.float32)


def width_px(image: np.ndarray) -> float:
    """Width of a box with the standard deviation of the middle row."""
    row = image[60, :, 0].astype(np.float64)
    at = np.arange(160)
    middle = np.sum(row * at) / row.sum()
    return float(np.sqrt(12.0 * np.sum(row * (at - middle) ** 2) / row.sum()))


def test_stationary_camera_or_short_exposure_does_not_blur() -> None:
    light = line_at(80)
    assert motion_blurred(light, flat(2.0), CAMERA, np.zeros(6), 0.02) is light
    turning = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    assert motion_blurred(light, flat(2.0), CAMERA, turning, 1e-4) is light


@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_rotation_blurs_all_depths_equally(speed: float) -> None:
    velocity = np.array([0.0, 0.0, 0.0, 0.0, speed, 0.0])
    for depth in (1.0, 4.0):
        image = motion_blurred(line_at(80), flat(depth), CAMERA, velocity, 0.03)
        assert width_px(image) == pytest.approx(speed * 0.03 * CAMERA.fx, rel=0.15)
        assert image.sum() == pytest.approx(line_at(80).sum(), rel=0.02)  # the light is conserved


def test_translation_blurs_near_surfaces_more() -> None:
    velocity = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    for depth in (0.8, 1.6):
        image = motion_blurred(line_at(80), flat(depth), CAMERA, velocity, 0.03)
        assert width_px(image) == pytest.approx(CAMERA.fx * 1.5 * 0.03 / depth, rel=0.15)


def test_blur_is_centred_on_the_pose() -> None:
    image = motion_blurred(line_at(80), flat(2.0), CAMERA, np.array([0.0, 0.0, 0.0, 0.3, 1.0, 0.0]), 0.03)
    row = image[60, :, 0]
    assert np.sum(row * np.arange(160)) / row.sum() == pytest.approx(80.0, abs=0.1)


def test_pixels_without_surface_only_rotate() -> None:
    velocity = np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    light = line_at(80)
    assert motion_blurred(light, flat(0.0), CAMERA, velocity, 0.02) is light


def test_velocities_are_those_of_the_trajectory() -> None:
    twist = np.array([0.4, -0.1, 0.2, 0.05, 0.3, -0.2])
    times = np.array([0.0, 0.1, 0.2, 0.35])
    poses = se3_exp([1.0, 2.0, 3.0, 0.4, 0.5, 0.6]) @ se3_exp(times[:, None] * twist)
    assert np.allclose(velocities(poses, times), twist)
    assert np.allclose(velocities(poses[:1], times[:1]), 0.0)
