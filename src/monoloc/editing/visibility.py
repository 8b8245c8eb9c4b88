"""What hides what from the views of a room: a depth buffer of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform

_COLUMNS = 40  # of the buffer; a cell is as large as the spacing of a room's points at usual distances
_BEHIND = 1.05  # ratio of depths from which on a point is hidden


def changed_share(camera: Camera, pose: FloatArray, room: FloatArray, gone: FloatArray, new: FloatArray) -> float:
    """Share of a view of a room that shows what is gone, or that something new hides.

    Args:
        pose: ``T_world_camera``, (4, 4).
        room, gone, new: points (N, 3) each, world frame, of the room before and of what changed.
    """
    before, was_there, is_there = (DepthBuffer(camera, pose, points).depth_m for points in (room, gone, new))
    before = np.minimum(before, was_there)
    seen = np.isfinite(before)
    changed = (was_there[seen] <= _BEHIND * before[seen]) | (_BEHIND * is_there[seen] < before[seen])
    return float(changed.mean()) if len(changed) else 0.0


class DepthBuffer:
    """The least depth of points in each cell of a camera's image.

    Args:
        camera: of the view.
        pose: ``T_world_camera``, (4, 4).
        points: (N, 3), world frame, metres.

    Attributes:
        depth_m: of each cell, infinite where there is no point.
    """

    def __init__(self, camera: Camera, pose: FloatArray, points: FloatArray) -> None:
        self._camera = camera.of_width(_COLUMNS)
        self._T_camera_world = invert(pose)
        self.depth_m = np.full(self._camera.height * self._camera.width, np.inf)
        cell, depth = self._cells(points)
        np.minimum.at(self.depth_m, cell[cell >= 0], depth[cell >= 0])

    def hides(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether each of points (N, 3) in view has one of the buffer's before it, (N,)."""
        cell, depth = self._cells(points)
        return np.asarray((cell >= 0) & (depth > _BEHIND * self.depth_m[cell]))

    def _cells(self, points: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Cell of each point, -1 out of view, and its depth."""
        local = transform(self._T_camera_world, points)
        cells = np.full(len(points), -1, dtype=np.int64)
        seen = self._camera.in_sight(local)
        pixels = np.round(self._camera.project(local[seen])).astype(np.int64)
        is_in = (pixels >= 0).all(axis=1) & (pixels < [self._camera.width, self._camera.height]).all(axis=1)
        cells[np.flatnonzero(seen)[is_in]] = pixels[is_in, 1] * self._camera.width + pixels[is_in, 0]
        return cells, local[:, 2]
