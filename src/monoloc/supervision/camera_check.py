"""Whether landmarks fit the camera's stated focal length."""

from __future__ import annotations

import math

from monoloc.fusion.bias_model import COMMON_ERROR
from monoloc.landmarks.pnp import LandmarkPose

WELL_OBSERVED_SD = 0.02
"""Standard deviation of log-focal above which it says nothing: the view is too flat."""

_MOST_COMMON = 4.0  # factor of log-focal's variance by what landmarks have in common: seen with up to 150 of them
_MEMORY_S = 3.0  # time constant of the mean
_LEAST_S = 0.5  # of measurements before anything is said
_MOST_SD = 3.0  # of single frames, since they are correlated, by which the mean may differ from the build's
_LEAST_LOG_FOCAL = 0.04  # smaller differences move a pose by little more than the covariance states


def tells_focal(pose: LandmarkPose) -> bool:
    """Whether a landmark pose determines the focal length; in a flat view it does not."""
    common = min(max(1.0, COMMON_ERROR * len(pose.points)), _MOST_COMMON)
    return pose.log_focal_sd * math.sqrt(common) <= WELL_OBSERVED_SD


class CameraCheck:
    """Compares the focal length that landmarks ask for with the build's.

    Args:
        mean, sd: of landmarks' log-focal, as the build measured it at right poses.
    """

    def __init__(self, mean: float, sd: float) -> None:
        self._expected, self._bound = mean, max(_LEAST_LOG_FOCAL, _MOST_SD * sd)
        self._sum, self._information, self._measured_s = 0.0, 0.0, 0.0

    @property
    def mismatch(self) -> bool:
        """Whether the camera is not the stated one."""
        if self._measured_s < _LEAST_S:
            return False
        return abs(self._sum / self._information - self._expected) > self._bound

    def update(self, pose: LandmarkPose | None, elapsed_s: float) -> None:
        """Take in a frame's landmark pose."""
        if pose is None or not tells_focal(pose):
            return
        decay, information = math.exp(-elapsed_s / _MEMORY_S), pose.log_focal_sd**-2
        self._measured_s += elapsed_s
        self._sum = decay * self._sum + information * pose.log_focal
        self._information = decay * self._information + information
