"""Depth images rendered from the room's cloud, as supervision where the recording has no sensor depth."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc.io.recording import Recording

RENDERED_WIDTH = 160
"""Of the rendered image, pixels; about that of a network's input, so that the supervision has few gaps."""

_CELL_PX = 4.0  # larger than the point spacing of a 3 cm cloud at room distances, so that surfaces have no gaps
_SAME_SURFACE = 1.05
_GAP = 1.4  # spacings that a cell must be wide: points are not evenly spaced
_SPACING_CELL_M = 0.15


def supervision(
    recording: Recording, cloud: FloatArray, is_dense: bool = False
) -> Callable[[int], NDArray[np.float32]]:
    """Return a function from frame index to depth (H, W) m: sensor depth, or the cloud's depth where it is missing.

    Sensors miss dark, shiny and far surfaces in all frames. Without supervision there, the network's depth would be
    arbitrary in about a quarter of the scan.

    Args:
        recording, cloud, is_dense: as :func:`map_depth`.
    """
    from_map = map_depth(recording, cloud, is_dense)

    def depth_of(index: int) -> NDArray[np.float32]:
        depth = from_map(index)
        if recording.has_depth:
            measured = recording.depth(index)
            depth = np.where(measured > 0.0, measured, depth)
        return depth

    return depth_of


def map_depth(
    recording: Recording, cloud: FloatArray, is_dense: bool = False
) -> Callable[[int], NDArray[np.float32]]:
    """Return a function from frame index to the cloud's depth (H, W) m, 0 where no point is visible.

    The depth is rendered 160 pixels wide and scaled to the frame by nearest neighbour. A point is visible if no other
    point in its image cell is nearer by more than 5 %. The cells are wide enough to hide points behind a surface:
    the nearer a point is, the wider the cells in which it hides others.

    Args:
        recording: posed frames.
        cloud: (N, 3), world frame, metres.
        is_dense: whether all cells are the narrow ones, so that more of the image has depth, and what is nearer than
            a metre may show what is behind it.
    """
    poses, camera = recording.poses, recording.camera
    assert poses is not None
    spacing_m = 0.0 if is_dense else point_spacing_m(cloud)
    return lambda index: cloud_depth(cloud, camera, poses[index], spacing_m)


def cloud_depth(
    cloud: FloatArray, camera: Camera, T_world_camera: FloatArray, spacing_m: float
) -> NDArray[np.float32]:
    """Depth (H, W) m of a cloud (N, 3) that a camera sees, as :func:`map_depth` renders it.

    Args:
        spacing_m: of the cloud's points on surfaces: :func:`point_spacing_m`, measured once for all poses.
    """
    size = (camera.width, camera.height)
    camera = camera.of_width(RENDERED_WIDTH)
    points = transform(invert(T_world_camera), cloud)
    points = points[camera.in_sight(points)]
    pixels = np.round(camera.project(points)).astype(np.int64)
    inside = (pixels >= 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    u, v, z = pixels[inside, 0], pixels[inside, 1], points[inside, 2]
    seen = _is_visible(u, v, z, camera, spacing_m)
    pixel, count = v[seen] * camera.width + u[seen], camera.width * camera.height
    rendered = np.bincount(pixel, z[seen], count) / np.maximum(1, np.bincount(pixel, minlength=count))
    image = rendered.reshape(camera.height, camera.width).astype(np.float32)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST_EXACT))


def _is_visible(
    u: NDArray[np.int64], v: NDArray[np.int64], z: FloatArray, camera: Camera, spacing_m: float
) -> NDArray[np.bool_]:
    """Which of N points, at pixels u, v (N,) and depths z (N,), no other hides.

    Args:
        camera: of the image.
        spacing_m: of the points on surfaces.
    """
    is_visible, hides = np.ones(len(z), dtype=np.bool_), np.ones(len(z), dtype=np.bool_)
    cell_px, tolerance_m = _CELL_PX, 0.0
    while hides.any() and cell_px < 2.0 * RENDERED_WIDTH:
        # The last cell takes what is left: a narrow one at the border would have gaps.
        columns, rows = (max(1, int(size / cell_px)) for size in (camera.width, camera.height))
        across, down = (
            np.minimum(each / cell_px, most - 1).astype(np.int64) for each, most in ((u, columns), (v, rows))
        )
        cell = down * columns + across
        nearest = np.full(rows * columns, np.inf)
        np.minimum.at(nearest, cell[hides], z[hides])
        is_visible &= z <= _SAME_SURFACE * nearest[cell] + tolerance_m
        # Points that are sparser in the image than these cells hide others in wider ones, in which a slanted surface
        # reaches farther back.
        hides = _GAP * spacing_m * camera.focal_px > cell_px * z
        cell_px, tolerance_m = 2.0 * cell_px, spacing_m
    return is_visible


def point_spacing_m(cloud: FloatArray) -> float:
    """Spacing of a cloud's points (N, 3) on surfaces, by the number of points in a cell that one passes through."""
    if len(cloud) == 0:
        return _SPACING_CELL_M
    cells = np.floor(cloud / _SPACING_CELL_M).astype(np.int64)
    _, cell_of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return float(_SPACING_CELL_M / np.sqrt(np.median(counts[cell_of.ravel()])))
