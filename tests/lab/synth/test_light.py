"""The three lights, rendered and simulated."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc_lab.synth.light import LIGHTS, Light, levels, relit
from monoloc_lab.synth.sensor import SensorConfig

SENSOR = SensorConfig()


def test_lights_have_their_stated_exposure() -> None:
    reached = {name: levels(light, SENSOR) for name, light in LIGHTS.items()}
    assert LIGHTS["L1"].lux >= 1000.0 > 300.0 > LIGHTS["L2"].lux > 50.0 > 2.0 > LIGHTS["L3"].lux
    assert reached["L1"].stops > 0.5  # overexposed
    assert reached["L2"].stops == pytest.approx(0.0, abs=1e-9)
    assert reached["L3"].stops < -2.0  # time and gain are at their limits
    mid_electrons = {name: r.electrons * SENSOR.key * 2.0**r.stops for name, r in reached.items()}
    assert mid_electrons["L2"] > 2000.0 and mid_electrons["L3"] < 50.0


def test_mixture_has_the_stated_illuminance() -> None:
    lux = {"daylight": 200.0, "lamps": 30.0}
    light = Light("any", 150.0, 0.4)
    factors = light.factors(lux)
    assert {group: factors[group] * lux[group] for group in lux} == pytest.approx({"daylight": 60.0, "lamps": 90.0})
    without_daylight = light.factors({"daylight": 0.0, "lamps": 30.0})
    assert without_daylight == {"daylight": 0.0, "lamps": 5.0}


def test_relit_images_are_darker_and_noisier() -> None:
    rng = np.random.default_rng(0)
    color = np.repeat(np.linspace(20, 235, 160).astype(np.uint8)[None], 120, axis=0)
    image = np.repeat(color[..., None], 3, axis=2)
    lights = {name: relit(image, light, rng).astype(float) for name, light in LIGHTS.items()}
    means = [lights[name].mean() for name in ("L1", "L2", "L3")]
    assert means[0] > means[1] + 15.0 > means[2] + 60.0
    assert np.abs(lights["L2"] - image).mean() < 3.0
    noise = {name: np.median(picture.std(axis=0)) for name, picture in lights.items()}
    assert noise["L3"] > 4.0 * noise["L2"]


@pytest.mark.parametrize("image", [np.zeros((4, 5, 3)), np.zeros((4, 5), np.uint8), np.zeros((4, 5, 4), np.uint8)])
def test_relit_refuses_what_is_no_colour_image(image: NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match=r"color must have shape \(H, W, 3\) as uint8, got \(4, 5"):
        relit(image, LIGHTS["L3"], np.random.default_rng(0))
