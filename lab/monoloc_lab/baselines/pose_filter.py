"""Poses that are measured frame by frame, filtered with monoloc's tracker and odometry.

Odometry, particles and fusion are those of the localizer. Only the likelihood differs: it is that of the measured
pose, not of a scan in the map. So the filter separates its own contribution to a pose network from that of the map.
It needs no PyTorch.
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
from monoloc.odometry.motion import Motion
from monoloc.odometry.visual import VisualOdometry
from monoloc.particle_filter.estimate import Estimate
from monoloc.particle_filter.particles import Particles, normalised
from monoloc.tracker import Tracker
from monoloc_lab.baselines.pose_error import PoseError


class PoseFilter:
    """Tracks one camera with measured poses and visual odometry; call :meth:`step` with every frame in order.

    Args:
        measure: ``T_world_camera`` (4, 4) of an image (H, W, 3) uint8 RGB, None if it finds no pose.
        error: of the measured poses.
        depth: for the odometry; that of the localizer, for a fair comparison.
        start: particles before the first frame.
        config: the localizer's settings of particles, motion, depth scale and bias.
        reference_poses: training poses of the network, or none.
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
        """Process one frame: (H, W, 3) uint8 RGB, and the seconds since the previous frame, ignored at the first."""
        elapsed_s = 0.0 if self._is_first else elapsed_s
        self._is_first = False
        motion = self._motion(color)
        predicted = self._tracker.predict(motion, elapsed_s)
        pose = self._measure(color)
        measured = self._tracker.update(predicted, lambda particles: self._weighted(particles, pose))
        return self._tracker.fuse(motion, elapsed_s, measured, accepted=pose is not None)

    def _motion(self, color: NDArray[np.uint8]) -> Motion | None:
        if self._odometry is None:
            return None
        depth = self._depth(color)
        return self._odometry.step(color, depth.depth_m, depth.camera)

    def _weighted(self, particles: Particles, pose: FloatArray | None) -> Particles:
        if pose is None:
            return particles
        log_likelihood = self._error.log_likelihood(pose, particles.poses)
        log_weights = normalised(particles.log_weights + log_likelihood)
        return Particles(particles.poses, particles.log_scale, log_weights)
