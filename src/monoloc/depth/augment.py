"""Training examples out of frames: a random view of the frame, then a random exposure of it.

Geometry is one affine map from the network's pixels to the frame's (zoom, shift, roll, mirror, aspect), so the
focal length of every view is known and its depth can be expressed for the canonical camera. z-depth does not
change under roll, mirror or zoom.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.camera import Camera

_SUPERSAMPLE = 2  # views are drawn at twice the size and averaged down, so that minified frames do not alias


@dataclass(frozen=True)
class View:
    """What a virtual camera sees of a frame.

    Attributes:
        color: (height, width, 3) uint8 RGB.
        depth_m: (height, width) float32, 0 where there is none; true depth, not canonical.
        linear, offset: view pixel p shows frame pixel ``linear @ p + offset``; (2, 2) and (2,).
        focal_px: geometric mean of the view's focal lengths.
    """

    color: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    linear: NDArray[np.float64]
    offset: NDArray[np.float64]
    focal_px: float


class AugmentConfig(BaseModel):
    """Ranges of the random changes; the defaults leave rooms recognisable to a person.

    Attributes:
        zoom_min, zoom_max: smallest and largest magnification; 1 shows the whole frame, less leaves a black border.
        roll_deg: camera roll, either way.
        aspect: relative stretch of one axis against the other, either way.
        mirror: whether half of the views are mirrored left to right.
        exposure_stops, gamma, contrast, white_balance: photometric ranges, either way of neutral.
        noise: largest standard deviation of sensor noise, in units of full scale.
        blur_px: largest standard deviation of Gaussian blur.
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
    noise: float = Field(0.03, ge=0.0)
    blur_px: float = Field(1.0, ge=0.0)


def random_view(
    color: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    size: tuple[int, int],
    config: AugmentConfig,
    rng: np.random.Generator,
) -> View:
    """A random view of a frame at the network's size.

    Args:
        color: (H, W, 3) uint8 RGB.
        depth_m: (H, W) float32, 0 where there is none.
        camera: the frame's intrinsics.
        size: (width, height) of the view, pixels.

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
    # The view's centre wanders as far as the zoom leaves room inside the frame.
    slack = np.array([camera.width, camera.height]) * max(0.0, 1.0 - 1.0 / zoom) / 2.0
    centre = (np.array([camera.width, camera.height]) - 1.0) / 2.0 + rng.uniform(-1.0, 1.0, 2) * slack
    offset = centre - linear @ ((np.array([width, height]) - 1.0) / 2.0)
    return draw_view(color, depth_m, camera, size, linear, offset)


def whole_view(color: NDArray[np.uint8], depth_m: NDArray[np.float32], camera: Camera, size: tuple[int, int]) -> View:
    """The whole frame at the network's size, as at run time."""
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
    """The frame resampled through an affine map from view pixels to frame pixels."""
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
    """Image whose pixel p shows ``image`` at ``linear @ p + offset``; black outside."""
    return np.asarray(
        cv2.warpAffine(image, np.column_stack([linear, offset]), size, flags=interpolation | cv2.WARP_INVERSE_MAP)
    )


def random_exposure(color: NDArray[np.uint8], config: AugmentConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The same view under another light, lens and sensor: (H, W, 3) uint8 -> (H, W, 3) uint8."""
    gain = 2.0 ** rng.uniform(-config.exposure_stops, config.exposure_stops)
    balance = gain * (1.0 + rng.uniform(-config.white_balance, config.white_balance, 3))
    gamma = 1.0 + rng.uniform(-config.gamma, config.gamma)
    contrast = 1.0 + rng.uniform(-config.contrast, config.contrast)
    # Gain acts on linear light; 2.2 is the display curve that 8-bit images carry.
    levels = np.linspace(0.0, 1.0, 256)[:, None]
    curve = np.clip(levels**2.2 * balance, 0.0, 1.0) ** (gamma / 2.2)
    curve = np.clip((curve - 0.5) * contrast + 0.5, 0.0, 1.0).astype(np.float32)
    image = cv2.LUT(color, np.ascontiguousarray(curve[None]))
    if rng.uniform() < 0.3:
        image = cv2.GaussianBlur(image, (0, 0), max(0.1, rng.uniform(0.0, config.blur_px)))
    sigma = rng.uniform(0.0, config.noise)
    image = image + rng.standard_normal(image.shape, dtype=np.float32) * np.float32(sigma)
    return np.asarray(np.clip(image * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8))
