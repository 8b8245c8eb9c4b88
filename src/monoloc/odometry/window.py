"""Bundle adjustment of the last few keyframes, which combines parallax with predicted depth.

Gauss-Newton, with the points eliminated by the Schur complement (Triggs et al., *Bundle Adjustment - A Modern
Synthesis*, 2000). Each observation has three residuals: two of the corner's position, and one of the logarithm of its
predicted depth. The depth residual determines the scale and the depth of corners without parallax. The position
residuals determine the shape once there is a baseline.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import monoloc._core as _core
from monoloc.geometry import FloatArray


@dataclass(frozen=True)
class Window:
    """W keyframes that observe N corners, in an arbitrary common frame r.

    Attributes:
        poses: ``T_r_camera``, (W, 4, 4); the first is fixed.
        points: (N, 3) corners in r.
        rays: (N, W, 2) observed image coordinates at z = 1 of each corner in each keyframe; NaN if not observed.
        log_depth: (N, W) logarithm of predicted depth at these observations; NaN if unknown.
    """

    poses: FloatArray
    points: FloatArray
    rays: FloatArray
    log_depth: FloatArray

    @classmethod
    def empty(cls) -> Window:
        return cls(np.zeros((0, 4, 4)), np.zeros((0, 3)), np.zeros((0, 0, 2)), np.zeros((0, 0)))

    def select(self, chosen: NDArray[Any]) -> Window:
        """The window restricted to some corners."""
        return Window(self.poses, self.points[chosen], self.rays[chosen], self.log_depth[chosen])

    def with_keyframe(
        self, T_r_camera: FloatArray, new_points: FloatArray, rays: FloatArray, log_depth: FloatArray, most: int
    ) -> Window:
        """Add a keyframe that observes all N corners and M new ones, and drop the oldest keyframes.

        Args:
            T_r_camera: pose of the keyframe, (4, 4).
            new_points: (M, 3) new corners in r, which no other keyframe observes.
            rays, log_depth: (N + M, 2) and (N + M,) observations in the keyframe.
            most: maximum number of keyframes, at least 1.
        """
        poses = np.concatenate([self.poses, T_r_camera[None]])[-most:]
        previous, known = len(poses) - 1, len(self.points)
        all_rays = np.full((len(rays), previous + 1, 2), np.nan)
        all_log_depth = np.full((len(rays), previous + 1), np.nan)
        if previous:
            all_rays[:known, :previous] = self.rays[:, -previous:]
            all_log_depth[:known, :previous] = self.log_depth[:, -previous:]
        all_rays[:, previous], all_log_depth[:, previous] = rays, log_depth
        return Window(poses, np.concatenate([self.points, new_points]), all_rays, all_log_depth)


def adjust(
    window: Window, ray_sd: float, log_depth_sd: float, iterations: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Find the poses and points that maximise the likelihood of the window's observations.

    Args:
        window: observations and initial values.
        ray_sd: standard deviation of a corner's image coordinates at z = 1 (pixels over focal length).
        log_depth_sd: standard deviation of predicted log-depth.
        iterations: number of Gauss-Newton steps.

    Returns:
        Poses (W, 4, 4), points (N, 3), and the information (inverse covariance) (N, 3, 3) of each point from its
        observed positions, given the poses. The information excludes predicted depth, because its error is the same
        in all keyframes.
    """
    return _core.adjust_window(
        window.poses, window.points, window.rays, window.log_depth, ray_sd, log_depth_sd, iterations
    )
