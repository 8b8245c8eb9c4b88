"""The belief: a Kalman filter over the pose and the slowly varying biases of what measures it.

Bias augmentation after Friedland, *Treatment of bias in recursive filtering* (1969). The particle filter treats the
depth errors of consecutive frames as independent, so within a few frames its particles gather where the depth's bias
puts them, and their spread says nothing of it. Here that bias is part of the state. Its standard deviation grows with
the distance from the reference poses (:mod:`monoloc.fusion.bias_model`): near them the map dominates, far from them
odometry does for a while. Landmark poses have a bias of their own, a smaller one; while landmarks are seen, they
reveal the bias of the particles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import MOST_STEP_M, ReferencePoses
from monoloc.geometry import FloatArray, adjoint, invert, pose_distance_m, se3_exp, se3_log
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.odometry.motion import Motion, tracks_translation
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.motion_model import MotionConfig, motion_sd

# Errors of odometry are correlated for a second or so, those of particles and landmarks for some frames. Treated as
# independent from frame to frame, their standard deviations are inflated by these factors.
_ODOMETRY_INFLATION, _PARTICLE_INFLATION, _LANDMARK_INFLATION = 4.0, 2.0, 2.0
# Landmarks of one surface are misplaced together: however many are seen, they count as so many at most.
_INDEPENDENT_LANDMARKS = 20
# Without odometry for longer than this, the biases are forgotten: the motion model's noise is not independent from
# frame to frame, and the filter would take a steady flight for a bias.
_MOST_TIME_WITHOUT_ODOMETRY_S = 1.0
_RECENT_MOTION_S = 1.0  # time constant of the recent motion, which selects the known bias
_LEAST_VARIANCE = 1e-10  # of a measurement, m^2 and rad^2: all particles may be one
_GATE = 16.8  # chi-squared, 6 degrees of freedom, 99 %: a measured pose beyond it is down-weighted
_CONTRADICTION, _DECISIVE = 4.0, 20  # times the gate, and landmarks: beyond these the belief starts anew
_PARTICLES, _LANDMARKS = 0, 1  # the sources, each with its bias
# Of odometry's translation, that particles do not tell: predicted depth is wrong by a factor for seconds.
_LOG_SCALE_SD, _LOG_SCALE_TIME_S = 0.2, 5.0


@dataclass(frozen=True)
class BiasAugmentedState:
    """Pose, and biases of S sources that measure it.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        biases: (S, 6) twists in the camera's frame: source s measures ``pose @ exp(biases[s])`` plus noise.
        log_scale: natural logarithm of true over measured translation of the odometry.
        covariance: (7 + 6 S, 7 + 6 S) of the pose's twist, as in :class:`Estimate`, of the biases, and of the
            log-scale.
        prior_sds: (S, 6) standard deviations of biases that no measurement has corrected, after the motion so far.
    """

    pose: FloatArray
    biases: FloatArray
    log_scale: float
    covariance: FloatArray
    prior_sds: FloatArray

    @classmethod
    def from_start(cls, start: Estimate, prior_sds: FloatArray) -> BiasAugmentedState:
        """Before the first measurement: pose and biases are independent."""
        covariance = _block_diagonal(start.covariance, _prior_covariance(prior_sds))
        return cls(start.pose, np.zeros_like(prior_sds), 0.0, covariance, prior_sds)

    @classmethod
    def from_measurement(
        cls, source: int, pose: FloatArray, noise: FloatArray, prior_sds: FloatArray
    ) -> BiasAugmentedState:
        """From one source's pose (4, 4) and nothing else: the pose's error is minus its bias, plus noise (6, 6)."""
        bias = np.diag(prior_sds[source] ** 2)
        covariance = _block_diagonal(noise + bias, _prior_covariance(prior_sds))
        own = slice(6 + 6 * source, 12 + 6 * source)
        covariance[:6, own] = covariance[own, :6] = -bias
        return cls(pose, np.zeros_like(prior_sds), 0.0, covariance, prior_sds)

    def predict(
        self,
        T_previous_current: FloatArray,
        noise: FloatArray,
        correlation: float,
        prior_sds: FloatArray,
        by_log_scale: FloatArray = np.zeros(6),
        scale_correlation: float = 1.0,
    ) -> BiasAugmentedState:
        """After a motion: the pose moves along, and the biases decay.

        Where a source's bias is larger, its variance grows at once; where it is smaller, the old bias lasts until it
        has decayed.

        Args:
            T_previous_current: the motion, (4, 4).
            noise: its covariance, (6, 6), of a twist in the new camera's frame.
            correlation: of the biases before and after the motion.
            prior_sds: (S, 6) at the new pose.
            by_log_scale: derivative of the motion by the log-scale, a twist (6,) in the new camera's frame.
            scale_correlation: of the log-scale before and after the motion.
        """
        remaining = (correlation * self.prior_sds) ** 2
        variances = np.maximum(remaining + (1.0 - correlation**2) * prior_sds**2, prior_sds**2)
        decay = np.append(np.full(prior_sds.size, correlation), scale_correlation)
        transition = _block_diagonal(adjoint(invert(T_previous_current)), np.diag(decay))
        transition[:6, -1] = by_log_scale
        scale_variance = (1.0 - scale_correlation**2) * _LOG_SCALE_SD**2
        process_noise = _block_diagonal(noise, np.diag(np.append((variances - remaining).ravel(), scale_variance)))
        covariance = transition @ self.covariance @ transition.T + process_noise
        pose, log_scale = self.pose @ T_previous_current, scale_correlation * self.log_scale
        return BiasAugmentedState(pose, correlation * self.biases, log_scale, covariance, np.sqrt(variances))

    def update_from_particles(self, measured: Estimate) -> BiasAugmentedState:
        """After the particles' pose; their spread is its noise. One beyond the gate counts less, as for landmarks."""
        return self._gated_update(_PARTICLES, measured.pose, _particle_noise(measured))

    def update_from_landmarks(self, measured: LandmarkPose) -> BiasAugmentedState:
        """After a landmark pose; one of few landmarks beyond the gate gets its noise inflated until it lies on it."""
        noise = _landmark_noise(measured)
        if len(measured.points) >= _DECISIVE:
            return self._update(_LANDMARKS, measured.pose, noise)
        return self._gated_update(_LANDMARKS, measured.pose, noise)

    def landmark_excess(self, measured: LandmarkPose) -> float:
        """How far a landmark pose is from the expected one: above 1 it is beyond the gate."""
        return self._excess(_LANDMARKS, measured.pose, _landmark_noise(measured))

    def _excess(self, source: int, pose: FloatArray, noise: FloatArray) -> float:
        innovation, covariance = self._innovation(source, pose, noise)
        return float(innovation @ np.linalg.solve(covariance, innovation)) / _GATE

    def _gated_update(self, source: int, pose: FloatArray, noise: FloatArray) -> BiasAugmentedState:
        return self._update(source, pose, max(1.0, self._excess(source, pose, noise)) * noise)

    def _update(self, source: int, pose: FloatArray, noise: FloatArray) -> BiasAugmentedState:
        """The Kalman update with a source's ``T_world_camera`` (4, 4) and its noise (6, 6)."""
        innovation, innovation_covariance = self._innovation(source, pose, noise)
        H = self._observation_matrix(source)
        gain = np.linalg.solve(innovation_covariance, H @ self.covariance).T
        correction = gain @ innovation
        remaining = np.eye(len(self.covariance)) - gain @ H
        # Joseph's form stays symmetric and positive.
        covariance = remaining @ self.covariance @ remaining.T + gain @ noise @ gain.T
        return replace(
            self,
            pose=self.pose @ se3_exp(correction[:6]),
            biases=self.biases + correction[6:-1].reshape(-1, 6),
            log_scale=self.log_scale + float(correction[-1]),
            covariance=covariance,
        )

    def _innovation(self, source: int, pose: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Measured minus expected twist, (6,), and its covariance, (6, 6)."""
        H = self._observation_matrix(source)
        innovation: FloatArray = se3_log(invert(self.pose) @ pose) - self.biases[source]
        return innovation, H @ self.covariance @ H.T + noise

    def _observation_matrix(self, source: int) -> FloatArray:
        """A source observes the pose's error plus its own bias: (6, 7 + 6 S)."""
        H = np.zeros((6, len(self.covariance)))
        H[:, :6] = H[:, 6 + 6 * source :][:, :6] = np.eye(6)
        return H

    def estimate(self, log_scale: float) -> Estimate:
        return Estimate(self.pose, self.covariance[:6, :6], log_scale)


def _block_diagonal(first: FloatArray, second: FloatArray) -> FloatArray:
    size = len(first) + len(second)
    both = np.zeros((size, size))
    both[: len(first), : len(first)], both[len(first) :, len(first) :] = first, second
    return both


def _prior_covariance(prior_sds: FloatArray) -> FloatArray:
    """Of biases (S, 6) and log-scale that no measurement has corrected: (6 S + 1, 6 S + 1)."""
    return np.diag(np.append(prior_sds.ravel(), _LOG_SCALE_SD) ** 2)


def _particle_noise(measured: Estimate) -> FloatArray:
    """Covariance (6, 6) of the particles' pose without its bias."""
    return np.asarray(_PARTICLE_INFLATION**2 * measured.covariance + _LEAST_VARIANCE * np.eye(6))


def _landmark_noise(measured: LandmarkPose) -> FloatArray:
    """Covariance (6, 6) of a landmark pose without its bias."""
    return np.asarray(_landmark_factor(measured) * measured.covariance + _LEAST_VARIANCE * np.eye(6))


def _landmark_factor(measured: LandmarkPose) -> float:
    """Of the variance that the corners' localisation error gives a landmark pose."""
    return _LANDMARK_INFLATION**2 * max(1.0, len(measured.points) / _INDEPENDENT_LANDMARKS)


class BiasAugmentedFilter:
    """Holds the belief of one camera and is the only one to change it.

    A frame is :meth:`predict`, then :meth:`update_from_particles`, then :meth:`update_from_landmarks`.

    Args:
        start: the belief before the first frame.
        particle_bias, landmark_bias: of the two sources.
        noise: of the motions.
        reference_poses: of the room, or none.

    Attributes:
        restarted: whether the belief started anew at this frame, so that the pose may jump.
        time_since_update_s: since odometry, particles or landmarks last constrained the pose.
    """

    def __init__(
        self,
        start: Estimate,
        particle_bias: BiasModel,
        noise: MotionConfig,
        reference_poses: ReferencePoses,
        landmark_bias: BiasModel = BiasModel(),
    ) -> None:
        self._particle_bias, self._landmark_bias = particle_bias, landmark_bias
        self._noise = noise
        self._reference_poses = reference_poses
        self._state = BiasAugmentedState.from_start(start, self._prior_sds(start.pose))
        self._measured = start  # by the particles, last
        self._time_since_odometry_s = 0.0
        self._recent_motion = np.zeros(6)  # a twist in the camera's frame
        self.time_since_update_s = 0.0
        self.restarted = False

    @property
    def belief(self) -> Estimate:
        return self._state.estimate(self._measured.log_scale)

    def predict(self, motion: Motion | None, elapsed_s: float, measured: Estimate) -> Estimate:
        """The belief after the motion since the previous frame.

        Args:
            motion: of the odometry, None where it has none. One of which only the rotation is known turns the belief,
                and counts as none in everything else.
            elapsed_s: since the previous frame; 0 at the first.
            measured: pose of the particles at this frame, whose motion selects the bias where odometry has none.
        """
        self.restarted = False
        is_tracked = tracks_translation(motion)
        self._time_since_odometry_s = 0.0 if is_tracked else self._time_since_odometry_s + elapsed_s
        delta = self._scaled(motion)
        moved = delta if is_tracked else invert(self._measured.pose) @ measured.pose
        step_m = float(pose_distance_m(np.eye(4), moved[None])[0])
        is_jump = not is_tracked and (elapsed_s == 0.0 or step_m > MOST_STEP_M)  # of the particles, not the camera
        decay = math.exp(-elapsed_s / _RECENT_MOTION_S)
        self._recent_motion = decay * self._recent_motion + (np.zeros(6) if is_jump else se3_log(moved))
        self._state = self._predicted(delta, motion, elapsed_s, step_m)
        self._measured = measured
        self.time_since_update_s = 0.0 if is_tracked else self.time_since_update_s + elapsed_s
        return self.belief

    def update_from_particles(self, measured: Estimate) -> Estimate:
        """The belief after the particles' pose.

        After a second without odometry it starts anew there, or widens on where particles tell no position.
        """
        updated = self._state.update_from_particles(measured)
        if self._time_since_odometry_s > _MOST_TIME_WITHOUT_ODOMETRY_S:
            updated = self._from_particles(measured)
            if updated.estimate(measured.log_scale).position_is_unknown:
                return self.belief
        self._state = updated
        self.time_since_update_s = 0.0
        return self.belief

    def _from_particles(self, measured: Estimate) -> BiasAugmentedState:
        prior_sds = np.maximum(self._state.prior_sds, self._prior_sds(measured.pose))
        noise = _particle_noise(measured)
        return BiasAugmentedState.from_measurement(_PARTICLES, measured.pose, noise, prior_sds)

    def update_from_landmarks(self, measured: LandmarkPose) -> Estimate:
        """The belief after the landmark pose of the same frame.

        A belief that is contradicted far beyond its covariance starts anew at the landmarks: dozens of corners that
        agree on one pose are not wrong together. Far from the reference poses they can be, as the bias there says.
        """
        widened = self._with_bias_of_its_place(measured)
        if self._state.landmark_excess(widened) > _CONTRADICTION and len(measured.points) >= _DECISIVE:
            return self.reinitialise_from_landmarks(measured)
        self._state = self._state.update_from_landmarks(widened)
        self.time_since_update_s = self._time_since_odometry_s = 0.0
        return self.belief

    def _with_bias_of_its_place(self, measured: LandmarkPose) -> LandmarkPose:
        """A landmark pose whose noise has what its bias is wider there than at the belief, where the state has it."""
        there, here = self._prior_sds(measured.pose)[_LANDMARKS], self._state.prior_sds[_LANDMARKS]
        further = np.diag(np.maximum(there**2 - here**2, 0.0)) / _landmark_factor(measured)
        return replace(measured, covariance=measured.covariance + further)

    def reinitialise_from_landmarks(self, measured: LandmarkPose) -> Estimate:
        """The belief after landmarks relocalised the camera: only their pose counts."""
        noise, prior_sds = _landmark_noise(measured), self._prior_sds(measured.pose)
        self._state = BiasAugmentedState.from_measurement(_LANDMARKS, measured.pose, noise, prior_sds)
        self.restarted = True
        self.time_since_update_s = self._time_since_odometry_s = 0.0
        return self.belief

    def contradicts(self, measured: Estimate, landmark_pose: LandmarkPose | None) -> bool:
        """Whether the particles' pose is farther from the landmarks', or else from the belief, than errors allow.

        The particles' bias is the usual one: as it has been estimated, it follows them wherever they go.
        """
        measured = self.without_known_bias(measured)
        reference, covariance = self._state.pose, self._state.covariance[:6, :6]
        if landmark_pose is not None:
            reference = landmark_pose.pose
            covariance = _landmark_noise(landmark_pose) + np.diag(self._prior_sds(reference)[_LANDMARKS] ** 2)
        covariance = covariance + _particle_noise(measured) + np.diag(self._prior_sds(reference)[_PARTICLES] ** 2)
        offset = se3_log(invert(reference) @ measured.pose)
        return float(offset @ np.linalg.solve(covariance, offset)) > _GATE

    def reinitialise(self, measured: Estimate) -> Estimate:
        """The belief after scans relocalised the camera: only the particles' pose counts."""
        prior_sds = self._prior_sds(measured.pose)
        prior_sds[_PARTICLES] = self._particle_bias.relocalization_sds(
            self._reference_poses.distance_m(measured.pose)
        )
        noise = _particle_noise(measured)
        self._state = BiasAugmentedState.from_measurement(_PARTICLES, measured.pose, noise, prior_sds)
        self.restarted = True
        self.time_since_update_s = 0.0
        return self.belief

    def predicted(self, motion: Motion | None, elapsed_s: float) -> Estimate:
        """What the belief would be after a motion; the belief does not change."""
        delta = self._scaled(motion)
        step_m = float(pose_distance_m(np.eye(4), delta[None])[0])
        return self._predicted(delta, motion, elapsed_s, step_m).estimate(self._measured.log_scale)

    def without_known_bias(self, measured: Estimate) -> Estimate:
        """The particles' pose less its bias at the nearest reference poses.

        Away from them, the known bias counts by its share of the variance.
        """
        share = self._particle_bias.reference_variance_share(self._reference_poses.distance_m(measured.pose))
        known = self._reference_poses.bias_at(measured.pose, self._recent_motion)
        return replace(measured, pose=measured.pose @ se3_exp(-share * known))

    def rotation_sd(self, measured: Estimate) -> float:
        """Standard deviation of the particles' rotation, rad an axis, by their spread and bias."""
        variance = float(np.trace(measured.covariance[3:, 3:])) / 3.0
        here, remaining = self._prior_sds(measured.pose), self._state.prior_sds
        bias = max(here[_PARTICLES, 3], remaining[_PARTICLES, 3])
        return float(np.sqrt(bias**2 + variance))

    def _scaled(self, motion: Motion | None) -> FloatArray:
        """A motion, (4, 4), with its translation in metres, also if it was measured in predicted depth."""
        delta = np.eye(4) if motion is None else motion.T_previous_current.copy()
        if motion is not None and motion.translation == "scaled":
            delta[:3, 3] *= np.exp(self._measured.log_scale + self._state.log_scale)
        return delta

    def _predicted(
        self, delta: FloatArray, motion: Motion | None, elapsed_s: float, step_m: float
    ) -> BiasAugmentedState:
        sd = motion_sd(motion, elapsed_s, self.time_since_update_s, self._noise)
        # Without odometry, the noise already is that of correlated frames.
        sd[:3] *= _ODOMETRY_INFLATION if tracks_translation(motion) else 1.0
        sd[3:] *= _ODOMETRY_INFLATION if motion is not None else 1.0
        by_log_scale = np.zeros(6)
        if motion is not None and motion.translation == "scaled":
            by_log_scale[:3] = delta[:3, :3].T @ delta[:3, 3]
        return self._state.predict(
            delta,
            np.diag(sd**2),
            self._particle_bias.correlation(step_m),
            self._prior_sds(self._state.pose @ delta),
            by_log_scale,
            math.exp(-elapsed_s / _LOG_SCALE_TIME_S),
        )

    def _prior_sds(self, pose: FloatArray) -> FloatArray:
        """Standard deviations of the sources' biases at a pose, (S, 6)."""
        distance_m = self._reference_poses.distance_m(pose)
        return np.stack([self._particle_bias.sds(distance_m), self._landmark_bias.sds(distance_m)])
