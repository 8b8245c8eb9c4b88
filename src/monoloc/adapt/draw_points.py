"""NumPy reference of the kernel that draws points, for tests and benchmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.distortion import COEFFICIENTS, DistortionModel
from monoloc.geometry import FloatArray, transform

NO_POINT = 0xFFFFFFFF
_DOWN, _ACROSS = (0, 0, 1, 1), (0, 1, 0, 1)  # offsets of the four pixels around a point


def draw_points(
    points: FloatArray,
    camera_from_world: FloatArray,
    camera: FloatArray,
    is_fisheye: bool,
    sight: FloatArray,
    behind: float,
    front: NDArray[np.uint32],
    depth: NDArray[np.float32],
) -> None:
    """Draw points into a depth buffer; each point covers the four pixels around its projection.

    Args:
        points: (N, 3) world frame, metres.
        camera_from_world: ``T_camera_world``, (4, 4).
        camera: (12,) fx, fy, cx, cy, and k1, k2, p1, p2, k3, k4, k5, k6 of the rational model, the last three of
            which are 0 for Brown's, or k1 to k4 of a fisheye and four zeros.
        is_fisheye: which of the two.
        sight: limits of the field of view, see :meth:`monoloc.camera.Camera.sight`.
        behind: depth tolerance of a surface, relative: points at most this much farther than the nearest point of a
            pixel belong to the same surface.
        front: (height, width) output: index of the nearest point that covers each pixel, the lowest index among
            equally near points; 2^32 - 1 where no point does.
        depth: (height, width) output: mean depth of the points on the nearest surface, metres; 0 where there is none.
    """
    height, width = front.shape
    fx, fy, cx, cy, *coefficients = camera.tolist()
    model: DistortionModel = "fisheye" if is_fisheye else "rational"
    lens = Camera(width, height, fx, fy, cx, cy, tuple(coefficients[: len(COEFFICIENTS[model])]), model)
    in_camera = transform(camera_from_world, points)
    least_m, most_x, most_y, most_radius = sight
    x, y, z = in_camera.T
    within = (np.abs(x) < most_x * z) & (np.abs(y) < most_y * z) & (np.hypot(x, y) < most_radius * z)
    seen = np.flatnonzero((z > least_m) & within)
    u, v = np.floor(lens.project(in_camera[seen])).T
    inside = (u >= -1.0) & (v >= -1.0) & (u < width) & (v < height)
    # Each point appears four times, once per covered pixel, in an image with a margin of one pixel.
    number = np.tile(seen[inside], 4)
    rows = np.concatenate([v[inside].astype(np.int64) + 1 + down for down in _DOWN])
    columns = np.concatenate([u[inside].astype(np.int64) + 1 + across for across in _ACROSS])
    z = in_camera[number, 2].astype(np.float32)
    nearest = np.full((height + 2, width + 2), np.inf, dtype=np.float32)
    np.minimum.at(nearest, (rows, columns), z)
    first = np.full(nearest.shape, NO_POINT, dtype=np.int64)
    is_nearest = z == nearest[rows, columns]
    np.minimum.at(first, (rows[is_nearest], columns[is_nearest]), number[is_nearest])
    of_surface = z <= np.float32(1.0 + behind) * nearest[rows, columns]
    total, count = np.zeros(nearest.shape), np.zeros(nearest.shape)
    np.add.at(total, (rows[of_surface], columns[of_surface]), z[of_surface])
    np.add.at(count, (rows[of_surface], columns[of_surface]), 1)
    front[:] = first[1:-1, 1:-1]
    depth[:] = (total / np.maximum(count, 1))[1:-1, 1:-1]
