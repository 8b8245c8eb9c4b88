"""Depth images rendered from the room's cloud, as supervision where the recording has no sensor depth."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording

_WIDTH = 160  # of the rendered image; about that of a network's input, so that the supervision has few gaps
_CELL_PX = 4.0  # larger than the point spacing of a 3 cm cloud at room distances, so that surfaces have no gaps
_SAME_SURFACE = 1.05


def supervision(recording: Recording, cloud: FloatArray) -> Callable[[int], NDArray[np.float32]]:
    """Return a function from frame index to depth (H, W) m: sensor depth, or the cloud's depth where it is missing.

    Sensors miss dark, shiny and far surfaces in all frames. Without supervision there, the network's depth would be
    arbitrary in about a quarter of the scan.
    """
    from_map = map_depth(recording, cloud)

    def depth_of(index: int) -> NDArray[np.float32]:
        depth = from_map(index)
        if recording.has_depth:
            measured = recording.depth(index)
            depth = np.where(measured > 0.0, measured, depth)
        return depth

    return depth_of


def map_depth(recording: Recording, cloud: FloatArray) -> Callable[[int], NDArray[np.float32]]:
    """Return a function from frame index to the cloud's depth (H, W) m, 0 where no point is visible.

    The depth is rendered 160 pixels wide and scaled to the frame by nearest neighbour. A point is visible if no other
    point in its image cell is nearer by more than 5 %. The cells are wide enough to hide points behind a surface.

    Args:
        recording: posed frames.
        cloud: (N, 3), world frame, metres.
    """
    poses, camera = recording.poses, recording.camera
    assert poses is not None
    return lambda index: cloud_depth(cloud, camera, poses[index])


def cloud_depth(cloud: FloatArray, camera: Camera, T_world_camera: FloatArray) -> NDArray[np.float32]:
    """Depth (H, W) m of a cloud (N, 3) that a camera sees, as :func:`map_depth` renders it."""
    size = (camera.width, camera.height)
    camera = camera.resized(_WIDTH, max(1, round(_WIDTH * size[1] / size[0])))
    columns, rows = int(camera.width / _CELL_PX) + 1, int(camera.height / _CELL_PX) + 1
    points = transform(invert(T_world_camera), cloud)
    points = points[camera.in_sight(points)]
    pixels = np.round(camera.project(points)).astype(np.int64)
    inside = (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    u, v, z = pixels[inside, 0], pixels[inside, 1], points[inside, 2]
    cell = (v / _CELL_PX).astype(np.int64) * columns + (u / _CELL_PX).astype(np.int64)
    nearest = np.full(rows * columns, np.inf)
    np.minimum.at(nearest, cell, z)
    seen = z <= _SAME_SURFACE * nearest[cell]
    pixel, count = v[seen] * camera.width + u[seen], camera.width * camera.height
    rendered = np.bincount(pixel, z[seen], count) / np.maximum(1, np.bincount(pixel, minlength=count))
    image = rendered.reshape(camera.height, camera.width).astype(np.float32)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT))
