"""A distorted camera's images as a pinhole sees them, for viewers that know no distortion."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera

_WIDEST = np.tan(np.deg2rad(60.0))  # at z = 1; beyond it, a pinhole's image shows little but its border


class PinholeView:
    """Resamples images of a camera; those of a pinhole stay as they are.

    Attributes:
        camera: the pinhole, of the same size and principal point. Its field of view is what the middles of the
            image's sides show, up to 60 degrees off the optical axis.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self._map: NDArray[np.float32] | None = None
        if not camera.is_distorted:
            return
        right, bottom = camera.width - 0.5, camera.height - 0.5
        cx, cy = np.clip(camera.cx, 0.0, right - 0.5), np.clip(camera.cy, 0.0, bottom - 0.5)
        sides = np.array([[-0.5, cy], [right, cy], [cx, -0.5], [cx, bottom]])
        reach_px = np.abs(sides - [cx, cy]).max(axis=1)
        at_sides = np.abs(camera.rays(sides)[:, :2]).max(axis=1)
        focal_px = float((reach_px / np.clip(at_sides, 1e-3, _WIDEST)).min())
        self.camera = Camera(camera.width, camera.height, focal_px, focal_px, float(cx), float(cy))
        rays = self.camera.pixel_rays().reshape(-1, 3)
        pixels = np.where(camera.in_sight(rays)[:, None], camera.project(rays), -1e6)  # the rest is black
        self._map = pixels.reshape(camera.height, camera.width, 2).astype(np.float32)

    def __call__(self, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image (H, W, 3) uint8 that the pinhole sees, black where the camera sees nothing."""
        if self._map is None:
            return color
        return np.asarray(cv2.remap(color, self._map, None, cv2.INTER_LINEAR), dtype=np.uint8)  # type: ignore[call-overload]
