"""The belief: a Kalman filter over the pose and the slowly varying biases of what measures it.

Bias augmentation after Friedland, *Treatment of bias in recursive filtering* (1969). The particle filter treats the
depth errors of consecutive frames as independent, so within a few frames its particles gather where the depth's bias
puts them, and their spread does not show it. Here that bias is part of the state. Its standard deviation grows with
the distance from the reference poses (:mod:`monoloc.fusion.bias_model`): near them the map dominates, far from them
odometry does for a while. Landmark poses have a bias of their own, a smaller one; while landmarks are seen, they
reveal the bias of the particles.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from monoloc.fusion.bias_model import BiasModel, LandmarkBiasModel
from monoloc.fusion.bias_state import (
    GATE,
    LANDMARKS,
    PARTICLES,
    BiasAugmentedState,
    particle_noise,
)
from monoloc.fusion.reference_poses import MOST_STEP_M, ReferencePoses
from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_exp, se3_log
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.odometry.motion import Motion, tracks_translation
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.frame_share import share_of_frame
from monoloc.particle_filter.motion_model import MotionConfig, few_corners_factor, motion_sd

# Errors of odometry are correlated for a second or so. Treated as independent from frame to frame, their standard
# deviations are inflated by this factor.
_ODOMETRY_INFLATION = 4.0
_VIEW_INFLATION = 3.4  # of the noise by the shape of the view, as measured over eight steps in a row
# Without odometry for longer than this, the biases are forgotten: the motion model's noise is not independent from
# frame to frame, and the filter would take a steady flight for a bias.
_MOST_TIME_WITHOUT_ODOMETRY_S = 1.0
_RECENT_MOTION_S = 1.0  # time constant of the recent motion, which selects the known bias
_DECISIVE_LANDMARKS = 20  # so many that agree are not down-weighted
_CONTRADICTION = 4.0  # times the gate: beyond it, decisive landmarks begin the belief anew
# Landmark poses of nearby views have nearly the same errors. After this pose distance one counts fully; after less,
# the variance of its noise is as much larger. A camera that hovers counts as moving by the frame.
_NEW_ERRORS_M, _LEAST_NEW_M = 0.1, 0.1 / 16.0
_LOG_SCALE_TIME_S = 5.0  # for which predicted depth is wrong by one factor


def decayed(recent_motion: FloatArray, elapsed_s: float) -> FloatArray:
    """What is left of a recent motion, a twist (6,), after some seconds; it selects the known bias."""
    return math.exp(-elapsed_s / _RECENT_MOTION_S) * recent_motion


class BiasAugmentedFilter:
    """Holds the belief of one camera and is the only one to change it.

    A frame is :meth:`predict`, then :meth:`update_from_particles`, then :meth:`update_from_landmarks`.

    Args:
        start: the belief before the first frame.
        particle_bias, landmark_bias: of the two sources.
        noise: of the motions.
        reference_poses: of the room, or none.
        is_memoryless: whether each frame's belief is the particles' pose, then that of landmarks, whatever was
            believed before.

    Attributes:
        restarted: whether the belief started anew at this frame, so that the pose may jump. Of a belief that starts
            anew at every frame, as without odometry, only the first counts.
        landmarks_contradict: whether this frame's landmark pose is beyond the gate of the belief before it.
        time_since_update_s: since odometry, particles or landmarks last constrained the pose.
    """

    def __init__(
        self,
        start: Estimate,
        particle_bias: BiasModel,
        noise: MotionConfig,
        reference_poses: ReferencePoses,
        landmark_bias: LandmarkBiasModel = LandmarkBiasModel(),
        is_memoryless: bool = False,
    ) -> None:
        self._particle_bias, self._landmark_bias = particle_bias, landmark_bias
        self._noise = noise
        self._reference_poses = reference_poses
        self._is_memoryless = is_memoryless
        self._state = BiasAugmentedState.from_start(start, self._prior_sds(start.pose))
        self._measured = start  # by the particles, last
        self._time_since_odometry_s = 0.0
        self._follows_particles = False  # for want of odometry
        self._recent_motion = np.zeros(6)  # a twist in the camera's frame
        # Pose distance and time since landmarks last moved the belief, as far as they are known.
        self._moved_m = self._since_landmarks_s = math.inf
        self.time_since_update_s = 0.0
        self.restarted = self.landmarks_contradict = False

    @property
    def belief(self) -> Estimate:
        return self._state.estimate(self._measured.log_scale)

    def stated(self) -> Estimate:
        """The belief with a covariance that allows for more than the filter's own.

        Away from the reference poses the particles' bias may be larger. In directions that the view hardly
        determines, odometry is less accurate, and landmark poses have the same error for many frames. Only the user
        gets this covariance. The filter goes on with its own, by which particles and odometry count for more beside
        landmarks that are wrong.
        """
        sds = self._particle_bias.stated_sds(self._reference_poses.distance_m(self._state.pose))
        return replace(self.belief, covariance=self._state.stated_covariance(PARTICLES, sds))

    def predict(self, motion: Motion | None, elapsed_s: float, measured: Estimate) -> Estimate:
        """The belief after the motion since the previous frame.

        Args:
            motion: of the odometry, None where it has none. One of which only the rotation is known turns the belief,
                and counts as none in everything else.
            elapsed_s: since the previous frame; 0 at the first.
            measured: pose of the particles at this frame, whose motion selects the bias where odometry has none.
        """
        self.restarted = self.landmarks_contradict = False
        is_tracked = tracks_translation(motion)
        self._time_since_odometry_s = 0.0 if is_tracked else self._time_since_odometry_s + elapsed_s
        self._follows_particles &= not is_tracked
        delta = self._scaled(motion)
        moved = delta if is_tracked else invert(self._measured.pose) @ measured.pose
        step_m = float(pose_distance_m(np.eye(4), moved[None])[0])
        is_jump = not is_tracked and (elapsed_s == 0.0 or step_m > MOST_STEP_M)  # of the particles, not the camera
        self._recent_motion = decayed(self._recent_motion, elapsed_s) + (np.zeros(6) if is_jump else se3_log(moved))
        self._moved_m += step_m if is_tracked else math.inf
        self._since_landmarks_s += elapsed_s
        self._state = self._predicted(delta, motion, elapsed_s, step_m)
        self._measured = measured
        self.time_since_update_s = 0.0 if is_tracked else self.time_since_update_s + elapsed_s
        return self.belief

    def update_from_particles(self, measured: Estimate) -> Estimate:
        """The belief after the particles' pose.

        After a second without odometry it starts anew there, or goes on widening if they do not determine a position.
        """
        updated = self._state.update_from_particles(measured)
        if self._is_memoryless:
            updated = self._from_particles(measured)
            self._moved_m = math.inf  # no landmark pose is left in the belief
        elif self._time_since_odometry_s > _MOST_TIME_WITHOUT_ODOMETRY_S:
            updated = self._from_particles(measured)
            if updated.estimate(measured.log_scale).position_is_unknown:
                return self.belief
            self.restarted = not self._follows_particles
            self._follows_particles = True
        self._state = updated
        self.time_since_update_s = 0.0
        return self.belief

    def _from_particles(self, measured: Estimate) -> BiasAugmentedState:
        prior_sds = np.maximum(self._state.prior_sds, self._prior_sds(measured.pose))
        noise = particle_noise(measured)
        return BiasAugmentedState.from_measurement(PARTICLES, measured.pose, noise, prior_sds)

    def update_from_landmarks(self, measured: LandmarkPose) -> Estimate:
        """The belief after the landmark pose of the same frame.

        A belief that is contradicted far beyond its covariance starts anew at the landmarks: dozens of corners that
        agree on one pose are not wrong together. Far from the reference poses they can be; the bias there allows for
        it.
        """
        is_decisive = len(measured.points) >= _DECISIVE_LANDMARKS
        least_m = share_of_frame(self._since_landmarks_s) * _LEAST_NEW_M
        share_new = np.clip(self._moved_m, least_m, _NEW_ERRORS_M) / _NEW_ERRORS_M
        noise_of_one = self._landmark_noise(measured)
        noise = (noise_of_one + self._wider_bias(measured)) / share_new
        excess = self._state.landmark_excess(measured.pose, noise)
        self.landmarks_contradict = excess > 1.0
        if is_decisive and excess > _CONTRADICTION:
            return self.reinitialise_from_landmarks(measured)
        self._state = self._state.update_from_landmarks(measured.pose, noise, is_decisive, noise_of_one)
        self._moved_m = self._since_landmarks_s = 0.0
        self.time_since_update_s = self._time_since_odometry_s = 0.0
        return self.belief

    def _wider_bias(self, measured: LandmarkPose) -> FloatArray:
        """Covariance (6, 6) by which the landmarks' bias is wider at their pose than at the belief, which has it."""
        there, here = self._prior_sds(measured.pose)[LANDMARKS], self._state.prior_sds[LANDMARKS]
        return np.diag(np.maximum(there**2 - here**2, 0.0))

    def _landmark_noise(self, measured: LandmarkPose) -> FloatArray:
        distance_m = self._reference_poses.distance_m(measured.pose)
        return self._landmark_bias.covariance(measured, distance_m)

    def reinitialise_from_landmarks(self, measured: LandmarkPose) -> Estimate:
        """The belief after landmarks relocalised the camera: only their pose counts."""
        noise, prior_sds = self._landmark_noise(measured), self._prior_sds(measured.pose)
        self._state = BiasAugmentedState.from_measurement(LANDMARKS, measured.pose, noise, prior_sds)
        self.restarted = True
        self._moved_m = self._since_landmarks_s = 0.0
        self.time_since_update_s = self._time_since_odometry_s = 0.0
        return self.belief

    def contradicts(self, measured: Estimate, landmark_pose: LandmarkPose | None) -> bool:
        """Whether the particles' pose is farther from the landmarks', or else from the belief, than errors allow.

        The particles' bias is the usual one: as it has been estimated, it follows them wherever they go.
        """
        reference, covariance = self._state.pose, self._state.covariance[:6, :6]
        if landmark_pose is not None:
            reference = landmark_pose.pose
            covariance = self._landmark_noise(landmark_pose) + np.diag(self._prior_sds(reference)[LANDMARKS] ** 2)
        measured = self.without_known_bias(measured, reference)
        covariance = covariance + particle_noise(measured) + np.diag(self._prior_sds(reference)[PARTICLES] ** 2)
        offset = se3_log(invert(reference) @ measured.pose)
        return float(offset @ np.linalg.solve(covariance, offset)) > GATE

    def reinitialise(self, measured: Estimate) -> Estimate:
        """The belief after scans relocalised the camera: only the particles' pose counts."""
        prior_sds = self._prior_sds(measured.pose)
        prior_sds[PARTICLES] = self._particle_bias.relocalization_sds(self._reference_poses.distance_m(measured.pose))
        noise = particle_noise(measured)
        self._state = BiasAugmentedState.from_measurement(PARTICLES, measured.pose, noise, prior_sds)
        self._moved_m = math.inf
        self.restarted = True
        # Without odometry, the belief follows the particles from here on, and need not start anew there again.
        self._follows_particles = self._time_since_odometry_s > _MOST_TIME_WITHOUT_ODOMETRY_S
        self.time_since_update_s = 0.0
        return self.belief

    def predicted(self, motion: Motion | None, elapsed_s: float) -> Estimate:
        """What the belief would be after a motion; the belief does not change."""
        delta = self._scaled(motion)
        step_m = float(pose_distance_m(np.eye(4), delta[None])[0])
        return self._predicted(delta, motion, elapsed_s, step_m).estimate(self._measured.log_scale)

    def without_known_bias(self, measured: Estimate, place: FloatArray) -> Estimate:
        """The particles' pose less its bias at the nearest reference poses.

        Away from them, the known bias counts by its share of the variance.

        Args:
            place: the best known pose (4, 4), where the bias is looked up. The particles' own is off by that bias,
                and so seems farther from the reference poses than the camera is.
        """
        share = self._particle_bias.reference_variance_share(self._reference_poses.distance_m(place))
        known = self._reference_poses.bias_at(place, self._recent_motion)
        return replace(measured, pose=measured.pose @ se3_exp(-share * known))

    def rotation_sd(self, measured: Estimate) -> float:
        """Standard deviation of the particles' rotation, rad an axis, by their spread and bias."""
        variance = float(np.trace(measured.covariance[3:, 3:])) / 3.0
        here, remaining = self._prior_sds(measured.pose), self._state.prior_sds
        bias = max(here[PARTICLES, 3], remaining[PARTICLES, 3])
        return float(np.sqrt(bias**2 + variance))

    def _scaled(self, motion: Motion | None) -> FloatArray:
        """A motion, (4, 4), with its translation in metres, also if it was measured in predicted depth."""
        return np.eye(4) if motion is None else motion.in_metres(self._measured.log_scale + self._state.log_scale)

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
            self._view_noise(motion),
        )

    def _view_noise(self, motion: Motion | None) -> FloatArray:
        """Odometry's noise by the shape of the view, (6, 6), inflated."""
        if motion is None or motion.view_covariance is None:
            return np.zeros((6, 6))
        return (_VIEW_INFLATION * few_corners_factor(motion.inliers)) ** 2 * motion.view_covariance

    def _prior_sds(self, pose: FloatArray) -> FloatArray:
        """Standard deviations of the sources' biases at a pose, (S, 6)."""
        distance_m = self._reference_poses.distance_m(pose)
        return np.stack([self._particle_bias.sds(distance_m), self._landmark_bias.sds(distance_m)])
