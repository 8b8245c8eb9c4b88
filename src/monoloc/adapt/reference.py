"""The kernel that draws points, in NumPy: what it is held against in tests and benchmarks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, transform


def draw_nearest(
    points: FloatArray,
    camera_from_world: FloatArray,
    camera: FloatArray,
    sight: FloatArray,
    first: int,
    nearest: NDArray[np.uint64],
) -> None:
    """Draw points, each on the four pixels about it, into keys of which the least is the nearest point's.

    A key is the depth's bits as a float32, which for positive numbers are ordered as these are, and below them the
    point's number.

    Args:
        points: (N, 3) world frame, metres.
        camera_from_world: (4, 4).
        camera: fx, fy, cx, cy, k1, k2, p1, p2, k3.
        sight: see :meth:`monoloc.camera.Camera.sight`.
        first: number of the first point.
        nearest: (height + 2, width + 2), with a margin of one pixel; changed in place.
    """
    height, width = nearest.shape[0] - 2, nearest.shape[1] - 2
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = camera.tolist()
    pinhole = Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    in_camera = transform(camera_from_world, points)
    least_m, most_x, most_y = sight
    x, y, z = in_camera.T
    seen = np.flatnonzero((z > least_m) & (np.abs(x) < most_x * z) & (np.abs(y) < most_y * z))
    u, v = np.floor(pinhole.project(in_camera[seen])).T
    inside = (u >= -1.0) & (v >= -1.0) & (u < width) & (v < height)
    index = seen[inside]
    depth_bits = in_camera[index, 2].astype(np.float32).view(np.uint32).astype(np.uint64)
    keys = (depth_bits << np.uint64(32)) | (first + index).astype(np.uint64)
    rows, columns = v[inside].astype(np.int64) + 1, u[inside].astype(np.int64) + 1
    for row in (0, 1):
        for column in (0, 1):
            np.minimum.at(nearest, (rows + row, columns + column), keys)
