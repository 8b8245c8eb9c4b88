"""Simulated sensors: a camera from light to 8 bits, and a structured-light depth sensor."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera
from monoloc.depth.training.augment import counted

_DISPLAY_GAMMA = 2.2
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # of linear sRGB, ITU-R BT.709


class SensorConfig(BaseModel):
    """A small camera with automatic exposure; the defaults are those of an indoor drone.

    Attributes:
        electrons_per_cd_s: photoelectrons per pixel and second at 1 cd/m^2; about 1e4 for a 6 um pixel at f/2 with a
            colour filter.
        full_well: electrons that a pixel can hold.
        read_noise: standard deviation, electrons.
        longest_s, shortest_s: exposure times.
        largest_gain: factor by which gain reduces full scale, at most.
        key: linear mean of the image that exposure aims at.
        vignetting: share of light lost in the corners.
        adapted: degree to which white balance follows the colour of the light, 0 to 1.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    electrons_per_cd_s: float = Field(1.0e4, gt=0.0)
    full_well: float = Field(12000.0, gt=0.0)
    read_noise: float = Field(3.0, ge=0.0)
    longest_s: float = Field(0.02, gt=0.0)
    shortest_s: float = Field(1e-4, gt=0.0)
    largest_gain: float = Field(16.0, ge=1.0)
    key: float = Field(0.22, gt=0.0, lt=1.0)
    vignetting: float = Field(0.25, ge=0.0, lt=1.0)
    adapted: float = Field(0.75, ge=0.0, le=1.0)

    def scale(self, luminance: float) -> tuple[float, float]:
        """Exposure for a mean luminance in cd/m^2: level of 1 cd/m^2 at full scale 1, and electrons of full scale.

        Gain is used when the exposure time has reached its limit. If both are at their limits, the image is dark.
        """
        per_s = self.electrons_per_cd_s / self.full_well * self.exposure_s(luminance)  # of full scale, at gain 1
        gain = float(np.clip(self._wanted(luminance) / per_s, 1.0, self.largest_gain))
        return per_s * gain, self.full_well / gain

    def exposure_s(self, luminance: float) -> float:
        """Exposure time for a mean luminance, cd/m^2."""
        per_cd_s = self.electrons_per_cd_s / self.full_well
        return float(np.clip(self._wanted(luminance) / per_cd_s, self.shortest_s, self.longest_s))

    def _wanted(self, luminance: float) -> float:
        return self.key / max(luminance, 1e-9)


def metered(light: NDArray[np.float32]) -> float:
    """Mean luminance of an image (H, W, 3) as a camera meters it, with lamps and windows clipped."""
    luminance = light @ _LUMINANCE
    return float(np.mean(np.minimum(luminance, 4.0 * np.median(luminance))))


def white_balance(light: NDArray[np.float32], adapted: float) -> NDArray[np.float32]:
    """Gains (3,) that move the mean of the image towards grey to a degree; that of green is 1."""
    bright = light.reshape(-1, 3)
    mean = np.minimum(bright, 4.0 * np.median(bright, axis=0)).mean(axis=0)
    return np.asarray((mean[1] / np.maximum(mean, 1e-9)) ** adapted, dtype=np.float32)


def photograph(
    light: NDArray[np.float32],
    config: SensorConfig,
    rng: np.random.Generator,
    balance: NDArray[np.float32] | None = None,
) -> NDArray[np.uint8]:
    """Simulate an 8-bit image of linear light: (H, W, 3) float32 cd/m^2 -> (H, W, 3) uint8 RGB.

    Args:
        balance: gains of red, green and blue; None computes them from the image.
    """
    scale, electrons = config.scale(metered(light))
    gains = white_balance(light, config.adapted) if balance is None else balance
    seen = light * (scale * _falloff(light.shape[1], light.shape[0], config.vignetting))[..., None]
    # A pixel saturates at 1. Noise is that of the electrons, so white balance amplifies it too.
    # No gain is below 1; otherwise saturated pixels would not be white.
    gains = gains / gains.min()
    raw = np.clip(counted(np.minimum(seen, 1.0).astype(np.float32), electrons, config.read_noise, rng), 0.0, 1.0)
    image = np.clip(raw * gains, 0.0, 1.0) ** (1.0 / _DISPLAY_GAMMA)
    return np.asarray(np.round(image * 255.0), dtype=np.uint8)


def _falloff(width: int, height: int, loss: float) -> NDArray[np.float32]:
    """Share of light that reaches each pixel, (H, W): 1 in the centre, ``1 - loss`` in the corners."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    r2 = ((x + 0.5) / width - 0.5) ** 2 + ((y + 0.5) / height - 0.5) ** 2
    return np.asarray(1.0 - loss * r2 / 0.5, dtype=np.float32)


class DepthSensorConfig(BaseModel):
    """A structured-light sensor, after Khoshelham and Elberink (2012); the defaults are those of a Kinect.

    Attributes:
        baseline_m: distance of projector and camera.
        focal_px_per_width: focal length over the width of the image (585 / 640).
        steps_per_px: resolution of the disparity, in steps per pixel of a 640-pixel-wide image.
        disparity_sd_px: noise of the disparity in such pixels, before rounding.
        nearest_m, farthest_m: range.
        grazing_deg: largest angle to the normal at which a surface is measured.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    baseline_m: float = Field(0.075, gt=0.0)
    focal_px_per_width: float = Field(0.914, gt=0.0)
    steps_per_px: float = Field(8.0, gt=0.0)
    disparity_sd_px: float = Field(0.06, ge=0.0)
    nearest_m: float = Field(0.5, gt=0.0)
    farthest_m: float = Field(5.0, gt=0.0)
    grazing_deg: float = Field(80.0, gt=0.0, le=90.0)


def structured_light(
    depth_m: NDArray[np.float32],
    normals_camera: NDArray[np.float32],
    glass: NDArray[np.bool_],
    camera: Camera,
    config: DepthSensorConfig,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Simulate the depth of such a sensor: (H, W) metres, 0 where it measures none.

    Args:
        depth_m: true depth (H, W), 0 where there is none.
        normals_camera: (H, W, 3) surface normals, camera frame.
        glass: (H, W) window panes, which are not measured.
    """
    rays = camera.pixel_rays()
    cosine = -np.sum(rays * normals_camera, axis=2) / np.linalg.norm(rays, axis=2)
    seen = (depth_m > config.nearest_m) & (depth_m < config.farthest_m) & ~glass
    seen &= cosine > np.cos(np.deg2rad(config.grazing_deg))
    seen &= ~_shadow(depth_m, camera, config.baseline_m)
    # The pattern around a depth edge does not match.
    spread = cv2.dilate(depth_m, np.ones((3, 3))) - cv2.erode(depth_m, np.ones((3, 3)))
    seen &= (spread < 0.1 * depth_m) | (rng.uniform(size=depth_m.shape) < 0.4)
    focal_baseline = config.focal_px_per_width * 640.0 * config.baseline_m
    disparity = focal_baseline / np.maximum(depth_m, 1e-3) + config.disparity_sd_px * rng.standard_normal(
        depth_m.shape
    )
    disparity = np.maximum(np.round(disparity * config.steps_per_px), 1.0) / config.steps_per_px
    return np.where(seen, focal_baseline / disparity, 0.0).astype(np.float32)


def _shadow(depth_m: NDArray[np.float32], camera: Camera, baseline_m: float) -> NDArray[np.bool_]:
    """Pixels in the shadow of the projector, which is a baseline to the right of the camera."""
    u = np.arange(camera.width, dtype=np.float64)
    landing = u - camera.fx * baseline_m / np.maximum(depth_m, 1e-3)
    # Along a row, a point is hidden from the projector if a right neighbour has a smaller projected column.
    nearest = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(landing > nearest + 0.5)
