"""Poses that a room was built from, and the bias of the particles that was measured at each of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_log

MOST_STEP_M = 0.5  # pose distance from one frame to the next beyond which no camera can be followed
MOST_POSES = 20_000  # 22 minutes at 15 Hz
NEAR_M = 0.3
"""Pose distance to the nearest reference pose up to which a camera is *near* the build's frames, and else *away*."""

_KERNEL_M = 0.1  # pose distance beyond the nearest at which a reference pose's weight has fallen to 1 / e
_STILL_M = 0.02  # recent motion, in pose distance, below which the camera moves in no direction
_ROUNDING_M = 1e-4  # steps shorter than this, in pose distance, have no direction


@dataclass(frozen=True)
class ReferencePoses:
    """V poses of a build's frames, in the order in which they were taken.

    Biases are twists (V, 6) in the camera's frame: the particles' pose is the true pose times the exponential of the
    bias, up to noise. They are zero where none was measured.

    Attributes:
        poses: ``T_world_camera``, (V, 4, 4).
        forward_bias: bias of a flight that passes the poses in order.
        backward_bias: bias of a flight that passes them in reverse order.

    Raises:
        ValueError: other shapes, too many poses, or values that are not finite.
    """

    poses: FloatArray
    forward_bias: FloatArray
    backward_bias: FloatArray

    def __post_init__(self) -> None:
        shapes = self.poses.shape, self.forward_bias.shape, self.backward_bias.shape
        count = len(self.poses)
        if shapes != ((count, 4, 4), (count, 6), (count, 6)):
            raise ValueError(f"poses and biases must be (V, 4, 4), (V, 6) and (V, 6), got {shapes}")
        if count > MOST_POSES:
            raise ValueError(f"there are {count} poses, more than {MOST_POSES}")
        if not all(np.isfinite(each).all() for each in (self.poses, self.forward_bias, self.backward_bias)):
            raise ValueError("poses and biases must be finite")

    @classmethod
    def without_bias(cls, poses: FloatArray) -> ReferencePoses:
        """Poses (V, 4, 4) at which no bias was measured."""
        return cls(poses, np.zeros((len(poses), 6)), np.zeros((len(poses), 6)))

    @classmethod
    def none(cls) -> ReferencePoses:
        return cls.without_bias(np.empty((0, 4, 4)))

    def selection(self, chosen: NDArray[np.bool_]) -> ReferencePoses:
        """Those of a mask (V,)."""
        return ReferencePoses(self.poses[chosen], self.forward_bias[chosen], self.backward_bias[chosen])

    def __len__(self) -> int:
        return len(self.poses)

    def distance_m(self, pose: FloatArray) -> float:
        """Pose distance from a camera (4, 4) to the nearest reference pose; 0 without reference poses."""
        return float(pose_distance_m(pose, self.poses).min()) if len(self) else 0.0

    def bias_at(self, pose: FloatArray, recent_motion: FloatArray) -> FloatArray:
        """Expected bias of a camera, a twist (6,).

        A camera that moves as the build moved has the forward bias, one that moves the opposite way the backward
        bias, and any other the bias common to both. The result is the kernel-weighted mean over the reference poses
        (Nadaraya 1964, Watson 1964).

        Args:
            pose: ``T_world_camera``, (4, 4).
            recent_motion: of the camera, a twist (6,) in its frame.
        """
        if not len(self):
            return np.zeros(6)
        distances_m = pose_distance_m(pose, self.poses)
        weights = np.exp((distances_m.min() - distances_m) / _KERNEL_M)
        along = self._directions @ recent_motion / (np.linalg.norm(recent_motion) + _STILL_M)
        forward, backward = (np.maximum(0.0, sign * along)[:, None] for sign in (1.0, -1.0))
        common = (1.0 - forward - backward) * self.common_bias
        biases = forward * self.forward_bias + backward * self.backward_bias + common
        return np.asarray(weights @ biases / weights.sum())

    @cached_property
    def common_bias(self) -> FloatArray:
        """Expected bias of a flight in another direction, (V, 6).

        The mean of both biases times its reliability, that of a mean of two measurements (Spearman 1910, Brown
        1910).
        """
        correlation = bias_correlation(self.forward_bias, self.backward_bias)
        return np.asarray(correlation / (1.0 + correlation) * (self.forward_bias + self.backward_bias))

    @cached_property
    def _directions(self) -> FloatArray:
        """Direction of the build's motion at each pose, twists (V, 6) of unit length, or zero where it stands."""
        steps = se3_log(invert(self.poses[:-1]) @ self.poses[1:])
        steps[np.linalg.norm(steps, axis=1) > MOST_STEP_M] = 0.0
        motions = np.zeros((len(self), 6))
        motions[:-1] += steps
        motions[1:] += steps
        lengths = np.linalg.norm(motions, axis=1, keepdims=True)
        return np.asarray(np.divide(motions, lengths, out=np.zeros_like(motions), where=lengths > _ROUNDING_M))


def bias_correlation(forward: FloatArray, backward: FloatArray) -> FloatArray:
    """Correlation (6,), 0 to 1, of two flights' biases at the same N poses, twists (N, 6) each.

    What both flights share belongs to the place; the rest belongs to the trajectory. Taken about zero and not about
    the means, because the flights share their means too.
    """
    squares = 0.5 * (forward**2 + backward**2).sum(axis=0)
    products = np.maximum(0.0, (forward * backward).sum(axis=0))
    return np.asarray(np.divide(products, squares, out=np.zeros(6), where=squares > 0.0))
