"""Removal of Monte Carlo noise from rendered light, guided by the geometry.

The edge-avoiding à-trous wavelet transform of Dammertz et al. (2010), on light over albedo as in Schied et al.
(2017): textures are divided out before the filter and multiplied in after it, so only shading is smoothed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
_PLANE_M = 0.02  # distance from the tangent plane at which points belong to another surface
_NORMAL_POWER = 24.0
_LIGHT_SDS = 3.0  # smaller differences of shading, in standard deviations of the noise, count as noise
_LEVELS = 4  # of smoothing, each over twice the distance
_DARKEST = 0.02  # smallest albedo to divide by


@dataclass(frozen=True)
class Guide:
    """Geometry of each pixel: (H, W, 3) albedo, normals and points (world frame, m); (H, W) whether it shines."""

    albedo: Image
    normals: Image
    points: Image
    shines: NDArray[np.bool_]


def denoised(light: Image, guide: Guide) -> Image:
    """Denoise rendered light (H, W, 3); pixels of lamps and windows are not changed."""
    albedo = np.maximum(guide.albedo, np.float32(_DARKEST))
    near_lamp = cv2.dilate(guide.shines.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    shading = _without_fireflies(np.asarray(light / albedo, dtype=np.float32), near_lamp)
    noise = _noise_of(shading.mean(axis=2))
    for level in range(_LEVELS):
        shading = _smoothed(shading, guide, near_lamp, noise, 1 << level)
        noise = noise * 0.6
    return np.where(near_lamp[..., None], light, shading * albedo).astype(np.float32)


def _without_fireflies(shading: Image, leave: NDArray[np.bool_]) -> Image:
    grey = shading.mean(axis=2)
    bound = 3.0 * cv2.medianBlur(np.ascontiguousarray(grey), 5) + 1e-6
    factor = np.where(leave, 1.0, np.minimum(1.0, bound / np.maximum(grey, 1e-9)))
    return np.asarray(shading * factor[..., None], dtype=np.float32)


def _noise_of(grey: Image) -> Image:
    """Local standard deviation of the noise, (H, W), from differences between neighbours."""
    detail = grey - cv2.GaussianBlur(grey, (0, 0), 1.5)
    return np.asarray(1.2 * np.sqrt(cv2.GaussianBlur(detail**2, (0, 0), 3.0)) + 1e-9, dtype=np.float32)


def _smoothed(shading: Image, guide: Guide, leave: NDArray[np.bool_], noise: Image, step: int) -> Image:
    pad = 2 * step
    height, width = noise.shape
    blurred = cv2.GaussianBlur(shading.mean(axis=2), (0, 0), 1.0)

    def padded(image: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.pad(image, [(pad, pad), (pad, pad)] + [(0, 0)] * (image.ndim - 2), mode="edge")

    values, normals, points = padded(shading), padded(guide.normals), padded(guide.points)
    greys, usable = padded(blurred), padded((~leave).astype(np.float32))
    total = np.zeros_like(shading)
    weights = np.zeros((height, width), dtype=np.float32)
    for i, wy in enumerate(_KERNEL):
        for j, wx in enumerate(_KERNEL):
            window = (slice(i * step, i * step + height), slice(j * step, j * step + width))
            off_plane = np.abs(np.sum((points[window] - guide.points) * guide.normals, axis=2)) / _PLANE_M
            turned = np.clip(np.sum(normals[window] * guide.normals, axis=2), 0.0, 1.0) ** _NORMAL_POWER
            differs = np.abs(greys[window] - blurred) / (_LIGHT_SDS * noise)
            w = (wy * wx * turned * np.exp(-off_plane - differs) * usable[window]).astype(np.float32)
            total += w[..., None] * values[window]
            weights += w
    isolated = weights < 1e-6
    return np.where(isolated[..., None], shading, total / np.where(isolated, 1.0, weights)[..., None]).astype(
        np.float32
    )
