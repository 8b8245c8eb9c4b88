"""The landmark map: corners of a room with descriptors.

Away from the views that it was tuned on, a depth network makes the same error from frame to frame. The
position of a corner does not depend on what a network has learnt.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import encode_arrays
from monoloc.geometry import FloatArray, pose_distance_m, se3_exp, se3_log

LEAST_RELOCALIZED = 20
"""Landmarks that must agree on a pose before it is believed without a prior."""

FAMILIAR_TIMES = 2
"""From how many of the nearest views a landmark was found that is familiar, see :class:`LandmarkViews`."""

# Views that tell which landmarks are found from a pose. Of landmarks that these found, the share that is found falls
# from 0.86 within 0.1 m (pose distance) to 0.5 at 0.15 m and 0.3 at 0.3 m.
_NEAREST_VIEWS, _NEAR_M = 3, 0.2
_RANGED_LANDMARKS = 2000  # of which the largest distance is sought


@dataclass(frozen=True)
class FamiliarLandmarks:
    """Landmarks in view that views of the build near the camera found.

    Attributes:
        indices: (F,) int64, in the room's landmarks.
        is_found: (F,) bool, whether the image shows each of them where it should be.
        is_shown: (F,) bool, whether the image shows anything there.
    """

    indices: NDArray[np.int64]
    is_found: NDArray[np.bool_]
    is_shown: NDArray[np.bool_]

    def shown(self) -> FamiliarLandmarks:
        """Those where the image shows anything: only these tell whether the room has changed."""
        shown = self.is_shown
        return FamiliarLandmarks(self.indices[shown], self.is_found[shown], shown[shown])


@dataclass(frozen=True)
class LandmarkViews:
    """Which of L landmarks V frames of the build found at their true poses.

    Whether a landmark is found depends on where it is seen from: others hide it, and its descriptor changes.

    Attributes:
        poses: (V, 4, 4) ``T_world_camera``.
        found: (V, L) bool.

    Raises:
        ValueError: other shapes.
    """

    poses: FloatArray
    found: NDArray[np.bool_]

    def __post_init__(self) -> None:
        poses, found = self.poses, self.found
        if poses.shape[1:] != (4, 4) or found.ndim != 2 or len(poses) != len(found):
            raise ValueError(f"poses and found must be (V, 4, 4) and (V, L), got {poses.shape} and {found.shape}")

    def times_found(self, pose: FloatArray) -> NDArray[np.int64] | None:
        """From how many of the nearest views, at most three, each landmark was found, (L,).

        Args:
            pose: ``T_world_camera``, (4, 4).

        Returns:
            None where fewer than two views are near.
        """
        nearest = self.nearest(pose)
        return None if len(nearest) < 2 else self.found[nearest].sum(axis=0)

    def familiar(
        self,
        pose: FloatArray,
        visible: NDArray[np.int64],
        is_found: NDArray[np.bool_],
        is_shown: NDArray[np.bool_],
    ) -> FamiliarLandmarks | None:
        """Those of the landmarks in view that at least :data:`FAMILIAR_TIMES` of the nearest views found.

        Args:
            pose: ``T_world_camera``, (4, 4).
            visible: (E,) indices of the landmarks in view.
            is_found: (E,) whether each of them is found.
            is_shown: (E,) whether the image shows anything there.

        Returns:
            None where fewer than two views are near.
        """
        times = self.times_found(pose)
        if times is None:
            return None
        is_familiar = times[visible] >= FAMILIAR_TIMES
        return FamiliarLandmarks(visible[is_familiar], is_found[is_familiar], is_shown[is_familiar])

    def nearest(self, pose: FloatArray) -> NDArray[np.int64]:
        """Indices of the nearest views, at most three, that are near a pose (4, 4)."""
        distances_m = pose_distance_m(pose, self.poses)
        nearest = np.argsort(distances_m)[:_NEAREST_VIEWS]
        return np.asarray(nearest[distances_m[nearest] < _NEAR_M])

    def farthest_m(self, points: NDArray[np.float32]) -> float:
        """The largest distance at which a view found one of the landmarks (L, 3); 0 where none was found.

        Of many landmarks, an even selection is looked at.
        """
        step = max(1, len(points) // _RANGED_LANDMARKS)
        points, farthest_m = points[::step], 0.0
        for pose, found in zip(self.poses, self.found[:, ::step], strict=True):  # all at once take 10 MB
            ranges_m = np.linalg.norm(points[found] - pose[:3, 3], axis=1)
            farthest_m = max(farthest_m, float(ranges_m.max(initial=0.0)))
        return farthest_m

    def without(self, index: int) -> LandmarkViews:
        """All views but one."""
        return LandmarkViews(np.delete(self.poses, index, axis=0), np.delete(self.found, index, axis=0))


@dataclass(frozen=True)
class Landmarks:
    """L corners of a room, with ORB descriptors.

    Attributes:
        points: (L, 3) float32, world frame, metres.
        descriptors: (L, 32) uint8, binary.
        views: from which they were found; without any, changes of the map are not detected.

    Raises:
        ValueError: other shapes or types, or points that are not finite.
    """

    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    views: LandmarkViews | None = None

    def __post_init__(self) -> None:
        points, descriptors = self.points, self.descriptors
        shapes = f"{points.shape} and {descriptors.shape}"
        if points.shape[1:] != (3,) or descriptors.shape[1:] != (32,) or len(points) != len(descriptors):
            raise ValueError(f"points and descriptors must be (L, 3) and (L, 32), got {shapes}")
        if points.dtype != np.float32 or descriptors.dtype != np.uint8:
            types = f"{points.dtype} and {descriptors.dtype}"
            raise ValueError(f"points and descriptors must be float32 and uint8, got {types}")
        if not np.isfinite(points).all():
            raise ValueError("points must be finite")
        if self.views is not None and self.views.found.shape[1:] != (len(points),):
            raise ValueError(f"views.found must be (V, {len(points)}), got {self.views.found.shape}")

    @classmethod
    def none(cls) -> Landmarks:
        return cls(np.zeros((0, 3), np.float32), np.zeros((0, 32), np.uint8))

    def __len__(self) -> int:
        return len(self.points)

    def select(self, chosen: NDArray[np.bool_ | np.int64]) -> Landmarks:
        """Some of the landmarks, by a mask (L,) or by their indices, with what the views found of them."""
        views = self.views
        if views is not None:
            views = LandmarkViews(views.poses, views.found[:, chosen])
        return Landmarks(self.points[chosen], self.descriptors[chosen], views)

    @property
    def bytes(self) -> int:
        """As stored."""
        return len(encode_arrays(self.to_arrays()))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays to store: ``points``, ``descriptors``, and of views their twists (V, 6), float32, and bits."""
        arrays: dict[str, NDArray[Any]] = {"points": self.points, "descriptors": self.descriptors}
        if self.views is not None:
            arrays["view_twists"] = se3_log(self.views.poses).astype(np.float32)
            arrays["view_found"] = np.packbits(self.views.found, axis=1)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Landmarks:
        """Inverse of :meth:`to_arrays`, up to rounding to float32.

        Raises:
            KeyError, ValueError: an array is missing, or has another shape or type.
        """
        points, descriptors = arrays["points"], arrays["descriptors"]
        if "view_twists" not in arrays:  # bundles of earlier versions
            return cls(points, descriptors)
        poses = se3_exp(arrays["view_twists"].reshape(-1, 6).astype(np.float64))
        found = np.unpackbits(arrays["view_found"], axis=1, count=len(points)).astype(np.bool_)
        return cls(points, descriptors, LandmarkViews(poses, found))
