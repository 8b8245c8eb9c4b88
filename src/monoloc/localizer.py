"""The localizer: one step a frame, from an image to a pose with its covariance and state."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, require_bundle
from monoloc.camera import Camera
from monoloc.component_checks import checked_components, checked_measurement
from monoloc.components import ComponentsFactory, default_components
from monoloc.depth.predictor import DepthPrediction
from monoloc.front_end import FrontEnd, Observation
from monoloc.fusion.gravity import Gravity
from monoloc.fusion.reference_poses import NEAR_M
from monoloc.geometry import FloatArray
from monoloc.landmarks.landmark_map import FamiliarLandmarks
from monoloc.landmarks.pnp import LandmarkMeasurement, LandmarkPose
from monoloc.likelihood.scan import EMPTY_SCAN, Scan
from monoloc.likelihood.weighing import FrameWeighing
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.motion import Motion
from monoloc.odometry.standing_pixels import StandingPixels
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles
from monoloc.parts import leave_out
from monoloc.relocalization.search import GlobalRelocalizer
from monoloc.relocalization.state_machine import Doubt, Mode, Relocalization, RelocalizationStateMachine
from monoloc.second_thread import SecondThread
from monoloc.start import Start, checked_start
from monoloc.step import Step
from monoloc.step_budget import Level, Stage, StepBudget, StepPlan, plan_of
from monoloc.supervision.camera_check import CameraCheck, has_same_focal
from monoloc.supervision.integrity import IntegrityMonitor
from monoloc.supervision.map_change import MapChangeMonitor
from monoloc.supervision.state import MOST_REPEATED_S, VOUCHED_FOR, State, Supervision, classify_state
from monoloc.supervision.turn_check import TurnCheck
from monoloc.tracker import Tracker


class Localizer:
    """Localises one camera in a room; call :meth:`step` with every frame in order.

    Args:
        bundle: the room, as :func:`monoloc.load` returns it.
        camera: the camera of the frames.
        start: the first pose; None if it is unknown. The localizer then searches the room, and the state is *lost*
            until it finds the camera.
        config: settings in place of the bundle's.
        components: a function that makes the components, see :mod:`monoloc.components`.
        seed: seeds all random numbers: the same seed gives the same poses. A generator is used directly.

    Raises:
        DataError: the bundle's network does not take the camera's images.
        ValueError: no start is given, and neither scans nor landmarks can find the camera in this room.
        TypeError: an argument has the wrong type, such as a pose for the start, or a dict for the settings.
    """

    def __init__(
        self,
        bundle: Bundle,
        camera: Camera,
        start: Start | None = None,
        config: LocalizerConfig | None = None,
        components: ComponentsFactory = default_components,
        seed: int | np.random.Generator = 0,
    ) -> None:
        require_bundle(bundle)
        if not isinstance(camera, Camera):
            raise TypeError(f"camera must be a monoloc.Camera, got {type(camera).__name__}")
        if config is not None and not isinstance(config, LocalizerConfig):
            raise TypeError(
                f"config must be settings of a localizer or None, got {type(config).__name__}; "
                "write monoloc.config.override(bundle.settings, NAME=VALUE)"
            )
        if config is not None and config != bundle.settings:
            bundle = replace(bundle, settings=config)
        bundle = leave_out(bundle)
        self._bundle, self._config, self._camera = bundle, bundle.settings, camera
        self._rng = np.random.default_rng(seed)
        made = checked_components(components(bundle, camera, self._config))
        self._likelihood, self._landmarks = made.likelihood, made.landmarks
        self._thresholds = bundle.thresholds
        self._gravity = Gravity(bundle.down, is_of_video=bundle.provenance.scale_sd is not None)
        self._turn_check = TurnCheck(bundle.reference_poses.poses, bundle.down)
        poses = bundle.reference_poses.poses if len(bundle.reference_poses) else np.eye(4)[None]
        self._relocalizer = GlobalRelocalizer(
            made.likelihood, self._config.likelihood, poses, self._config.log_scale_sd
        )
        self._budget: StepBudget | None = None
        if self._config.budget_ms is not None:
            self._budget = StepBudget(self._config.budget_ms, self._config.particles, self._config.scan_points)
        # Not a method of this object: a cycle would keep it alive, and a place drops localizers to free memory.
        self._stage = _untimed if self._budget is None else self._budget.stage
        self._begin(checked_start(start))
        self._second_thread = SecondThread(self._config.threads == 2)
        self._standing_pixels = StandingPixels(camera)
        self._front_end = FrontEnd(
            made, camera, self._config, self._rng, self._second_thread, self._standing_pixels, self._stage
        )

    def _begin(self, start: Start | None) -> None:
        """Set everything that is believed before the first frame."""
        bundle, config = self._bundle, self._config
        if start is not None:
            particles = start.particles(config, self._rng)
        elif bundle.supports_relocalization:
            particles = self._relocalizer.sample_everywhere(config.particles, self._rng)
        else:
            raise ValueError("start must be given: neither scans nor landmarks can find the camera in this room")
        mode = Mode.SEARCHING if start is None else Mode.TRACKING
        self._tracker = Tracker(particles, config, bundle.reference_poses, self._rng)
        self._relocalization = RelocalizationStateMachine(
            self._relocalizer, bundle.supports_scan_search, bundle.supports_landmark_search, bundle.thresholds, mode
        )
        self._integrity = IntegrityMonitor(bundle.integrity, is_searched=start is None)
        has_build_focal = has_same_focal(self._camera, bundle.camera)
        self._camera_check = CameraCheck(bundle.integrity.focal_mean, bundle.integrity.focal_sd, has_build_focal)
        self._map_change = MapChangeMonitor(bundle.landmarks, bundle.integrity)
        self._state: State = "tracking"
        self._index, self._is_tracking = 0, False
        self._has_landmark_pose = False  # near the belief, when landmarks were last measured
        self._weighing = FrameWeighing(self._likelihood, config.likelihood, self._rng)
        self._held: tuple[IntegrityMonitor, Mode] | None = None  # at the last image, while others repeat it
        # A start is only a claim about where the camera is. What a search finds is evidence itself.
        can_be_confirmed = len(bundle.landmarks) > 0 or bundle.integrity.scans_can_confirm
        self._start_confirmed = start is None or not can_be_confirmed

    def reset(self, start: Start | None) -> None:
        """Forget the belief, and restart at the next frame, whose elapsed time is ignored.

        Args:
            start: pose of the next frame; None searches for the camera.

        Raises:
            ValueError, TypeError: as in the constructor; the localizer is then unchanged.
        """
        self._begin(checked_start(start))
        self._front_end.reset()

    @property
    def particles(self) -> Particles:
        return self._tracker.particles

    def step(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        measured_depth: DepthPrediction | None = None,
        down: FloatArray | None = None,
        measured_motion: Motion | None = None,
        level: Level | None = None,
    ) -> Step:
        """Localise the camera in one frame.

        Args:
            color: (H, W, 3) uint8 RGB image of the camera.
            elapsed_s: seconds since the previous frame; ignored at the first.
            measured_depth: depth of a sensor, in place of the network's.
            down: direction of gravity in the camera's frame, (3,) of any length, as a flight controller's attitude
                gives it. Its standard deviation is taken to be one degree, or five in a map of a video.
            measured_motion: motion since the previous frame by another sensor: :meth:`Motion.rotation` of a gyroscope
                or an attitude, or :meth:`Motion.metric` of another odometry; ignored at the first frame.
            level: what to leave out, as a recorded flight did; None lets the budget decide.

        Raises:
            ValueError: the image does not have the camera's size or type, time runs backwards, ``down`` is not a
                direction or that of the room is unknown, or ``measured_motion`` does not state its noise or is faster
                than 50 m/s; the localizer is then unchanged.
            TypeError: ``measured_depth`` or ``measured_motion`` has the wrong type; the localizer is then unchanged.
            ValueError, TypeError: a component of your own returns what its protocol does not allow.
        """
        down_camera = self._gravity.direction(None if "gravity" in self._config.without else down)
        level, plan = self._plan(level)
        observation = self._front_end.observe(color, elapsed_s, measured_depth, down_camera, measured_motion, plan)
        previous = self._state if self._start_confirmed else "tracking"  # nothing was doubted before it was known
        predicted = self._predict(observation)
        prior = self._tracker.fusion.predicted(observation.motion, observation.motion_s)
        relocalization = self._relocalize(observation, predicted, prior)
        landmarks_of = self._begin_landmarks(observation, prior, relocalization, plan)
        particle_estimate, log_likelihood = self._update_particles(observation, relocalization, plan.particles)
        with self._stage("landmarks"):
            landmarks = self._without_hidden(landmarks_of(), prior)
        if plan.has_landmarks:
            self._has_landmark_pose = landmarks is not None and landmarks.pose is not None
        contradicted = self._contradicted_by(landmarks, particle_estimate)
        # Where particles are all that is known, their bias is looked up at their own pose.
        place = particle_estimate.pose if relocalization.confirmed else prior.pose
        measured = self._tracker.fusion.without_known_bias(particle_estimate, place)
        belief = self._fuse(observation, measured, log_likelihood, relocalization, landmarks, contradicted)
        if observation.depth_is_predicted:  # a sensor's does not err more in views that no network was tuned on
            belief = self._tracker.fusion.stated()
        seen = relocalization.landmark_pose if landmarks is None else landmarks.pose
        self._camera_check.update(seen, belief.pose, observation.elapsed_s)
        belief = self._camera_check.widened(belief, observation.depth)
        supervision = self._supervise(observation, belief, log_likelihood, landmarks, particle_estimate, contradicted)
        self._state, reasons = classify_state(supervision, previous)
        self._index += 1
        if not observation.waits:
            self._find_standing_pixels(color, observation, seen)
        self._is_tracking = relocalization.mode is Mode.TRACKING and observation.odometry_tracked
        # No level leaves out a search, nor what a start that may be rough takes.
        is_usual = self._is_tracking and not relocalization.is_searched and not self._tracker.fusion.restarted
        if self._budget is not None and is_usual and not observation.is_first:
            # Their number changes after the weighing, so a step weighs as many as the one before left.
            self._budget.end(replace(plan, particles=len(relocalization.particles)))
        return Step(
            estimate=belief if self._state in VOUCHED_FOR else self._integrity.with_doubt(belief),
            state=self._state,
            reasons=reasons,
            probability_far=supervision.probability_far,
            restarted=self._tracker.fusion.restarted,
            particle_estimate=particle_estimate,
            mean_log_likelihood=log_likelihood,
            landmark_pose=None if landmarks is None else landmarks.pose,
            mode=relocalization.mode,
            motion=observation.motion,
            depth=observation.depth,
            scan=observation.scan,
            changed_region=supervision.changed_region,
            level=level,
            standing=self._standing_pixels.found.mask if self._standing_pixels.share else None,
        )

    def _plan(self, level: Level | None) -> tuple[Level, StepPlan]:
        """The level of this step, given or chosen by the budget, and what the step does."""
        if self._budget is not None:
            self._budget.begin()
        if level is None:
            level = Level.FULL if self._budget is None else self._budget.level
        config = self._config
        return level, plan_of(level, self._index, config.particles, config.scan_points, self._is_tracking)

    def _predict(self, observation: Observation) -> Particles:
        # The motion of an image that is shown twice comes with the next one.
        is_awaited = observation.waits and observation.repeated_s <= MOST_REPEATED_S
        is_tracked = observation.odometry_tracked or is_awaited
        if observation.waits:
            self._tracker.hold()
            self._held = self._held or (copy(self._integrity), self._relocalization.mode)
        else:  # what was allowed for meanwhile is now known
            self._tracker.resume()
            if self._held is not None:
                (self._integrity, self._relocalization.mode), self._held = self._held, None
        self._integrity.predict(observation.motion_s, is_tracked, observation.image_is_new)
        is_verifying = self._relocalization.mode is Mode.VERIFYING
        return self._tracker.predict(observation.motion, observation.motion_s, from_search=is_verifying)

    def _relocalize(self, observation: Observation, predicted: Particles, prior: Estimate) -> Relocalization:
        relocalization = self._relocalization.update(
            predicted,
            prior,
            observation.scan if observation.scan_has_enough_points else EMPTY_SCAN,
            observation.elapsed_s,
            self._integrity.probability_wrong,
            self._doubt(),
            partial(self._search_by_landmarks, observation) if observation.image_is_new else None,
            self._rng,
        )
        if relocalization.landmark_pose is not None:
            self._integrity.found_by_landmarks()
        elif relocalization.confirmed:
            self._integrity.found_by_scan()
        elif relocalization.mode is not Mode.TRACKING:
            self._integrity.lose()
        return relocalization

    def _doubt(self) -> Doubt:
        if self._has_landmark_pose or self._state in VOUCHED_FOR:
            return "none"
        return "lost" if self._state == "lost" else "uncertain"

    def _search_by_landmarks(self, observation: Observation) -> LandmarkPose | None:
        return self._landmarks.relocalize(observation.landmarks_seen())

    def _measure_landmarks(self, observation: Observation, prior: Estimate) -> LandmarkMeasurement:
        return checked_measurement(
            self._landmarks.measure(observation.landmarks_seen(), prior.pose, prior.covariance)
        )

    def _find_standing_pixels(
        self, color: NDArray[np.uint8], observation: Observation, landmark_pose: LandmarkPose | None
    ) -> None:
        motion = observation.motion if observation.image_is_new else None
        pose = None if landmark_pose is None else landmark_pose.pose
        self._standing_pixels.update(color, motion, observation.depth, pose)
        if self._standing_pixels.has_grown:  # what it hides has counted as missing
            self._map_change.forget()

    def _without_hidden(self, landmarks: LandmarkMeasurement | None, prior: Estimate) -> LandmarkMeasurement | None:
        """The measurement, in which landmarks behind what stands still are not shown."""
        if landmarks is None or not self._standing_pixels.share:
            return landmarks
        pose = prior.pose if landmarks.pose is None else landmarks.pose.pose
        is_hidden = self._standing_pixels.found.hides(self._bundle.landmarks.points[landmarks.visible], pose)
        return replace(landmarks, is_shown=landmarks.is_shown & (landmarks.is_found | ~is_hidden))

    def _update_particles(
        self, observation: Observation, relocalization: Relocalization, count: int
    ) -> tuple[Estimate, float]:
        """The particles' pose after scan and corners, and the scan's mean log-likelihood there.

        During a search, scan and corners are no evidence about the pose.
        """
        weigh = self._measurement_update(observation, relocalization.mode)
        with self._stage("weighing"):
            particle_estimate = self._tracker.update(relocalization.particles, weigh, count)
            return particle_estimate, self._mean_log_likelihood(observation.scan, particle_estimate)

    def _measurement_update(self, observation: Observation, mode: Mode) -> Callable[[Particles], Particles]:
        if mode is Mode.SEARCHING:
            return lambda particles: particles
        return self._weighing.begin(observation.scan, observation.corners, observation.elapsed_s)

    def _mean_log_likelihood(self, scan: Scan, particle_estimate: Estimate) -> float:
        """Of the scan at the particles' pose, which shares the depth's bias; NaN for an empty scan."""
        if len(scan) == 0:
            return float("nan")
        pose: FloatArray = particle_estimate.pose[None]
        log_scale = np.array([particle_estimate.log_scale])
        return float(self._likelihood.mean_log_likelihood(pose, log_scale, scan)[0])

    def _fuse(
        self,
        observation: Observation,
        measured: Estimate,
        log_likelihood: float,
        relocalization: Relocalization,
        landmarks: LandmarkMeasurement | None,
        contradicted: bool,
    ) -> Estimate:
        """The belief after motion, particles and landmarks.

        Args:
            measured: pose of the particles, less its known bias.

        The particles of a lost camera gather somewhere too. So they count only if the scan fits there as well as
        scans fit at right poses, and landmarks do not contradict them.
        """
        landmark_pose = None if landmarks is None else landmarks.pose
        fits = observation.scan_has_enough_points and log_likelihood >= self._thresholds.lost
        fits &= self._integrity.scan_speaks_for_the_pose(log_likelihood)
        is_found = relocalization.confirmed or relocalization.landmark_pose is not None
        scan_confirms = fits and not contradicted and self._integrity.scan_confirms(log_likelihood)
        scan_confirms &= not self._integrity.landmarks_deny(landmarks)
        self._start_confirmed |= is_found or landmark_pose is not None or scan_confirms
        fits &= not relocalization.awaits_landmarks
        fits |= "bias" in self._config.without  # the belief is the particles' pose, whatever their scan says
        scan_accepted = fits and relocalization.mode is Mode.TRACKING and not contradicted
        if scan_accepted:
            rotation_sd = self._tracker.fusion.rotation_sd(measured)
            measured = self._gravity.align(measured, observation.scan, observation.down_camera, rotation_sd)
        belief = self._tracker.fuse(observation.motion, observation.motion_s, measured, scan_accepted)
        if relocalization.landmark_pose is not None:
            return self._tracker.fusion.reinitialise_from_landmarks(relocalization.landmark_pose)
        if relocalization.confirmed:
            return self._tracker.fusion.reinitialise(measured)
        return belief if landmark_pose is None else self._tracker.fusion.update_from_landmarks(landmark_pose)

    def _contradicted_by(self, landmarks: LandmarkMeasurement | None, particle_estimate: Estimate) -> bool:
        """Whether landmarks measured a pose that the particles' pose contradicts."""
        landmark_pose = None if landmarks is None else landmarks.pose
        return landmark_pose is not None and self._tracker.fusion.contradicts(particle_estimate, landmark_pose)

    def _begin_landmarks(
        self, observation: Observation, prior: Estimate, relocalization: Relocalization, plan: StepPlan
    ) -> Callable[[], LandmarkMeasurement | None]:
        """What the image shows of the landmarks; None where it is no evidence, or the belief restarts."""
        starts_anew = relocalization.confirmed or relocalization.landmark_pose is not None
        is_known = relocalization.mode is Mode.TRACKING and not starts_anew
        if not (plan.has_landmarks and is_known and observation.image_is_new):
            return lambda: None
        return self._second_thread.begin(partial(self._measure_landmarks, observation, prior))

    def _supervise(
        self,
        observation: Observation,
        belief: Estimate,
        log_likelihood: float,
        landmarks: LandmarkMeasurement | None,
        particle_estimate: Estimate,
        contradicted: bool,
    ) -> Supervision:
        """Weigh the frame's evidence for and against the belief.

        Where particles and belief disagree beyond their errors, one of them is wrong. If landmarks measured the pose,
        the particles are wrong and are redrawn; if not, their scan is evidence against the belief.
        """
        mode, familiar = self._relocalization.mode, None
        if mode is Mode.TRACKING:
            landmark_pose = None if landmarks is None else landmarks.pose
            if contradicted:
                self._tracker.redraw()
                log_likelihood = float("nan")
            elif landmark_pose is None and self._tracker.fusion.contradicts(particle_estimate, None):
                log_likelihood = -np.inf if observation.scan_has_enough_points else log_likelihood
            familiar = self._familiar(belief, landmarks)
            if self._tracker.fusion.landmarks_contradict and self._index > 0:  # a given start may be rough
                self._integrity.contradicted_by_landmarks()
            self._integrity.update(log_likelihood, landmarks, familiar)
        probability_far = self._integrity.probability_far(belief)
        # How many landmarks are found again was measured with the build's focal length.
        comparable = familiar.shown() if familiar is not None and self._camera_check.has_build_focal else None
        return Supervision(
            mode=mode,
            probability_far=probability_far,
            probability_wrong=self._integrity.probability_wrong,
            repeated_s=observation.repeated_s,
            image_is_empty=observation.is_empty,
            odometry_tracked=observation.odometry_tracked,
            is_near_build=self._bundle.reference_poses.distance_m(belief.pose) <= NEAR_M,
            camera_mismatch=self._camera_check.mismatch,
            camera_turned=self._is_turned(observation, belief),
            camera_confirmed=self._camera_check.is_confirmed,
            start_confirmed=self._start_confirmed,
            changed_region=self._map_change.update(
                comparable, probability_far, belief.pose, observation.elapsed_s, observation.landmarks_left_out
            ),
        )

    def _is_turned(self, observation: Observation, belief: Estimate) -> bool:
        is_known = observation.depth_is_predicted and self._relocalization.mode is Mode.TRACKING
        return is_known and self._turn_check.is_turned(belief.pose)

    def _familiar(self, belief: Estimate, landmarks: LandmarkMeasurement | None) -> FamiliarLandmarks | None:
        """Familiar landmarks at the belief, if landmarks gave a pose."""
        views = self._bundle.landmarks.views
        if landmarks is None or landmarks.pose is None or views is None:
            return None
        return views.familiar(belief.pose, landmarks.visible, landmarks.is_found, landmarks.is_shown)


def _untimed(name: Stage) -> AbstractContextManager[None]:
    """Time nothing, in a localizer without a budget."""
    return nullcontext()
