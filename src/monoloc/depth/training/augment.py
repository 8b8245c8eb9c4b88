"""Training examples from frames: a random view of each frame under a random exposure.

The geometry is one affine map from the network's pixels to the frame's (zoom, shift, roll, mirror, aspect). So the
focal length of every view is known, and its depth can be expressed for the canonical camera. Roll, mirror and zoom do
not change z-depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera

_DISPLAY_GAMMA = 2.2  # display gamma of 8-bit images
_LINEAR = np.linspace(0.0, 1.0, 256) ** _DISPLAY_GAMMA
_BLURRED_SHARE = 0.3  # share of blurred views
_SUPERSAMPLE = 2  # views are drawn at twice the size and averaged, to avoid aliasing


@dataclass(frozen=True)
class View:
    """A virtual camera's view of a frame.

    Attributes:
        color: (height, width, 3) uint8 RGB.
        depth_m: (height, width) float32, metres, 0 where there is none; true depth, not canonical.
        linear, offset: (2, 2) and (2,); view pixel p shows frame pixel ``linear @ p + offset``.
        focal_px: geometric mean of the view's focal lengths, pixels.
    """

    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    linear: NDArray[np.float64]
    offset: NDArray[np.float64]
    focal_px: float


class AugmentConfig(BaseModel):
    """Ranges of the random augmentation; with the defaults, a person still recognises the rooms.

    Attributes:
        zoom_min, zoom_max: smallest and largest magnification; 1 shows the whole frame, less leaves a black border.
        roll_deg: largest camera roll, in both directions.
        aspect: largest relative stretch of one axis against the other, in both directions.
        mirror: whether half of the views are mirrored left to right.
        exposure_stops, gamma, contrast, white_balance, saturation: photometric ranges on both sides of neutral.
        dim_share: share of views that are darkened further.
        dim_stops: largest further darkening; together with ``exposure_stops`` it sets the darkest image that the
            network is trained for.
        electrons_min: smallest number of photoelectrons at full scale; fewer mean more shot noise. The largest number
            is a hundred times as high.
        read_noise: standard deviation of the sensor's read noise, electrons.
        blur_px: largest standard deviation of the Gaussian blur that models motion and defocus, pixels.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    zoom_min: float = Field(1.0, gt=0.0, le=1.0)
    zoom_max: float = Field(1.6, ge=1.0)
    roll_deg: float = Field(15.0, ge=0.0, le=180.0)
    aspect: float = Field(0.08, ge=0.0, lt=0.5)
    mirror: bool = True
    exposure_stops: float = Field(1.2, ge=0.0)
    gamma: float = Field(0.3, ge=0.0, lt=1.0)
    contrast: float = Field(0.25, ge=0.0, lt=1.0)
    white_balance: float = Field(0.12, ge=0.0, lt=1.0)
    saturation: float = Field(0.5, ge=0.0, le=1.0)
    dim_share: float = Field(0.25, ge=0.0, le=1.0)
    dim_stops: float = Field(4.0, ge=0.0)
    electrons_min: float = Field(300.0, gt=0.0)
    read_noise: float = Field(3.0, ge=0.0)
    blur_px: float = Field(1.0, ge=0.0)


def random_view(
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    size: tuple[int, int],
    config: AugmentConfig,
    rng: np.random.Generator,
) -> View:
    """Draw a random view of a frame at the network's size.

    Args:
        color: (H, W, 3) uint8 RGB.
        depth_m: (H, W) float32, metres, 0 where there is none.
        camera: the frame's intrinsics.
        size: (width, height) of the view, pixels.
        config: ranges of the augmentation.
        rng: source of the random numbers.

    Returns:
        The view; parts outside the frame are black and have no depth.
    """
    width, height = size
    zoom = float(np.exp(rng.uniform(np.log(config.zoom_min), np.log(config.zoom_max))))
    stretch = 1.0 + rng.uniform(-config.aspect, config.aspect)
    scale_x = camera.width / width / zoom * np.sqrt(stretch)
    scale_y = camera.height / height / zoom / np.sqrt(stretch)
    roll = np.deg2rad(rng.uniform(-config.roll_deg, config.roll_deg))
    mirror = -1.0 if config.mirror and rng.uniform() < 0.5 else 1.0
    linear = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]) @ np.diag(
        [mirror * scale_x, scale_y]
    )
    # The view's centre moves as far as the zoomed view stays inside the frame.
    slack = np.array([camera.width, camera.height]) * max(0.0, 1.0 - 1.0 / zoom) / 2.0
    centre = (np.array([camera.width, camera.height]) - 1.0) / 2.0 + rng.uniform(-1.0, 1.0, 2) * slack
    offset = centre - linear @ ((np.array([width, height]) - 1.0) / 2.0)
    return draw_view(color, depth_m, camera, size, linear, offset)


def whole_view(color: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, size: tuple[int, int]) -> View:
    """Resample the whole frame to the network's size, as at run time."""
    scale = np.array([camera.width / size[0], camera.height / size[1]])
    return draw_view(color, depth_m, camera, size, np.diag(scale), 0.5 * scale - 0.5)


def draw_view(
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    size: tuple[int, int],
    linear: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> View:
    """Resample a frame through an affine map from view pixels to frame pixels."""
    width, height = size
    view_depth = _warp(depth_m, linear, offset, size, cv2.INTER_NEAREST)
    fine_offset = offset + linear @ np.full(2, 0.5 / _SUPERSAMPLE - 0.5)
    fine_size = (width * _SUPERSAMPLE, height * _SUPERSAMPLE)
    fine = _warp(color, linear / _SUPERSAMPLE, fine_offset, fine_size, cv2.INTER_LINEAR)
    view_color = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
    focal_px = camera.focal_px / float(np.sqrt(abs(np.linalg.det(linear))))
    return View(np.asarray(view_color, np.uint8), np.asarray(view_depth, np.float32), linear, offset, focal_px)


def _warp(
    image: NDArray[np.uint8] | NDArray[np.float32],
    linear: NDArray[np.float64],
    offset: NDArray[np.float64],
    size: tuple[int, int],
    interpolation: int,
) -> NDArray[np.float32]:
    """Warp ``image`` so that pixel p shows it at ``linear @ p + offset``; black outside."""
    return np.asarray(
        cv2.warpAffine(image, np.column_stack([linear, offset]), size, flags=interpolation | cv2.WARP_INVERSE_MAP)
    )


@dataclass(frozen=True)
class Exposure:
    """Light, lens and sensor of a simulated photograph; the defaults only add the noise of a good camera.

    Attributes:
        stops: exposure relative to the original image.
        balance: gains of red, green and blue.
        gamma, contrast, saturation: parameters of the display curve; 1 is neutral.
        blur_px: standard deviation of the Gaussian blur, pixels.
        electrons: photoelectrons at full scale.
        read_noise: standard deviation of the sensor's read noise, electrons.
    """

    stops: float = 0.0
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gamma: float = 1.0
    contrast: float = 1.0
    saturation: float = 1.0
    blur_px: float = 0.0
    electrons: float = 30000.0
    read_noise: float = 3.0


def random_exposure(color: NDArray[np.uint8], config: AugmentConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate random light, lens and sensor for a view: (H, W, 3) uint8 -> (H, W, 3) uint8."""

    def about(range_: float) -> float:
        return float(rng.uniform(-range_, range_))

    stops = about(config.exposure_stops)
    if rng.uniform() < config.dim_share:
        stops -= rng.uniform(0.0, config.dim_stops)
    exposure = Exposure(
        stops=stops,
        balance=(
            1.0 + about(config.white_balance),
            1.0 + about(config.white_balance),
            1.0 + about(config.white_balance),
        ),
        gamma=1.0 + about(config.gamma),
        contrast=1.0 + about(config.contrast),
        saturation=1.0 + about(config.saturation),
        blur_px=rng.uniform(0.0, config.blur_px) if rng.uniform() < _BLURRED_SHARE else 0.0,
        electrons=config.electrons_min * 100.0 ** rng.uniform(),
        read_noise=config.read_noise,
    )
    return expose(color, exposure, rng)


def expose(color: NDArray[np.uint8], exposure: Exposure, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Simulate another exposure of an image: (H, W, 3) uint8 RGB -> (H, W, 3) uint8.

    Linear intensity is scaled and blurred, gets sensor noise, and passes through the display curve.
    """
    gain = 2.0**exposure.stops * np.asarray(exposure.balance)
    light = cv2.LUT(color, np.ascontiguousarray((_LINEAR[:, None] * gain).astype(np.float32)[None]))
    if exposure.blur_px > 0.0:
        light = cv2.GaussianBlur(light, (0, 0), max(0.1, exposure.blur_px))
    light = counted(np.asarray(light, dtype=np.float32), exposure.electrons, exposure.read_noise, rng)
    image = cv2.pow(np.clip(light, 0.0, 1.0), exposure.gamma / _DISPLAY_GAMMA)
    grey = image.mean(axis=2, keepdims=True)
    image = (grey + (image - grey) * np.float32(exposure.saturation) - 0.5) * np.float32(exposure.contrast) + 0.5
    return np.asarray(np.clip(image * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8))


def counted(
    light: NDArray[np.float32], electrons: float, read_noise: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Add Poisson-Gaussian sensor noise to light (Foi et al. 2008).

    Args:
        light: linear intensity of any shape; 1 is full scale.
        electrons: photoelectrons at full scale.
        read_noise: standard deviation of the sensor's read noise, electrons.
        rng: source of the noise.
    """
    variance = light / np.float32(electrons) + np.float32((read_noise / electrons) ** 2)
    return np.asarray(light + np.sqrt(variance) * rng.standard_normal(light.shape, dtype=np.float32), np.float32)
