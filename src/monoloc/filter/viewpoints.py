"""The viewpoints that a room was built from, and what the particles were measured to err by at each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.geometry import FloatArray, viewpoints_apart

_ALIKE_M = 0.1  # farther than the nearest, a radian for a metre: by then a viewpoint's word counts 1 / e as much


@dataclass(frozen=True)
class Viewpoints:
    """Of a build's frames.

    Attributes:
        poses: ``T_world_camera``, (V, 4, 4).
        errors: twists (V, 6) in the camera's frame: the particles' pose is the true one times the exponential, but
            for what differs from flight to flight. Zero where that was not measured.
    """

    poses: FloatArray
    errors: FloatArray

    @classmethod
    def of(cls, poses: FloatArray) -> Viewpoints:
        """Of frames' poses (V, 4, 4), where no errors are known."""
        return cls(poses, np.zeros((len(poses), 6)))

    @classmethod
    def none(cls) -> Viewpoints:
        return cls.of(np.empty((0, 4, 4)))

    def __len__(self) -> int:
        return len(self.poses)

    def distance_m(self, pose: FloatArray) -> float:
        """From a camera (4, 4) to the nearest, a radian for a metre; none where there are no viewpoints."""
        return float(viewpoints_apart(pose, self.poses).min()) if len(self) else 0.0

    def error_at(self, pose: FloatArray) -> FloatArray:
        """What was measured where the viewpoints are nearest to a camera (4, 4), a twist (6,).

        The mean over all, with weights that fall off with what each is farther than the nearest (Nadaraya 1964,
        Watson 1964).
        """
        if not len(self):
            return np.zeros(6)
        distances_m = viewpoints_apart(pose, self.poses)
        weights = np.exp((distances_m.min() - distances_m) / _ALIKE_M)
        return np.asarray(weights @ self.errors / weights.sum())
