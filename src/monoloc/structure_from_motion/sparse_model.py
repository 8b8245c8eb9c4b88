"""What structure from motion finds: poses of the frames, points of the room, and where they are seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, invert, transform


@dataclass(frozen=True)
class SparseModel:
    """Poses and points, in a world and a unit of their own until they are brought to metres.

    Attributes:
        camera: of the recording's images; with refined intrinsics where they were refined.
        camera_sd: standard deviations of refined parameters by name; empty where they were given.
        frames: (F,) indices into the recording of the frames that were placed, ascending.
        poses: ``T_world_camera`` of these, (F, 4, 4).
        points: (P, 3) world frame.
        frame: (O,) which of ``frames`` made each observation, ascending.
        point: (O,) which of ``points`` it saw.
        pixels: (O, 2) where, pixels of ``camera``.
        tried: number of frames that were given.
    """

    camera: Camera
    camera_sd: dict[str, float]
    frames: NDArray[np.int64]
    poses: FloatArray
    points: FloatArray
    frame: NDArray[np.int64]
    point: NDArray[np.int64]
    pixels: FloatArray
    tried: int

    def without(self, is_left_out: NDArray[np.bool_], least: int) -> SparseModel:
        """The model without some of its F frames, and without points that fewer than ``least`` of the others see."""
        is_kept = ~is_left_out
        is_seen = is_kept[self.frame]
        is_known = np.bincount(self.point[is_seen], minlength=len(self.points)) >= least
        is_seen &= is_known[self.point]
        return replace(
            self,
            frames=self.frames[is_kept],
            poses=self.poses[is_kept],
            points=self.points[is_known],
            frame=(np.cumsum(is_kept) - 1)[self.frame[is_seen]],
            point=(np.cumsum(is_known) - 1)[self.point[is_seen]],
            pixels=self.pixels[is_seen],
        )

    def scaled(self, factor: float) -> SparseModel:
        """The same model in another unit: all lengths are multiplied."""
        poses = self.poses.copy()
        poses[:, :3, 3] *= factor
        return replace(self, poses=poses, points=factor * self.points)

    def moved(self, T_new_world: FloatArray) -> SparseModel:
        """The same model in another world frame."""
        return replace(self, poses=T_new_world @ self.poses, points=transform(T_new_world, self.points))

    def seen(self, frame: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Points that one of ``frames`` sees: their indices (M,) and their pixels (M, 2)."""
        first, last = np.searchsorted(self.frame, [frame, frame + 1])
        return self.point[first:last], self.pixels[first:last]

    def depth(self, frame: int) -> FloatArray:
        """Depth of the points that one of ``frames`` sees, (M,), in the order of :meth:`seen`."""
        return transform(invert(self.poses[frame]), self.points[self.seen(frame)[0]])[:, 2]

    def reprojection_px(self) -> float:
        """Root mean square of the distance between observed pixels and projected points."""
        local = np.einsum("oji,oj->oi", self.poses[self.frame, :3, :3], self.points[self.point] - self._centres())
        return float(np.sqrt(np.mean(np.sum((self.camera.project(local) - self.pixels) ** 2, axis=1))))

    def _centres(self) -> FloatArray:
        """Camera centre of each observation, (O, 3)."""
        return np.asarray(self.poses[self.frame, :3, 3])
