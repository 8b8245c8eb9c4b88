"""The three lights of the paper, for rendering and for simulation on real images.

A light is a mixture of daylight and lamps with a mean illuminance. It illuminates a rendered room. On a well exposed
real image it is simulated with the exposure that a camera with the same limits would choose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.depth.training.augment import Exposure, expose
from monoloc_lab.synth.materials import LightGroup
from monoloc_lab.synth.sensor import SensorConfig

_ALBEDO = 0.5  # mean of a room: luminance = illuminance * albedo / pi for matt surfaces


@dataclass(frozen=True)
class Light:
    """A light.

    Attributes:
        lux: mean illuminance of the visible surfaces.
        daylight: share of daylight through windows; the rest is from lamps.
        bias_stops: exposure compensation of the camera.
    """

    name: str
    lux: float
    daylight: float
    bias_stops: float = 0.0

    @property
    def luminance(self) -> float:
        """Mean luminance of the surfaces, cd/m^2."""
        return self.lux * _ALBEDO / np.pi

    def exposed(self, sensor: SensorConfig) -> SensorConfig:
        """The camera with the exposure compensation of this light."""
        return sensor.model_copy(update={"key": min(0.95, sensor.key * 2.0**self.bias_stops)})

    def factors(self, lux: Mapping[LightGroup, float]) -> dict[LightGroup, float]:
        """Factor of each light group for this light, given the illuminance of each group."""
        shares: dict[LightGroup, float] = {"daylight": self.daylight, "lamps": 1.0 - self.daylight}
        if min(lux.values()) <= 0.0:  # a room without windows, or without lamps
            shares = {group: float(value > 0.0) for group, value in lux.items()}
        return {group: self.lux * share / lux[group] if lux[group] > 0.0 else 0.0 for group, share in shares.items()}


LIGHTS: dict[str, Light] = {
    light.name: light
    for light in (
        Light("L1", lux=1500.0, daylight=0.85, bias_stops=0.8),  # a bright day at the window
        Light("L2", lux=150.0, daylight=0.35),  # lamps on a dull afternoon
        Light("L3", lux=1.0, daylight=0.15),  # a lamp dimmed at night
    )
}


@dataclass(frozen=True)
class Levels:
    """Exposure of a light in a camera.

    Attributes:
        stops: relative to a well exposed image.
        electrons: photoelectrons of full scale.
    """

    stops: float
    electrons: float


def levels(light: Light, sensor: SensorConfig) -> Levels:
    """Exposure of a light by a camera within the camera's limits."""
    scale, electrons = light.exposed(sensor).scale(light.luminance)
    return Levels(float(np.log2(scale * light.luminance / sensor.key)), electrons)


def relit(color: NDArray[np.uint8], light: Light, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate another light on a well exposed image: (H, W, 3) uint8 RGB -> the same.

    The direction of the light does not change; its amount and the noise do.

    Raises:
        ValueError: the image has another shape or type.
    """
    if np.ndim(color) != 3 or color.shape[2] != 3 or color.dtype != np.uint8:
        raise ValueError(f"color must have shape (H, W, 3) as uint8, got {np.shape(color)} {color.dtype}")
    sensor = SensorConfig()
    reached = levels(light, sensor)
    exposure = Exposure(stops=reached.stops, electrons=reached.electrons, read_noise=sensor.read_noise)
    return expose(color, exposure, rng)
