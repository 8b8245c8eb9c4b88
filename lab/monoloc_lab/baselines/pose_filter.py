"""Poses measured once a frame, filtered by monoloc's own tracker and odometry.

Odometry, particles, and fusion are those of the localizer. Only the likelihood differs: that of the measured pose, in
place of that of a scan in the map. So what the filter gives a pose network can be told from what the map gives
monoloc. It needs no PyTorch: where the poses come from does not matter.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthSource
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.localizer_config import LocalizerConfig
from monoloc.odometry.visual import Motion, VisualOdometry
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles, normalised
from monoloc.tracker import Tracker
from monoloc_lab.baselines.pose_error import PoseError


class PoseFilter:
    """Tracks one camera by measured poses and visual odometry; call :meth:`step` with every frame in order.

    Args:
        measure: ``T_world_camera`` (4, 4) of an image (H, W, 3) uint8 RGB, None where it has none.
        error: of what ``measure`` gives.
        depth: for the odometry; the localizer's, for a fair comparison.
        start: particles before the first frame.
        config: the localizer's settings of particles, motion, depth scale and bias.
        reference_poses: that the network was trained on, or none.
    """

    def __init__(
        self,
        measure: Callable[[NDArray[np.uint8]], FloatArray | None],
        error: PoseError,
        depth: DepthSource,
        camera: Camera,
        start: Particles,
        config: LocalizerConfig,
        reference_poses: ReferencePoses,
        rng: np.random.Generator,
    ) -> None:
        self._measure, self._error, self._depth = measure, error, depth
        self._odometry = VisualOdometry(camera, config.odometry) if config.motion == "visual" else None
        self._tracker = Tracker(start, config, reference_poses, rng)
        self._is_first = True

    @property
    def particles(self) -> Particles:
        return self._tracker.particles

    def step(self, color: NDArray[np.uint8], elapsed_s: float) -> Estimate:
        """Take in one frame: (H, W, 3) uint8 RGB, and the seconds since the previous one, ignored at the first."""
        elapsed_s = 0.0 if self._is_first else elapsed_s
        self._is_first = False
        motion = self._motion(color)
        predicted = self._tracker.predict(motion, elapsed_s)
        pose = self._measure(color)
        measured = self._tracker.update(predicted, lambda particles: self._weighed(particles, pose))
        return self._tracker.fuse(motion, elapsed_s, measured, accepted=pose is not None)

    def _motion(self, color: NDArray[np.uint8]) -> Motion | None:
        if self._odometry is None:
            return None
        depth = self._depth(color)
        return self._odometry.step(color, depth.depth_m, depth.camera)

    def _weighed(self, particles: Particles, pose: FloatArray | None) -> Particles:
        if pose is None:
            return particles
        log_likelihood = self._error.log_likelihood(pose, particles.poses)
        log_weights = normalised(particles.log_weights + log_likelihood)
        return Particles(particles.poses, particles.log_scale, log_weights)
