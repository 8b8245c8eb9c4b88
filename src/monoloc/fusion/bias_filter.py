"""What particles and landmarks say joined with odometry, knowing that both err for long in the same way.

A Kalman filter of the pose and of the bias of the particles' pose (Friedland, *Treatment of bias in recursive
filtering*, 1969). The particles alone hold a scan against the map as if the next one erred anew, so in a few frames
they come to stand where depth's lasting error puts them. Here that error has a width of its own, which grows away
from the viewpoints that a room was built from: near them the map is followed, far from them odometry for a while.
Landmarks have such a bias of their own, which is narrower; while some are seen, they show what the particles' is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from monoloc.fusion.bias_model import LastingErrors
from monoloc.fusion.reference_poses import STEP_M, Viewpoints
from monoloc.geometry import FloatArray, adjoint, invert, se3_exp, se3_log, viewpoints_apart
from monoloc.landmarks.pnp import Sighting
from monoloc.odometry.visual import Motion
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

# What odometry errs by goes on for a second or so, and where the particles happen to be for some frames: taken for
# new in each frame, their deviations are so many times as large.
_ODOMETRY_TOGETHER, _PARTICLES_TOGETHER, _LANDMARKS_TOGETHER = 4.0, 2.0, 2.0
# So long the bias is remembered without odometry. Motion is taken for new in every frame then, which it is not: in
# time, a steady flight would be taken for a bias.
_LONG_S = 1.0
_LATE_S = 1.0  # the way that the camera came within about so long is that on which particles came to err as they do
_LEAST_VARIANCE = 1e-10  # of a measurement, m^2 and rad^2: particles may all be one
_UNLIKELY = 16.8  # squared, of six degrees of freedom: farther off than 99 of 100, a sighting counts for less
_PARTICLES, _LANDMARKS = 0, 1  # which say where the camera is, each with a bias of its own


@dataclass(frozen=True)
class Joined:
    """The belief of the pose, and of the biases of S sources that say where the camera is.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        biases: (S, 6) twists in the camera's frame: a source's pose is ``pose @ exp(bias)``, but for its noise.
        covariance: (6 + 6 S, 6 + 6 S), of the pose's twist as in :class:`Estimate`, and of the biases.
        widths: standard deviations of biases of which nothing were known, (S, 6), after the way so far.
    """

    pose: FloatArray
    biases: FloatArray
    covariance: FloatArray
    widths: FloatArray

    @classmethod
    def begin(cls, start: Estimate, widths: FloatArray) -> Joined:
        """Before the first scan: what is known of the pose, and the biases' standard deviations there, (S, 6)."""
        return cls(start.pose, np.zeros_like(widths), _apart(start.covariance, np.diag(widths.ravel() ** 2)), widths)

    @classmethod
    def alone(cls, located: Estimate, widths: FloatArray) -> Joined:
        """By the word of the first source and nothing else: the pose is off by as much as that, the other way."""
        noise, fresh = _noise_of(located), np.diag(widths[0] ** 2)
        covariance = _apart(noise + fresh, np.diag(widths.ravel() ** 2))
        covariance[:6, 6:12] = covariance[6:12, :6] = -fresh
        return cls(located.pose, np.zeros_like(widths), covariance, widths)

    def moved(self, T_previous_current: FloatArray, noise: FloatArray, kept: float, widths: FloatArray) -> Joined:
        """After a motion: the pose goes along, and some of the biases is forgotten.

        Where a source errs more, its bias is wider at once; where it errs less, it still brings along what it had,
        until that is forgotten.

        Args:
            T_previous_current: the motion, (4, 4).
            noise: its covariance, (6, 6), of a twist in the new camera's frame.
            kept: correlation of the biases here and before.
            widths: standard deviations of the biases where the camera is now, (S, 6).
        """
        brought = (kept * self.widths) ** 2
        variances = np.maximum(brought + (1.0 - kept**2) * widths**2, widths**2)
        carried = _apart(adjoint(invert(T_previous_current)), kept * np.eye(widths.size))
        covariance = carried @ self.covariance @ carried.T + _apart(noise, np.diag((variances - brought).ravel()))
        return Joined(self.pose @ T_previous_current, kept * self.biases, covariance, np.sqrt(variances))

    def told(self, located: Estimate) -> Joined:
        """After the particles' word, whose spread is noise."""
        return self._told(_PARTICLES, located.pose, _noise_of(located))

    def sighted(self, sighting: Sighting) -> Joined:
        """After that of the landmarks, for whose errors' slowness the second source's bias stands."""
        noise = _LANDMARKS_TOGETHER**2 * sighting.covariance + _LEAST_VARIANCE * np.eye(6)
        innovation, spread = self._innovation(_LANDMARKS, sighting.pose, noise)
        surprise = float(innovation @ np.linalg.solve(spread, innovation)) / _UNLIKELY
        return self._told(_LANDMARKS, sighting.pose, max(1.0, surprise) * noise)

    def _told(self, source: int, pose: FloatArray, noise: FloatArray) -> Joined:
        """After a source's word, ``T_world_camera`` (4, 4), with its noise, (6, 6)."""
        innovation, spread = self._innovation(source, pose, noise)
        observed = self._observed(source)
        gain = np.linalg.solve(spread, observed @ self.covariance).T
        correction = gain @ innovation
        left = np.eye(len(self.covariance)) - gain @ observed
        # Joseph's form stays symmetric and positive.
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        biases = self.biases + correction[6:].reshape(-1, 6)
        return replace(self, pose=self.pose @ se3_exp(correction[:6]), biases=biases, covariance=covariance)

    def _innovation(self, source: int, pose: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What a source's word says beyond what was expected of it, (6,), and how much that may be, (6, 6)."""
        observed = self._observed(source)
        innovation: FloatArray = se3_log(invert(self.pose) @ pose) - self.biases[source]
        return innovation, observed @ self.covariance @ observed.T + noise

    def _observed(self, source: int) -> FloatArray:
        """A source's word errs by the pose's error and by its bias: (6, 6 + 6 S)."""
        observed = np.zeros((6, len(self.covariance)))
        observed[:, :6] = observed[:, 6 + 6 * source :][:, :6] = np.eye(6)
        return observed

    def estimate(self, log_scale: float) -> Estimate:
        return Estimate(self.pose, self.covariance[:6, :6], log_scale)


def _apart(first: FloatArray, second: FloatArray) -> FloatArray:
    """Two square matrices on the diagonal of one."""
    size = len(first) + len(second)
    both = np.zeros((size, size))
    both[: len(first), : len(first)], both[len(first) :, len(first) :] = first, second
    return both


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
        sighted: how wide the bias of what landmarks say is.

    Attributes:
        blind_s: for how long nothing has said where the camera is.
    """

    def __init__(
        self,
        start: Estimate,
        lasting: LastingErrors,
        noise: MotionConfig,
        viewpoints: Viewpoints,
        sighted: LastingErrors = LastingErrors(),
    ) -> None:
        self._lasting, self._sighted = lasting, sighted
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

    def sighted(self, sighting: Sighting) -> Estimate:
        """The belief after what landmarks say of the same frame."""
        self._joined = self._joined.sighted(sighting)
        self.blind_s = self._unmoved_s = 0.0
        return self._joined.estimate(self._located.log_scale)

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
        lasting = max(
            self._widths(located.pose)[_PARTICLES, 3], self._joined.widths[_PARTICLES, 3]
        )  # what was brought along, after a find
        return float(np.sqrt(lasting**2 + spread))

    def begin_anew(self, located: Estimate) -> Estimate:
        """The belief where the camera was found again: what was known before is forgotten."""
        widths = self._widths(located.pose)
        widths[_PARTICLES] = self._lasting.found_widths(self._viewpoints.distance_m(located.pose))
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
        """Standard deviations of the biases at a pose, (S, 6)."""
        distance_m = self._viewpoints.distance_m(pose)
        return np.stack([self._lasting.widths(distance_m), self._sighted.widths(distance_m)])
