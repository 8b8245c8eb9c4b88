"""Images of cameras that differ a little, rendered as one common camera sees them.

A phone's focal length and principal point move with focus and stabilisation, and structure from motion may estimate
intrinsics for each image. A recording has one camera, so each image that differs is resampled: colour bilinearly,
depth by the nearest pixel.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray

_SAME_LENS = 0.05  # largest relative difference of focal lengths of one lens; focusing changes them by about 1 %
_UNSEEN_PX = 0.5  # images whose pixels move less are taken as they are


def resize_nearest(image: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Enlarge or reduce an image (h, w) to (height, width), each pixel to its nearest; the borders coincide."""
    rows = (np.arange(height) * 2 + 1) * image.shape[0] // (2 * height)
    columns = (np.arange(width) * 2 + 1) * image.shape[1] // (2 * width)
    return np.asarray(image[rows[:, None], columns], dtype=np.float32)


def common_camera(cameras: Sequence[Camera]) -> tuple[Camera, NDArray[np.bool_]]:
    """Choose the camera that stands for those of a recording's images.

    It is the camera with the median focal length of those of the most frequent image size.

    Args:
        cameras: camera of each image, N >= 1.

    Returns:
        The camera, and for each image (N,) whether its camera has that size and a focal length within 5 %.
    """
    sizes = [(camera.width, camera.height) for camera in cameras]
    ((size, _),) = Counter(sizes).most_common(1)
    focals_px = np.array([camera.focal_px for camera in cameras])
    of_size = np.array([each == size for each in sizes])
    candidates = np.flatnonzero(of_size)
    middle = candidates[np.argsort(focals_px[candidates], kind="stable")[(len(candidates) - 1) // 2]]
    return cameras[middle], of_size & (np.abs(focals_px / focals_px[middle] - 1.0) <= _SAME_LENS)


class Resampler:
    """Renders images as the common camera sees them.

    Args:
        camera: the common camera.
        cameras: camera of each image.
    """

    def __init__(self, camera: Camera, cameras: Sequence[Camera]) -> None:
        self._camera = camera
        corners = np.linspace([0.0, 0.0], [camera.width - 1.0, camera.height - 1.0], 3)
        pixels = np.stack(np.meshgrid(*corners.T), axis=-1)
        rays = camera.rays(pixels)
        moved_px = {own: float(np.abs(own.project(rays) - pixels).max()) for own in set(cameras)}
        self._own = [None if moved_px[own] <= _UNSEEN_PX else own for own in cameras]
        self._rays: FloatArray | None = None

    def color(self, index: int, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Render the colour image ``index``, (H, W, 3) -> (H, W, 3); beyond its border, the border's colour."""
        own = self._own[index]
        if own is None:
            return image
        x, y = self._pixels_in(own)
        return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)

    def depth(self, index: int, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Render the depth image ``index``, (H, W) m -> (H, W) m; 0 beyond its border."""
        own = self._own[index]
        if own is None:
            return depth_m
        x, y = self._pixels_in(own)
        return np.asarray(cv2.remap(depth_m, x, y, cv2.INTER_NEAREST, borderValue=0.0), dtype=np.float32)

    def _pixels_in(self, own: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Pixel of an image at each pixel of the common camera, (H, W) each."""
        if self._rays is None:
            self._rays = self._camera.pixel_rays()
        pixels = own.project(self._rays).astype(np.float32)
        return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])
