"""What the particles say joined with odometry, knowing that the former errs for long in the same way.

A Kalman filter of the pose and of the bias of the particles' pose (Friedland, *Treatment of bias in recursive
filtering*, 1969). The particles alone hold a scan against the map as if the next one erred anew, so in a few frames
they come to stand where depth's lasting error puts them. Here that error has a width of its own, which grows away
from the viewpoints that a room was built from: near them the map is followed, far from them odometry for a while.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.filter.estimate import Estimate
from monoloc.filter.lasting import LastingErrors
from monoloc.geometry import FloatArray, adjoint, invert, se3_exp, se3_log, viewpoints_apart

# What odometry errs by, and where the particles happen to be, goes on for some frames: taken for new in each, its
# deviation is twice as large.
_TOGETHER = 2.0
_LEAST_VARIANCE = 1e-10  # of a measurement, m^2 and rad^2: particles may all be one
_OBSERVED = np.hstack([np.eye(6), np.eye(6)])  # the particles' pose errs by the pose's error and by the bias


@dataclass(frozen=True)
class Joined:
    """The belief of pose and bias.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        bias: (6,) twist in the camera's frame: the particles' pose is ``pose @ exp(bias)``, but for their spread.
        covariance: (12, 12), of the pose's twist as in :class:`Estimate`, and of the bias.
    """

    pose: FloatArray
    bias: FloatArray
    covariance: FloatArray

    @classmethod
    def begin(cls, start: Estimate, lasting: LastingErrors, distance_m: float) -> Joined:
        """Before the first scan.

        Args:
            start: what is known of the pose.
            lasting: how wide the bias is, so far from where the room was built from.
        """
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = start.covariance, lasting.covariance(distance_m)
        return cls(start.pose, np.zeros(6), covariance)

    def moved(
        self, T_previous_current: FloatArray, noise: FloatArray, lasting: LastingErrors, distance_m: float
    ) -> Joined:
        """After a motion: the pose goes along, and the bias is forgotten by as much as the view has changed.

        Args:
            T_previous_current: the motion, (4, 4).
            noise: its covariance, (6, 6), of a twist in the new camera's frame.
            lasting: how wide a new bias is, so far from where the room was built from.
        """
        kept = lasting.kept(float(viewpoints_apart(np.eye(4), T_previous_current[None])[0]))
        carried = np.zeros((12, 12))
        carried[:6, :6], carried[6:, 6:] = adjoint(invert(T_previous_current)), kept * np.eye(6)
        covariance = carried @ self.covariance @ carried.T
        covariance[:6, :6] += _TOGETHER**2 * noise
        covariance[6:, 6:] += (1.0 - kept**2) * lasting.covariance(distance_m)
        return Joined(self.pose @ T_previous_current, kept * self.bias, covariance)

    def told(self, located: Estimate) -> Joined:
        """After the particles' word, whose spread is noise."""
        innovation = se3_log(invert(self.pose) @ located.pose) - self.bias
        noise = _TOGETHER**2 * located.covariance + _LEAST_VARIANCE * np.eye(6)
        spread = _OBSERVED @ self.covariance @ _OBSERVED.T + noise
        gain = np.linalg.solve(spread, _OBSERVED @ self.covariance).T
        correction = gain @ innovation
        left = np.eye(12) - gain @ _OBSERVED
        # Joseph's form stays symmetric and positive.
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return Joined(self.pose @ se3_exp(correction[:6]), self.bias + correction[6:], covariance)

    def estimate(self, log_scale: float) -> Estimate:
        return Estimate(self.pose, self.covariance[:6, :6], log_scale)
