"""Oriented boxes: distances to points, and intersections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from monoloc.geometry import FloatArray

_TOUCHING_M = 1e-4  # overlap of boxes that only touch


@dataclass(frozen=True)
class Boxes:
    """B oriented boxes.

    Attributes:
        poses: (B, 4, 4), ``T_world_box``; the origin is the box's centre.
        half_sizes: (B, 3) half the edge lengths, metres.
    """

    poses: FloatArray
    half_sizes: FloatArray

    def __len__(self) -> int:
        return len(self.poses)

    def corners(self) -> FloatArray:
        """(B, 8, 3) world frame, metres."""
        signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
        local = signs * self.half_sizes[:, None, :]
        return np.asarray(local @ np.swapaxes(self.poses[:, :3, :3], 1, 2) + self.poses[:, None, :3, 3])

    def distance_m(self, points: ArrayLike) -> FloatArray:
        """Signed distance of points (N, 3) to the nearest box, (N,); negative inside a box."""
        p = np.asarray(points, dtype=np.float64)
        nearest = np.full(len(p), np.inf)
        for pose, half in zip(self.poses, self.half_sizes, strict=True):
            beyond = np.abs((p - pose[:3, 3]) @ pose[:3, :3]) - half
            outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
            nearest = np.minimum(nearest, np.where(outside > 0.0, outside, beyond.max(axis=1)))
        return nearest

    def intersect(self, other: Boxes) -> bool:
        """Whether a box of one intersects a box of the other by more than a tenth of a millimetre.

        Separating axis theorem: boxes are disjoint if their projections on one of 15 axes are (Gottschalk 1996).
        """
        mine, theirs = self.corners(), other.corners()
        reach = (mine.max(1)[:, None] > theirs.min(1)[None]) & (theirs.max(1)[None] > mine.min(1)[:, None])
        return any(
            _cut(self.poses[i, :3, :3], mine[i], other.poses[j, :3, :3], theirs[j])
            for i, j in np.argwhere(reach.all(axis=-1))
        )


def _cut(R_a: FloatArray, a: FloatArray, R_b: FloatArray, b: FloatArray) -> bool:
    crosses = np.cross(R_a.T[:, None, :], R_b.T[None, :, :]).reshape(9, 3)
    lengths = np.linalg.norm(crosses, axis=1)
    # The cross product of parallel edges vanishes; the face axes suffice then.
    axes = np.concatenate([R_a.T, R_b.T, crosses[lengths > 1e-6] / lengths[lengths > 1e-6, None]])
    on_a, on_b = axes @ a.T, axes @ b.T
    overlap = np.minimum(on_a.max(1), on_b.max(1)) - np.maximum(on_a.min(1), on_b.min(1))
    return bool(np.all(overlap > _TOUCHING_M))
