"""Which landmarks a camera may see, at a cost that hardly grows with the size of the map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc.landmarks.landmark_map import Landmarks

_CELL_M = 1.0
_CELL_RADIUS_M = _CELL_M * math.sqrt(3.0) / 2.0
_SIGHT = 3.0  # times as far as the build found landmarks: from farther away, a corner looks different


class LandmarkCells:
    """The landmarks of a room, by cubes of one metre: most of what is out of view is left out cube by cube."""

    def __init__(self, landmarks: Landmarks) -> None:
        self._points, self._sight_m = landmarks.points, math.inf
        if landmarks.views is not None:
            self._sight_m = _SIGHT * landmarks.views.farthest_m(landmarks.points) or math.inf
        corners, cell_of, counts = np.unique(
            np.floor(landmarks.points / _CELL_M), axis=0, return_inverse=True, return_counts=True
        )
        self._centres = (corners + 0.5) * _CELL_M
        # Of each cell, its landmarks: `order` from `ends - counts` up to `ends`.
        self._order, self._counts, self._ends = np.argsort(cell_of, kind="stable"), counts, np.cumsum(counts)

    def nearby(self, pose: FloatArray, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """All landmarks within sight that are in view, and some that are not: indices (M,), in order, points (M, 3).

        Args:
            pose: ``T_world_camera``, (4, 4).
            camera: that looks at them.
        """
        local = transform(invert(pose), self._centres)
        may_be_seen = camera.in_sight(local, _CELL_RADIUS_M)
        may_be_seen &= np.linalg.norm(local, axis=1) < self._sight_m + _CELL_RADIUS_M
        cells = np.flatnonzero(may_be_seen)
        ends, counts = self._ends[cells], self._counts[cells]
        steps = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        members = np.sort(self._order[np.repeat(ends - counts, counts) + steps])
        points = self._points.take(members, axis=0)  # many times faster than indexing by rows
        offsets = points - pose[:3, 3].astype(np.float32)
        is_within = np.flatnonzero(np.einsum("ni,ni->n", offsets, offsets) < self._sight_m**2)
        return members.take(is_within), points.take(is_within, axis=0)
