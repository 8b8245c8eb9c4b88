"""What the particles say joined with odometry, knowing that the former errs for long in the same way.

A Kalman filter of the pose and of the bias of the particles' pose (Friedland, *Treatment of bias in recursive
filtering*, 1969). The particles alone hold a scan against the map as if the next one erred anew, so in a few frames
they come to stand where depth's lasting error puts them. Here that error has a width of its own, which grows away
from the viewpoints that a room was built from: near them the map is followed, far from them odometry for a while.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from monoloc.filter.estimate import Estimate
from monoloc.filter.lasting import LastingErrors
from monoloc.filter.motion import MotionConfig, motion_sd
from monoloc.filter.viewpoints import STEP_M, Viewpoints
from monoloc.geometry import FloatArray, adjoint, invert, se3_exp, se3_log, viewpoints_apart
from monoloc.odometry import Motion

# What odometry errs by goes on for a second or so, and where the particles happen to be for some frames: taken for
# new in each frame, their deviations are so many times as large.
_ODOMETRY_TOGETHER, _PARTICLES_TOGETHER = 4.0, 2.0
# So long the bias is remembered without odometry. Motion is taken for new in every frame then, which it is not: in
# time, a steady flight would be taken for a bias.
_LONG_S = 1.0
_LATE_S = 1.0  # the way that the camera came within about so long is that on which particles came to err as they do
_LEAST_VARIANCE = 1e-10  # of a measurement, m^2 and rad^2: particles may all be one
_OBSERVED = np.hstack([np.eye(6), np.eye(6)])  # the particles' pose errs by the pose's error and by the bias


@dataclass(frozen=True)
class Joined:
    """The belief of pose and bias.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        bias: (6,) twist in the camera's frame: the particles' pose is ``pose @ exp(bias)``, but for their spread.
        covariance: (12, 12), of the pose's twist as in :class:`Estimate`, and of the bias.
        widths: standard deviations of a bias of which nothing were known, (6,), after the way so far.
    """

    pose: FloatArray
    bias: FloatArray
    covariance: FloatArray
    widths: FloatArray

    @classmethod
    def begin(cls, start: Estimate, widths: FloatArray) -> Joined:
        """Before the first scan: what is known of the pose, and the standard deviations of the bias there, (6,)."""
        covariance = np.zeros((12, 12))
        covariance[:6, :6], covariance[6:, 6:] = start.covariance, np.diag(widths**2)
        return cls(start.pose, np.zeros(6), covariance, widths)

    @classmethod
    def alone(cls, located: Estimate, widths: FloatArray) -> Joined:
        """By the particles' word and nothing else: the pose is off by as much as that is biased, the other way."""
        noise, fresh = _noise_of(located), np.diag(widths**2)
        return cls(located.pose, np.zeros(6), np.block([[noise + fresh, -fresh], [-fresh, fresh]]), widths)

    def moved(self, T_previous_current: FloatArray, noise: FloatArray, kept: float, widths: FloatArray) -> Joined:
        """After a motion: the pose goes along, and some of the bias is forgotten.

        Where depth errs more, the bias is wider at once; where it errs less, particles still bring along what they
        had, until that is forgotten.

        Args:
            T_previous_current: the motion, (4, 4).
            noise: its covariance, (6, 6), of a twist in the new camera's frame.
            kept: correlation of the bias here and before.
            widths: standard deviations of the bias where the camera is now, (6,).
        """
        brought = (kept * self.widths) ** 2
        variances = np.maximum(brought + (1.0 - kept**2) * widths**2, widths**2)
        carried = np.zeros((12, 12))
        carried[:6, :6], carried[6:, 6:] = adjoint(invert(T_previous_current)), kept * np.eye(6)
        covariance = carried @ self.covariance @ carried.T
        covariance[:6, :6] += noise
        covariance[6:, 6:] += np.diag(variances - brought)
        return Joined(self.pose @ T_previous_current, kept * self.bias, covariance, np.sqrt(variances))

    def told(self, located: Estimate) -> Joined:
        """After the particles' word, whose spread is noise."""
        innovation = se3_log(invert(self.pose) @ located.pose) - self.bias
        noise = _noise_of(located)
        spread = _OBSERVED @ self.covariance @ _OBSERVED.T + noise
        gain = np.linalg.solve(spread, _OBSERVED @ self.covariance).T
        correction = gain @ innovation
        left = np.eye(12) - gain @ _OBSERVED
        # Joseph's form stays symmetric and positive.
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return replace(
            self, pose=self.pose @ se3_exp(correction[:6]), bias=self.bias + correction[6:], covariance=covariance
        )

    def estimate(self, log_scale: float) -> Estimate:
        return Estimate(self.pose, self.covariance[:6, :6], log_scale)


def _noise_of(located: Estimate) -> FloatArray:
    """Covariance (6, 6) of what the particles say, but for their bias."""
    return np.asarray(_PARTICLES_TOGETHER**2 * located.covariance + _LEAST_VARIANCE * np.eye(6))


class Joiner:
    """Keeps the joined belief from frame to frame; call :meth:`step` with every frame in order.

    Args:
        start: what the particles know before the first frame.
        lasting: how wide the bias is, and over how far it lasts.
        noise: of the motions.
        viewpoints: that the room was built from, or none.

    Attributes:
        blind_s: for how long nothing has said where the camera is.
    """

    def __init__(self, start: Estimate, lasting: LastingErrors, noise: MotionConfig, viewpoints: Viewpoints) -> None:
        self._lasting = lasting
        self._noise = noise
        self._viewpoints = viewpoints
        self._joined = Joined.begin(start, self._widths(start.pose))
        self._located = start
        self._unmoved_s = 0.0  # for how long there has been no odometry
        self._way = np.zeros(6)  # of late, a twist in the camera's frame
        self.blind_s = 0.0

    def step(self, motion: Motion | None, elapsed_s: float, located: Estimate, is_told: bool) -> Estimate:
        """The belief at the next frame.

        Args:
            motion: odometry's since the frame before, None where there is none.
            elapsed_s: since the frame before; 0 at the first.
            located: what the particles say.
            is_told: whether this frame told the particles anything; what they knew before is not told again.
        """
        self._unmoved_s = self._unmoved_s + elapsed_s if motion is None else 0.0
        delta = self._delta(motion)
        # How far it went is known well enough from the particles, where odometry does not tell.
        gone = invert(self._located.pose) @ located.pose if motion is None else delta
        step_m = float(viewpoints_apart(np.eye(4), gone[None])[0])
        is_jump = motion is None and (elapsed_s == 0.0 or step_m > STEP_M)  # of the particles, not of the camera
        self._way = math.exp(-elapsed_s / _LATE_S) * self._way + (np.zeros(6) if is_jump else se3_log(gone))
        moved = self._moved(delta, motion, elapsed_s, step_m)
        if self._unmoved_s > _LONG_S and is_told:  # nothing is left to join it with
            self._joined = Joined.alone(located, np.maximum(moved.widths, self._widths(located.pose)))
        else:
            self._joined = moved.told(located) if is_told else moved
        self._located = located
        self.blind_s = 0.0 if is_told or motion is not None else self.blind_s + elapsed_s
        return self._joined.estimate(located.log_scale)

    def foreseen(self, elapsed_s: float) -> Estimate:
        """The belief at the next frame, where odometry tells nothing of it, before the particles do."""
        return self._moved(np.eye(4), None, elapsed_s, 0.0).estimate(self._located.log_scale)

    def corrected(self, located: Estimate) -> Estimate:
        """What the particles say, less what they were measured to err by at the viewpoints next to them.

        Away from those that counts by near errors' share of the variance.
        """
        share = self._lasting.near_share(self._viewpoints.distance_m(located.pose))
        known = self._viewpoints.error_at(located.pose, self._way)
        return replace(located, pose=located.pose @ se3_exp(-share * known))

    def rotation_sd(self, located: Estimate) -> float:
        """What the rotation that the particles say may be off by, rad an axis: their spread, and what lasts."""
        spread = float(np.trace(located.covariance[3:, 3:])) / 3.0
        lasting = max(self._widths(located.pose)[3], self._joined.widths[3])  # what was brought along, after a find
        return float(np.sqrt(lasting**2 + spread))

    def begin_anew(self, located: Estimate) -> Estimate:
        """The belief where the camera was found again: what was known before is forgotten."""
        widths = self._lasting.found_widths(self._viewpoints.distance_m(located.pose))
        self._joined = Joined.alone(located, widths)
        return self._joined.estimate(located.log_scale)

    def _delta(self, motion: Motion | None) -> FloatArray:
        delta = np.eye(4) if motion is None else motion.T_previous_current.copy()
        delta[:3, 3] *= np.exp(self._located.log_scale)  # its translation was measured in predicted depth
        return delta

    def _moved(self, delta: FloatArray, motion: Motion | None, elapsed_s: float, step_m: float) -> Joined:
        kept = self._lasting.kept(step_m)
        sd = motion_sd(motion, elapsed_s, self.blind_s, self._noise)
        if motion is not None:  # without one, it is already of frames that err together
            sd = _ODOMETRY_TOGETHER * sd
        return self._joined.moved(delta, np.diag(sd**2), kept, self._widths(self._joined.pose @ delta))

    def _widths(self, pose: FloatArray) -> FloatArray:
        """Standard deviations of the bias at a pose, (6,)."""
        return self._lasting.widths(self._viewpoints.distance_m(pose))
