"""Depth of one camera seen from another: forward projection with a z-buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera

_SAME_SURFACE = 0.05  # relative depth step across two pixels up to which they are taken for one surface
_BLOCK = 8192  # pixels at a time, whose coordinates then stay in a core's cache


class DepthRegistration:
    """Renders depth images of a depth camera as its colour camera would see them.

    Each depth pixel is back-projected, moved to the colour camera and written to the pixel it falls on;
    the nearest wins, so what the colour camera cannot see is dropped. Cracks, where neighbouring samples of
    one surface skip a pixel, are closed from the two neighbours on either side if these agree. Nothing
    else is filled: what only the colour camera sees (shadow of the baseline) stays without depth.

    Attributes:
        depth_camera, color_camera: the two cameras; either may be distorted.
    """

    def __init__(self, depth_camera: Camera, color_camera: Camera, T_color_depth: NDArray[np.float64]) -> None:
        self.depth_camera = depth_camera
        self.color_camera = color_camera
        rays_color = depth_camera.pixel_rays() @ T_color_depth[:3, :3].T
        # (N, 3), but coordinate by coordinate in memory, where arithmetic is faster.
        self._rays = np.asfortranarray(rays_color.reshape(-1, 3), dtype=np.float32)
        self._origin = T_color_depth[:3, 3].astype(np.float32)

    def __call__(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth (h, w) float32 m in the depth camera -> (H, W) float32 m in the colour camera, 0 = none."""
        width, height = self.color_camera.width, self.color_camera.height
        nearest = np.full(height * width, np.inf, dtype=np.float32)
        flat = depth_m.reshape(-1)
        for start in range(0, len(flat), _BLOCK):
            depths, rays = flat[start : start + _BLOCK], self._rays[start : start + _BLOCK]
            points_color = depths[:, None] * rays + self._origin
            pixels = self.color_camera.project(points_color) + 0.5
            u, v = pixels[:, 0], pixels[:, 1]
            inside = (depths > 0.0) & (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)
            target = v[inside].astype(np.intp) * width + u[inside].astype(np.intp)
            np.minimum.at(nearest, target, points_color[inside, 2])
        image = _close_cracks(nearest.reshape(height, width))
        image[np.isinf(image)] = 0.0
        return image


def _close_cracks(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Fill pixels that lie behind (or hold nothing, infinity) both of two opposite neighbours that agree.

    A farther depth between two agreeing nearer ones is background seen through a crack of the foreground.
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
