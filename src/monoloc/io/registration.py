"""Registration of depth images to another camera: forward projection with a z-buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera

_SAME_SURFACE = 0.05  # largest relative depth step over two pixels of one surface
_BLOCK = 8192  # pixels per block; their coordinates fit in a core's cache


class DepthRegistration:
    """Registers depth images of a depth camera to the colour camera.

    Each depth pixel is back-projected, transformed to the colour camera and written to the pixel it projects to. The
    nearest depth wins, which removes surfaces that are occluded from the colour camera. Neighbouring samples of one
    surface may skip a pixel; such a crack is closed from the two neighbours on either side if these agree. Nothing
    else is filled: regions that only the colour camera sees (shadow of the baseline) have no depth.

    Attributes:
        depth_camera, color_camera: the two cameras; either may be distorted.
    """

    def __init__(self, depth_camera: Camera, color_camera: Camera, T_color_depth: NDArray[np.float64]) -> None:
        self.depth_camera = depth_camera
        self.color_camera = color_camera
        rays_color = depth_camera.pixel_rays() @ T_color_depth[:3, :3].T
        # (N, 3) in column-major order, which makes the arithmetic faster.
        self._rays = np.asfortranarray(rays_color.reshape(-1, 3), dtype=np.float32)
        self._origin = T_color_depth[:3, 3].astype(np.float32)

    def __call__(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (h, w) float32 m in the depth camera -> (H, W) float32 m in the colour camera, 0 if unknown."""
        width, height = self.color_camera.width, self.color_camera.height
        nearest = np.full(height * width, np.inf, dtype=np.float32)
        flat = depth_m.reshape(-1)
        for start in range(0, len(flat), _BLOCK):
            depths, rays = flat[start : start + _BLOCK], self._rays[start : start + _BLOCK]
            points_color = depths[:, None] * rays + self._origin
            pixels = self.color_camera.project(points_color) + 0.5
            u, v = pixels[:, 0], pixels[:, 1]
            inside = (depths > 0.0) & (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)
            # Distortion folds points far outside the field of view back into the image.
            inside[inside] = self.color_camera.in_sight(points_color[inside].astype(np.float64))
            target = v[inside].astype(np.intp) * width + u[inside].astype(np.intp)
            np.minimum.at(nearest, target, points_color[inside, 2])
        image = _close_cracks(nearest.reshape(height, width))
        image[np.isinf(image)] = 0.0
        return image


def _close_cracks(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill each pixel that is empty (infinity) or behind both of two opposite neighbours that agree.

    A farther depth between two nearer depths that agree is background, seen through a crack in the foreground.
    """
    closed = depth_m.copy()
    for before, middle, after in (
        (depth_m[:, :-2], closed[:, 1:-1], depth_m[:, 2:]),
        (depth_m[:-2], closed[1:-1], depth_m[2:]),
    ):
        mean = 0.5 * (before + after)
        with np.errstate(invalid="ignore"):  # inf - inf: neither neighbour has depth
            agree = np.abs(before - after) < _SAME_SURFACE * mean
        crack = agree & (middle > (1.0 + _SAME_SURFACE) * mean)
        middle[crack] = mean[crack]
    return closed
