"""The front end: what is measured in a frame, before anything is known of the pose."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.component_checks import check_frame, checked_depth, checked_motion
from monoloc.components import Components
from monoloc.contrast import has_contrast
from monoloc.depth.predictor import DepthPrediction
from monoloc.geometry import FloatArray
from monoloc.likelihood.scan import EMPTY_SCAN, Scan, scan_from_corners, scan_from_depth
from monoloc.localizer_config import LocalizerConfig
from monoloc.motion_choice import chosen_motion
from monoloc.odometry.motion import FollowingOdometry, Motion, chained, tracks_translation
from monoloc.odometry.scale_tilt import correct_scale_and_tilt
from monoloc.odometry.standing_image import StandingImage
from monoloc.odometry.standing_pixels import StandingPixels
from monoloc.same_image import is_same_image
from monoloc.second_thread import SecondThread
from monoloc.step_budget import Stage, StepPlan

DepthOfFrame = Callable[[], DepthPrediction | None]
"""The depth of a frame once it is known; None where it is not predicted."""

_LEAST_POINTS = 10  # of a scan that constrains the pose


@dataclass(frozen=True)
class Observation:
    """What was measured in one frame.

    Attributes:
        elapsed_s: since the previous frame, 0 at the first.
        is_first: whether there is no previous frame.
        is_repeated: whether the image is the previous one, bit for bit, or stands still although another sensor
            measures a turn. It says nothing of the camera's motion, so there is no scan, and no motion but that of
            the other sensor.
        repeated_s: for how long the image has been the same.
        waits: whether this image repeats the previous one bit for bit, so that only the next one shows the motion.
        motion_s: time that the motion is of: since the previous frame, or since the last one that did not wait.
        is_empty: whether the image has no contrast.
        depth_is_predicted: whether the network predicts this flight's depth, in this frame or in others.
        depth: of the frame, its scale and tilt corrected by odometry's corners; None where it was not its turn.
        motion: since the previous frame, None where it is not known at all.
        odometry_tracked: whether images or another sensor measured how the camera moved, not only its turn; true at
            the first frame and for a random walk.
        scan: points of the depth; empty without depth, where the image has no contrast and no sensor measured it, and
            where scans are left out.
        corners: odometry's corners whose depth parallax has refined; empty where scans are left out.
        landmarks_seen: what the landmark localiser detects in the image, once it is asked for.
        landmarks_left_out: whether landmarks are not looked for, to keep a budget.
        down_camera: direction of gravity in the camera's frame, (3,) unit vector, None if it is not known.
    """

    elapsed_s: float
    is_first: bool
    is_repeated: bool
    repeated_s: float
    waits: bool
    motion_s: float
    is_empty: bool
    depth_is_predicted: bool
    depth: DepthPrediction | None
    motion: Motion | None
    odometry_tracked: bool
    scan: Scan
    corners: Scan
    landmarks_seen: Callable[[], Any]
    landmarks_left_out: bool
    down_camera: FloatArray | None

    @property
    def scan_has_enough_points(self) -> bool:
        return len(self.scan) >= _LEAST_POINTS

    @property
    def image_is_new(self) -> bool:
        """Whether the image shows something, and not the same as before."""
        return not self.is_empty and not self.is_repeated


class FrontEnd:
    """Depth, odometry, scale and tilt, and scan of every frame; call :meth:`observe` with every frame in order.

    Args:
        components, camera, config, rng, second_thread, standing_pixels: of the localizer.
        stage: times how long depth keeps the frame waiting.
    """

    def __init__(
        self,
        components: Components,
        camera: Camera,
        config: LocalizerConfig,
        rng: np.random.Generator,
        second_thread: SecondThread,
        standing_pixels: StandingPixels,
        stage: Callable[[Stage], AbstractContextManager[None]] = lambda name: nullcontext(),
    ) -> None:
        self._depth, self._odometry, self._landmarks = components.depth, components.odometry, components.landmarks
        self._camera, self._stage = camera, stage
        self._config, self._has_scans = config, "scan" not in config.without
        self._rng, self._second_thread = rng, second_thread
        self._is_first = True
        self._previous: NDArray[np.uint8] | None = None
        self._repeated_s = self._waited_s = 0.0
        self._standing_image, self._standing_pixels = StandingImage(), standing_pixels
        self._depth_camera = camera  # of the last depth image
        # By another sensor, since the last image that did not wait: one motion, None if it is not known throughout.
        self._measured: list[Motion | None] = []

    def reset(self) -> None:
        """Take the next frame as the first."""
        self._is_first, self._previous, self._measured, self._waited_s = True, None, [], 0.0
        self._standing_image.reset()
        self._standing_pixels.reset()

    def observe(
        self,
        color: NDArray[np.uint8],
        elapsed_s: float,
        measured_depth: DepthPrediction | None,
        down_camera: FloatArray | None,
        measured_motion: Motion | None = None,
        plan: StepPlan | None = None,
    ) -> Observation:
        """Observe one frame.

        Args:
            color: (H, W, 3) uint8 RGB, of the camera.
            elapsed_s: since the previous frame; ignored at the first.
            measured_depth: of a depth sensor; None predicts it.
            down_camera: direction of gravity, (3,) unit vector, or None.
            measured_motion: since the previous frame, by another sensor; ignored at the first.
            plan: number of scan points, and whether depth and landmarks have their turn; None as the settings say.

        Raises:
            ValueError: the image does not have the camera's size or type, time is no number, runs backwards or
                jumps by more than 1e12 s, or the motion does not state its noise or is faster than 50 m/s; nothing
                has changed then.
            TypeError: ``measured_depth`` or ``measured_motion`` is of another type; the same.
            ValueError, TypeError: a component returns what its protocol does not allow.
        """
        elapsed_s = 0.0 if self._is_first else elapsed_s
        check_frame(self._camera, color, elapsed_s, measured_depth, measured_motion)
        is_repeated, is_empty = self._is_repeated(color, elapsed_s), not has_contrast(color)
        has_depth = plan is None or plan.has_depth
        is_predicted = measured_depth is None and has_depth
        depth_of = self._predicted(color) if is_predicted else lambda: measured_depth if has_depth else None
        has_landmarks = (plan is None or plan.has_landmarks) and not is_empty and not is_repeated
        landmarks_seen = self._second_thread.begin(partial(self._landmarks.detect, color), is_needed=has_landmarks)
        # As one motion: a camera may repeat its image for minutes.
        self._measured = [chained([*self._measured, None if self._is_first else measured_motion])]
        # Odometry's next motion is from the image that repeats, and so is the other sensor's.
        waits = is_repeated and not is_empty
        motion_s = elapsed_s if waits else self._waited_s + elapsed_s
        motion, stood_s = (None, 0.0) if waits else self._motion(color, depth_of, is_repeated, motion_s)
        motion = None if self._is_first else motion  # since before a reset
        is_repeated = is_repeated or stood_s > 0.0
        self._repeated_s = max(self._repeated_s, stood_s)
        depth, scan = depth_of(), EMPTY_SCAN
        self._waited_s = self._waited_s + elapsed_s if waits else 0.0
        if depth is not None:
            depth = self._corrected(depth, motion)
            if self._has_scans:
                # A sensor's depth is of another lens.
                of_room = self._standing_pixels.found.without(depth) if measured_depth is None else depth
                scan = self._scan(of_room, self._config.scan_points if plan is None else plan.scan_points)
        observation = Observation(
            elapsed_s=elapsed_s,
            is_first=self._is_first,
            is_repeated=is_repeated,
            repeated_s=self._repeated_s,
            waits=waits,
            motion_s=motion_s,
            is_empty=is_empty,
            depth_is_predicted=measured_depth is None,
            depth=depth,
            motion=motion,
            odometry_tracked=self._is_first or self._odometry is None or tracks_translation(motion),
            scan=EMPTY_SCAN if is_repeated or (is_empty and measured_depth is None) else scan,
            corners=self._corners(motion) if motion is not None and self._has_scans else EMPTY_SCAN,
            landmarks_seen=landmarks_seen,
            landmarks_left_out=plan is not None and not plan.has_landmarks,
            down_camera=down_camera,
        )
        self._is_first = False
        return observation

    def _is_repeated(self, color: NDArray[np.uint8], elapsed_s: float) -> bool:
        """Whether the camera gave the previous image again."""
        is_repeated = is_same_image(color, self._previous)
        self._repeated_s = self._repeated_s + elapsed_s if is_repeated else 0.0
        self._previous = color.copy()
        return is_repeated

    def _predicted(self, color: NDArray[np.uint8]) -> DepthOfFrame:
        depth_of = self._second_thread.begin(partial(self._depth, color))

        @cache
        def wait() -> DepthPrediction:
            with self._stage("depth"):
                depth = depth_of()
            return checked_depth(depth, "the result of Components.depth")

        return wait

    def _motion(
        self, color: NDArray[np.uint8], depth_of: DepthOfFrame, is_repeated: bool, elapsed_s: float
    ) -> tuple[Motion | None, float]:
        """The motion since the previous call, and for how many seconds the image has stood although it turned."""
        (measured,), self._measured = self._measured, []
        if self._odometry is None or is_repeated:
            return measured, 0.0
        rotation = None if measured is None else measured.T_previous_current[:3, :3]
        if isinstance(self._odometry, FollowingOdometry):
            self._odometry.follow(color, rotation, elapsed_s)
        depth = depth_of()
        if depth is None:
            camera = self._depth_camera
            depth_m = np.zeros((camera.height, camera.width), dtype=np.float32)
        else:
            depth_m, camera = self._standing_pixels.found.without(depth).depth_m, depth.camera
            self._depth_camera = camera
        odometry = self._odometry.step(color, depth_m, camera, rotation)
        if odometry is not None:
            odometry = checked_motion(odometry, "the result of Components.odometry")
        stood_s = self._standing_image.update(odometry, measured, elapsed_s)
        noise = self._config.motion_noise
        motion = measured if stood_s > 0.0 else chosen_motion(odometry, measured, elapsed_s, noise)
        return motion, stood_s

    def _corrected(self, depth: DepthPrediction, motion: Motion | None) -> DepthPrediction:
        if motion is None or self._config.scale_tilt is None:
            return depth
        return correct_scale_and_tilt(depth, motion, self._config.scale_tilt)

    def _corners(self, motion: Motion) -> Scan:
        return scan_from_corners(motion, self._config.likelihood.max_corner_log_depth_sd)

    def _scan(self, depth: DepthPrediction, count: int) -> Scan:
        return scan_from_depth(depth, count, self._rng, self._config.likelihood.error_power)
