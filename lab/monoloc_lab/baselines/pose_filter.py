"""Poses that come one a frame, smoothed by monoloc's own particle filter and odometry.

Particles, motion, resampling, estimate and how it is joined with odometry are those of the localizer; only the
likelihood is another: that of the pose measured, in place of that of a scan in the map. So what the filter gives a
pose network can be told apart from what the map gives monoloc. Free of PyTorch: where the poses come from does not
matter.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.fusion.bias_filter import Joiner
from monoloc.fusion.reference_poses import Viewpoints
from monoloc.geometry import FloatArray
from monoloc.localizer import DepthSource, LocalizerConfig
from monoloc.odometry.visual import VisualOdometry
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.motion_model import predict
from monoloc.particle_filter.particles import Particles, normalised
from monoloc.particle_filter.resampling import resample
from monoloc_lab.baselines.pose_error import PoseError


class PoseFilter:
    """Follows one camera by measured poses and visual odometry; call it with every frame in order.

    Args:
        measure: ``T_world_camera`` (4, 4) of an image (H, W, 3) uint8 RGB, None where it has none.
        error: of what ``measure`` gives.
        depth: for the odometry; the localizer's, for a comparison that is fair.
        start: particles at the first frame.
        config: the localizer's; of it, what concerns particles, motion, depth scale and errors that last.
        viewpoints: that the network was trained on, or none.
    """

    def __init__(
        self,
        measure: Callable[[NDArray[np.uint8]], FloatArray | None],
        error: PoseError,
        depth: DepthSource,
        camera: Camera,
        start: Particles,
        config: LocalizerConfig,
        viewpoints: Viewpoints,
        rng: np.random.Generator,
    ) -> None:
        self.particles = start
        self._measure, self._error, self._depth = measure, error, depth
        self._odometry = VisualOdometry(camera, config.odometry) if config.motion == "visual" else None
        self._joiner = Joiner(estimate(start), config.lasting, config.motion_noise, viewpoints)
        self._config = config
        self._rng = rng
        self._is_first = True

    def step(self, color: NDArray[np.uint8], elapsed_s: float) -> Estimate:
        """Take one frame in: (H, W, 3) uint8 RGB, and the seconds since the one before, ignored at the first."""
        config = self._config
        elapsed_s = 0.0 if self._is_first else elapsed_s
        motion = None
        if self._odometry is not None:
            depth = self._depth(color)
            motion = self._odometry.step(color, depth.depth_m, depth.camera)
        if not self._is_first:
            spread, noise, blind_s = config.log_scale_sd, config.motion_noise, self._joiner.blind_s
            self.particles = predict(self.particles, motion, elapsed_s, blind_s, spread, noise, self._rng)
        measured = self._measure(color)
        if measured is not None:
            fit = self._error.log_likelihood(measured, self.particles.poses)
            log_weights = normalised(self.particles.log_weights + fit)
            self.particles = Particles(self.particles.poses, self.particles.log_scale, log_weights)
        self._is_first = False
        belief = self._joiner.step(motion, elapsed_s, estimate(self.particles), is_told=measured is not None)
        self.particles = resample(self.particles, config.ess_fraction, self._rng)
        return belief
