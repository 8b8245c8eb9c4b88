"""Light and sensors: exposure within its limits, noise as stated, depth as a structured-light sensor has it."""

from __future__ import annotations

import numpy as np
import pytest

from monoloc.camera import Camera
from monoloc_lab.synth.denoise import Guide, denoised
from monoloc_lab.synth.light import LIGHTS, Light, levels, relit
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


def grey(luminance: float, shape: tuple[int, int] = (60, 80)) -> np.ndarray:
    return np.full((*shape, 3), luminance, dtype=np.float32)


# --- exposure ---


@pytest.mark.parametrize("luminance", [2.0, 20.0, 200.0, 2000.0])
def test_exposure_brings_the_mean_to_the_key(luminance):
    image = photograph(grey(luminance), FLAT, np.random.default_rng(0))
    assert np.mean((image / 255.0) ** 2.2) == pytest.approx(FLAT.key, rel=0.05)


def test_too_little_light_gives_a_dark_image_too_much_a_white_one():
    dark = photograph(grey(0.01), FLAT, np.random.default_rng(0))
    white = photograph(grey(1e6), FLAT, np.random.default_rng(0))
    assert np.mean(dark) < 20.0 and np.mean(white) > 250.0


def test_gain_comes_after_time_and_costs_electrons():
    bright, electrons = SENSOR.scale(100.0)
    assert electrons == SENSOR.full_well  # time alone is enough
    dim, few = SENSOR.scale(0.5)
    assert dim > bright and few < electrons
    assert SENSOR.scale(1e-6)[1] == pytest.approx(SENSOR.full_well / SENSOR.largest_gain)


@pytest.mark.parametrize("luminance", [0.05, 0.5, 5.0, 50.0])
def test_noise_is_that_of_the_electrons(luminance):
    image = photograph(grey(luminance, (300, 300)), FLAT, np.random.default_rng(0))
    linear = (image / 255.0) ** 2.2
    scale, full = FLAT.scale(luminance)
    electrons = luminance * scale * full
    expected = np.sqrt(electrons + FLAT.read_noise**2) / full
    quantum = 2.2 * linear.mean() ** (1.2 / 2.2) / 255.0 / np.sqrt(12.0)
    assert np.std(linear) == pytest.approx(np.hypot(expected, quantum), rel=0.08)


def test_corners_are_darker():
    config = SensorConfig(vignetting=0.3, adapted=0.0)
    linear = (photograph(grey(50.0, (120, 160)), config, np.random.default_rng(0)) / 255.0) ** 2.2
    corner = np.mean([linear[:4, :4], linear[-4:, -4:], linear[:4, -4:], linear[-4:, :4]])
    assert corner / linear[56:64, 76:84].mean() == pytest.approx(0.7, abs=0.05)


def test_a_lamp_in_view_does_not_darken_the_room():
    lit = grey(10.0)
    lit[:8, :8] = 5000.0
    assert metered(lit) < 1.1 * metered(grey(10.0))


def test_white_balance_follows_the_light_as_far_as_told():
    warm = grey(10.0) * np.array([1.4, 1.0, 0.5], np.float32)
    np.testing.assert_allclose(white_balance(warm, 1.0), [1.0 / 1.4, 1.0, 2.0], rtol=1e-4)
    np.testing.assert_allclose(white_balance(warm, 0.0), 1.0)
    image = photograph(warm, SensorConfig(vignetting=0.0, adapted=1.0), np.random.default_rng(0))
    assert np.ptp(image.mean(axis=(0, 1))) < 3.0


def test_what_is_overexposed_is_white_whatever_the_balance():
    warm = grey(10.0) * np.array([1.4, 1.0, 0.5], np.float32)
    warm[:5] *= 1000.0
    assert np.all(photograph(warm, SENSOR, np.random.default_rng(0))[:5] >= 252)


# --- the three lights ---


def test_the_three_lights_as_stated():
    reached = {name: levels(light, SENSOR) for name, light in LIGHTS.items()}
    assert LIGHTS["L1"].lux >= 1000.0 > 300.0 > LIGHTS["L2"].lux > 50.0 > 2.0 > LIGHTS["L3"].lux
    assert reached["L1"].stops > 0.5  # over
    assert reached["L2"].stops == pytest.approx(0.0, abs=1e-9)
    assert reached["L3"].stops < -2.0  # neither time nor gain suffice
    mid_electrons = {name: r.electrons * SENSOR.key * 2.0**r.stops for name, r in reached.items()}
    assert mid_electrons["L2"] > 2000.0 and mid_electrons["L3"] < 50.0


def test_lights_mix_to_the_stated_illuminance():
    lux = {"daylight": 200.0, "lamps": 30.0}
    light = Light("any", 150.0, 0.4)
    factors = light.factors(lux)
    assert {group: factors[group] * lux[group] for group in lux} == pytest.approx({"daylight": 60.0, "lamps": 90.0})
    dungeon = light.factors({"daylight": 0.0, "lamps": 30.0})
    assert dungeon == {"daylight": 0.0, "lamps": 5.0}


def test_relit_images_darken_and_grow_noisy():
    rng = np.random.default_rng(0)
    color = np.repeat(np.linspace(20, 235, 160).astype(np.uint8)[None], 120, axis=0)
    image = np.repeat(color[..., None], 3, axis=2)
    lights = {name: relit(image, light, rng).astype(float) for name, light in LIGHTS.items()}
    means = [lights[name].mean() for name in ("L1", "L2", "L3")]
    assert means[0] > means[1] + 15.0 > means[2] + 60.0
    assert np.abs(lights["L2"] - image).mean() < 3.0
    noise = {name: np.median(picture.std(axis=0)) for name, picture in lights.items()}
    assert noise["L3"] > 4.0 * noise["L2"]


# --- structured light ---

CAMERA = Camera(160, 120, 136.6, 136.6, 79.5, 59.5)
TOWARDS = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (120, 160, 1))
NO_GLASS = np.zeros((120, 160), dtype=bool)


def measured(depth: np.ndarray, normals: np.ndarray = TOWARDS, glass: np.ndarray = NO_GLASS, **settings: float):
    config = DepthSensorConfig(**settings)
    return structured_light(depth.astype(np.float32), normals, glass, CAMERA, config, np.random.default_rng(0))


@pytest.mark.parametrize("depth_m", [0.8, 1.5, 3.0, 4.5])
def test_depth_errs_with_the_square_of_the_distance(depth_m):
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


def test_depth_is_missing_where_the_sensor_sees_nothing():
    depth = np.full((120, 160), 2.0)
    assert not measured(np.full((120, 160), 0.3)).any()
    assert not measured(np.full((120, 160), 6.0)).any()
    glass = NO_GLASS.copy()
    glass[40:60] = True
    assert not measured(depth, glass=glass)[40:60].any()
    grazing = np.tile(np.array([0.0, -np.cos(0.1), -np.sin(0.1)], np.float32), (120, 160, 1))
    assert np.mean(measured(depth, grazing)[:50] > 0.0) < 0.05


def test_a_step_in_depth_casts_a_shadow_beside_it():
    depth = np.full((120, 160), 3.0)
    depth[:, 60:100] = 1.0
    seen = measured(depth)
    shadow = CAMERA.fx * DepthSensorConfig().baseline_m * (1.0 / 1.0 - 1.0 / 3.0)
    missing = (seen[10:110] == 0.0).mean(axis=0) > 0.95
    # On one side only, and as wide as the difference of disparities.
    assert missing[20:60].sum() + missing[100:140].sum() == pytest.approx(shadow, abs=3.0)
    assert min(missing[20:58].sum(), missing[102:140].sum()) == 0


# --- denoising ---


def test_denoising_keeps_texture_edges_and_lamps():
    rng = np.random.default_rng(0)
    albedo = np.where(rng.uniform(size=(80, 80, 1)) < 0.5, 0.2, 0.7).repeat(3, axis=2).astype(np.float32)
    normals = np.zeros((80, 80, 3), np.float32)
    normals[:, :40], normals[:, 40:] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    points = np.zeros((80, 80, 3), np.float32)
    points[:, :40, 1:] = np.stack(np.mgrid[0:80, 0:40] / 40.0, axis=-1)
    points[:, 40:, ::2] = np.stack(np.mgrid[0:80, 0:40] / 40.0, axis=-1)
    shading = np.where(np.arange(80)[None, :, None] < 40, 1.0, 2.0).astype(np.float32)
    shines = np.zeros((80, 80), bool)
    shines[:6, :6] = True
    truth = albedo * shading
    truth[shines] = 500.0
    noisy = (truth * rng.gamma(8.0, 1.0 / 8.0, (80, 80, 1))).astype(np.float32)
    clean = denoised(noisy, Guide(albedo, normals, points, shines))
    np.testing.assert_array_equal(clean[shines], noisy[shines])
    rest = np.ones((80, 80), bool)
    rest[:8, :8] = False
    error = [np.sqrt(np.mean((image[rest] / truth[rest] - 1.0) ** 2)) for image in (noisy, clean)]
    assert error[1] < 0.25 * error[0]
    assert clean[20:60, 36:40].mean() / truth[20:60, 36:40].mean() == pytest.approx(1.0, abs=0.06)
