"""The viewpoints that a room was built from, and what the particles were measured to err by at each of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from monoloc.geometry import FloatArray, invert, se3_log, viewpoints_apart

_ALIKE_M = 0.1  # farther than the nearest, a radian for a metre: by then a viewpoint's word counts 1 / e as much
STEP_M = 0.5  # from one to the next, a radian for a metre: over more no camera is followed
_STILL_M = 0.02  # of a way, a radian for a metre: on a shorter one the camera goes nowhere
_ROUNDING_M = 1e-4  # of a step, a radian for a metre: shorter ones have no direction


@dataclass(frozen=True)
class Viewpoints:
    """Of a build's frames, in the order in which they were taken.

    Errors are twists (V, 6) in the camera's frame: the particles' pose is the true one times the exponential, but for
    what differs from flight to flight. They are zero where they were not measured.

    Attributes:
        poses: ``T_world_camera``, (V, 4, 4).
        there: errors of a flight that passes the viewpoints in order.
        back: errors of one that passes them in reverse.
    """

    poses: FloatArray
    there: FloatArray
    back: FloatArray

    @classmethod
    def of(cls, poses: FloatArray) -> Viewpoints:
        """Of frames' poses (V, 4, 4), where no errors are known."""
        return cls(poses, np.zeros((len(poses), 6)), np.zeros((len(poses), 6)))

    @classmethod
    def none(cls) -> Viewpoints:
        return cls.of(np.empty((0, 4, 4)))

    def __len__(self) -> int:
        return len(self.poses)

    def distance_m(self, pose: FloatArray) -> float:
        """From a camera (4, 4) to the nearest, a radian for a metre; none where there are no viewpoints."""
        return float(viewpoints_apart(pose, self.poses).min()) if len(self) else 0.0

    def error_at(self, pose: FloatArray, way: FloatArray) -> FloatArray:
        """What is to be expected of the viewpoints that are nearest to a camera, a twist (6,).

        As far as the camera moves as it did there or back, what was found on that flight; as far as it moves
        otherwise, or stands still, what both have in common. Of that the mean over all viewpoints, with weights that
        fall off with what each is farther than the nearest (Nadaraya 1964, Watson 1964).

        Args:
            pose: ``T_world_camera``, (4, 4).
            way: that the camera has come, of late, a twist (6,) in its frame.
        """
        if not len(self):
            return np.zeros(6)
        distances_m = viewpoints_apart(pose, self.poses)
        weights = np.exp((distances_m.min() - distances_m) / _ALIKE_M)
        along = self._ahead @ way / (np.linalg.norm(way) + _STILL_M)
        forth, back = (np.maximum(0.0, sign * along)[:, None] for sign in (1.0, -1.0))
        errors = forth * self.there + back * self.back + (1.0 - forth - back) * self.in_common
        return np.asarray(weights @ errors / weights.sum())

    @cached_property
    def in_common(self) -> FloatArray:
        """What a flight that takes another way is to be expected to err by, (V, 6).

        The mean of the two, by its share that is no chance: the reliability of a mean of two (Spearman 1910, Brown
        1910).
        """
        alike = likeness(self.there, self.back)
        return np.asarray(alike / (1.0 + alike) * (self.there + self.back))

    @cached_property
    def _ahead(self) -> FloatArray:
        """Where a flight in order moves at each viewpoint, twists (V, 6) of unit length, or zero where it stands."""
        steps = se3_log(invert(self.poses[:-1]) @ self.poses[1:])
        steps[np.linalg.norm(steps, axis=1) > STEP_M] = 0.0
        ways = np.zeros((len(self), 6))
        ways[:-1] += steps
        ways[1:] += steps
        lengths = np.linalg.norm(ways, axis=1, keepdims=True)
        return np.asarray(np.divide(ways, lengths, out=np.zeros_like(ways), where=lengths > _ROUNDING_M))


def likeness(there: FloatArray, back: FloatArray) -> FloatArray:
    """Correlation (6,) of what two flights err by at the same N viewpoints, twists (N, 6) each: 0 to 1.

    What is the same in both is of the place, and the rest of the way that was taken. About zero and not about the
    means, for those are in common too.
    """
    squares = 0.5 * (there**2 + back**2).sum(axis=0)
    both = np.maximum(0.0, (there * back).sum(axis=0))
    return np.asarray(np.divide(both, squares, out=np.zeros(6), where=squares > 0.0))
