"""How many landmarks an image from a pose would show, predicted from what the build's frames found.

Seen from another direction or distance, a landmark's descriptor changes, and other things may hide it. The rate at
which it is found from a place is estimated by kernel regression (Nadaraya 1964, Watson 1964): the share of the views
that had it in the image and found it, weighted by how similarly they saw it. A few views that found nothing are added
to those of every landmark, so that its rate falls to 0 where no view is similar.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform
from monoloc.landmarks.landmark_map import LandmarkViews

# Widths of the kernel in direction (rad) and in the logarithm of distance; number of added views that found nothing.
# The kernel has heavy tails: corners of a flat picture are recognised even from 50 degrees aside.
_DIRECTION_RAD, _LOG_DISTANCE, _NOTHING_FOUND = 0.12, 0.20, 2.0


class ExpectedLandmarks:
    """Predicts how many landmarks are found in images of a room.

    Args:
        points: of the landmarks, (L, 3), world frame, metres.
        views: of the build's frames.
        camera: of these frames.
    """

    def __init__(self, points: NDArray[np.float32], views: LandmarkViews, camera: Camera) -> None:
        self._points = points.astype(np.float64)
        is_seen = views.found.copy()
        for row, pose in zip(is_seen, views.poses, strict=True):
            row[camera.in_view(transform(invert(pose), self._points))[0]] = True
        view, self._landmark = np.nonzero(is_seen)
        self._is_found = views.found[view, self._landmark]
        self._direction, self._log_distance = _polar(self._points[self._landmark] - views.poses[view, :3, 3])

    def rates(self, position: FloatArray) -> FloatArray:
        """Probability that each landmark is found in an image from a position (3,) that has it in view, (L,)."""
        direction, log_distance = _polar(self._points - position)
        cosine = np.einsum("pi,pi->p", direction.take(self._landmark, axis=0), self._direction)
        squared = (2.0 - 2.0 * cosine) / _DIRECTION_RAD**2  # of the unit vectors' difference
        squared += ((log_distance.take(self._landmark) - self._log_distance) / _LOG_DISTANCE) ** 2
        weights = (1.0 + np.maximum(squared, 0.0)) ** -1.5
        found, seen = (
            np.bincount(self._landmark, each, len(self._points)) for each in (weights * self._is_found, weights)
        )
        return np.asarray(found / (seen + _NOTHING_FOUND))

    def count(self, pose: FloatArray, camera: Camera, rates: FloatArray) -> float:
        """Expected number of landmarks that an image shows.

        Args:
            pose: ``T_world_camera``, (4, 4).
            camera: its intrinsics.
            rates: of :meth:`rates` at its position.
        """
        return float(rates[camera.in_view(transform(invert(pose), self._points))[0]].sum())


def _polar(offsets: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit vectors, (N, 3), and logarithms of the lengths, (N,), of offsets (N, 3)."""
    lengths = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    return (offsets / lengths[:, None]).astype(np.float32), np.log(lengths).astype(np.float32)
