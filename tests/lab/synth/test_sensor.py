"""Simulated sensors: exposure, noise, and depth of structured light."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc_lab.synth.sensor import (
    DepthSensorConfig,
    SensorConfig,
    metered,
    photograph,
    structured_light,
    white_balance,
)

SENSOR = SensorConfig()
FLAT = SensorConfig(vignetting=0.0, adapted=0.0)
CAMERA = Camera(160, 120, 136.6, 136.6, 79.5, 59.5)
TOWARDS = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (120, 160, 1))
NO_GLASS = np.zeros((120, 160), dtype=bool)


def grey(luminance: float, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    return np.full((*shape, 3), luminance, dtype=np.float32)


@pytest.mark.parametrize("luminance", [2.0, 20.0, 200.0, 2000.0])
def test_exposure_moves_the_mean_to_the_key(luminance: float) -> None:
    image = photograph(grey(luminance), FLAT, np.random.default_rng(0))
    assert np.mean((image / 255.0) ** 2.2) == pytest.approx(FLAT.key, rel=0.05)


def test_exposure_has_limits() -> None:
    dark = photograph(grey(0.01), FLAT, np.random.default_rng(0))
    white = photograph(grey(1e6), FLAT, np.random.default_rng(0))
    assert np.mean(dark) < 20.0 and np.mean(white) > 250.0


def test_gain_follows_time_and_costs_electrons() -> None:
    bright, electrons = SENSOR.scale(100.0)
    assert electrons == SENSOR.full_well  # time suffices
    dim, few = SENSOR.scale(0.5)
    assert dim > bright and few < electrons
    assert SENSOR.scale(1e-6)[1] == pytest.approx(SENSOR.full_well / SENSOR.largest_gain)


@pytest.mark.parametrize("luminance", [0.05, 0.5, 5.0, 50.0])
def test_noise_is_that_of_the_electrons(luminance: float) -> None:
    image = photograph(grey(luminance, (300, 300)), FLAT, np.random.default_rng(0))
    linear = (image / 255.0) ** 2.2
    scale, full = FLAT.scale(luminance)
    electrons = luminance * scale * full
    expected = np.sqrt(electrons + FLAT.read_noise**2) / full
    quantum = 2.2 * linear.mean() ** (1.2 / 2.2) / 255.0 / np.sqrt(12.0)
    assert np.std(linear) == pytest.approx(np.hypot(expected, quantum), rel=0.08)


def test_corners_are_darker() -> None:
    config = SensorConfig(vignetting=0.3, adapted=0.0)
    linear = (photograph(grey(50.0, (120, 160)), config, np.random.default_rng(0)) / 255.0) ** 2.2
    corner = np.mean([linear[:4, :4], linear[-4:, -4:], linear[:4, -4:], linear[-4:, :4]])
    assert corner / linear[56:64, 76:84].mean() == pytest.approx(0.7, abs=0.05)


def test_a_lamp_in_view_does_not_darken_the_room() -> None:
    lit = grey(10.0)
    lit[:8, :8] = 5000.0
    assert metered(lit) < 1.1 * metered(grey(10.0))


def test_white_balance_follows_the_light_to_its_degree() -> None:
    warm = grey(10.0) * np.array([1.4, 1.0, 0.5], np.float32)
    np.testing.assert_allclose(white_balance(warm, 1.0), [1.0 / 1.4, 1.0, 2.0], rtol=1e-4)
    np.testing.assert_allclose(white_balance(warm, 0.0), 1.0)
    image = photograph(warm, SensorConfig(vignetting=0.0, adapted=1.0), np.random.default_rng(0))
    assert np.ptp(image.mean(axis=(0, 1))) < 3.0


def test_overexposed_pixels_are_white_with_any_balance() -> None:
    warm = grey(10.0) * np.array([1.4, 1.0, 0.5], np.float32)
    warm[:5] *= 1000.0
    assert np.all(photograph(warm, SENSOR, np.random.default_rng(0))[:5] >= 252)


def measured(depth: np.ndarray, normals: np.ndarray = TOWARDS, glass: np.ndarray = NO_GLASS, **settings: float):
    config = DepthSensorConfig(**settings)
    return structured_light(depth.astype(np.float32), normals, glass, CAMERA, config, np.random.default_rng(0))


@pytest.mark.parametrize("depth_m", [0.8, 1.5, 3.0, 4.5])
def test_depth_error_grows_with_the_square_of_the_distance(depth_m: float) -> None:
    seen = measured(np.full((120, 160), depth_m))
    assert np.mean(seen > 0.0) > 0.95
    config = DepthSensorConfig()
    step = 1.0 / config.steps_per_px
    disparity_sd = np.hypot(config.disparity_sd_px, step / np.sqrt(12.0))
    focal_baseline = config.focal_px_per_width * 640.0 * config.baseline_m
    expected = depth_m**2 / focal_baseline * disparity_sd
    assert np.std(seen[seen > 0.0]) == pytest.approx(expected, rel=0.25)
    assert len(np.unique(seen)) < 12  # steps of disparity
    assert np.mean(seen[seen > 0.0]) == pytest.approx(depth_m, rel=0.01)


def test_depth_is_missing_out_of_range_on_glass_and_at_grazing_angles() -> None:
    depth = np.full((120, 160), 2.0)
    assert not measured(np.full((120, 160), 0.3)).any()
    assert not measured(np.full((120, 160), 6.0)).any()
    glass = NO_GLASS.copy()
    glass[40:60] = True
    assert not measured(depth, glass=glass)[40:60].any()
    grazing = np.tile(np.array([0.0, -np.cos(0.1), -np.sin(0.1)], np.float32), (120, 160, 1))
    assert np.mean(measured(depth, grazing)[:50] > 0.0) < 0.05


def test_depth_step_has_a_shadow_of_the_projector() -> None:
    depth = np.full((120, 160), 3.0)
    depth[:, 60:100] = 1.0
    seen = measured(depth)
    shadow = CAMERA.fx * DepthSensorConfig().baseline_m * (1.0 / 1.0 - 1.0 / 3.0)
    missing = (seen[10:110] == 0.0).mean(axis=0) > 0.95
    # On one side only, with the width of the difference of disparities.
    assert missing[20:60].sum() + missing[100:140].sum() == pytest.approx(shadow, abs=3.0)
    assert min(missing[20:58].sum(), missing[102:140].sum()) == 0
