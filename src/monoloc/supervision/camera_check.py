"""How far the stated lens is trusted: whether its focal length is the build's, and what landmarks say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction
from monoloc.fusion.bias_model import COMMON_ERROR
from monoloc.geometry import FloatArray
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.particle_filter.estimate import Estimate
from monoloc.supervision.distinct_views import DistinctViews
from monoloc.supervision.integrity import MOST_COUNTED_S

WELL_OBSERVED_SD = 0.02
"""Standard deviation of log-focal up to which a view determines it well; no measurement counts as better."""

_MOST_COMMON = 4.0  # factor of log-focal's variance by what landmarks have in common: seen with up to 150 of them
_MEMORY_S = 3.0  # time constant of the mean, of time that counts
_LEAST_S = 0.5  # that counts before anything is said: of two views at least
_MOST_SD = 3.0  # of single frames, since they are correlated, by which the mean may differ from the build's
# Standard deviations of one view by which that mean must differ. The mean's own would be too small: landmarks are
# misplaced alike in neighbouring views.
_SURE_SDS = 3.0
_LEAST_LOG_FOCAL = 0.04  # smaller differences move a pose by little more than the covariance states
# Of log-aspect. At the desk beyond the build's frames, misplaced landmarks of the right camera suggest up to 0.043.
_LEAST_LOG_ASPECT = 0.06
# Standard deviation of a pose, per axis, over the log-aspect of stretched images: in radians, and in distances of the
# scene. Stretched by 10 and 33 %, in RedKitchen and at the desk, the RMS along the worst axis was 0.3 to 1.0 of it.
_SHARE_OF_ASPECT = 0.6
# Standard deviation of the log-focal of a camera that is not the build's: before landmarks have measured it for a
# while, and from which on it counts as confirmed.
_UNMEASURED_SD, _CONFIRMED_SD = 0.1, 0.05
_MEASURED_S = 1.0


def log_focal_sd(pose: LandmarkPose) -> float:
    """Standard deviation of a landmark pose's log-focal, with the errors that landmarks have in common."""
    return pose.log_focal_sd * _common_factor(pose)


def _log_aspect_sd(pose: LandmarkPose) -> float:
    return pose.log_aspect_sd * _common_factor(pose)


def _common_factor(pose: LandmarkPose) -> float:
    return math.sqrt(min(max(1.0, COMMON_ERROR * len(pose.points)), _MOST_COMMON))


def tells_focal(pose: LandmarkPose) -> bool:
    """Whether a landmark pose determines the focal length well; in a flat view it does not."""
    return log_focal_sd(pose) <= WELL_OBSERVED_SD


def tells_aspect(pose: LandmarkPose) -> bool:
    """Whether a landmark pose determines the lens's aspect well, as most do."""
    return _log_aspect_sd(pose) <= WELL_OBSERVED_SD


def has_same_focal(camera: Camera, other: Camera) -> bool:
    """Whether two cameras have the same focal length relative to the longer side of their images."""
    ratio = camera.focal_px / max(camera.width, camera.height) * max(other.width, other.height) / other.focal_px
    return abs(math.log(ratio)) <= _LEAST_LOG_FOCAL


@dataclass
class _ViewMean:
    """Mean of a logarithm over views, which fade: sums of it by its information, of information, and of views."""

    total: float = 0.0
    information: float = 0.0
    views: float = 0.0

    def add(self, value: float, sd: float, decay: float, part: float) -> None:
        """Add a part of a view, after the others have faded."""
        information = part * sd**-2
        self.total = decay * self.total + information * value
        self.information = decay * self.information + information
        self.views = decay * self.views + part

    @property
    def mean(self) -> float:
        return self.total / self.information

    @property
    def sd(self) -> float:
        """Standard deviation of a view's logarithm, by the mean information of views."""
        return math.sqrt(self.views / self.information)


class CameraCheck:
    """Compares the lens under which landmarks fit best with the stated one, and widens the covariance by it.

    In a flat view a wrong focal length fits nearly as well as the right one: it moves the camera along its optical
    axis, and both landmarks and predicted depth agree. The evidence for the stated one is that the build had the
    same. Any other widens the covariance along that axis, by as much as landmarks leave possible. That of the build
    does too where landmarks are sure of another, as while an autofocus searches.

    The aspect of the lens differs from the stated one where an image was stretched along one axis. Flat views
    determine it as well as others do. The pose then errs along all axes, by what depends on the view.

    Args:
        mean, sd: of landmarks' log-focal, as the build measured it at right poses.
        has_build_focal: whether the stated focal length is that of the build's camera.

    Attributes:
        has_build_focal: as given.
    """

    def __init__(self, mean: float, sd: float, has_build_focal: bool) -> None:
        self._expected, self._expected_sd = mean, sd
        self._views, self._left_s = DistinctViews(), 0.0  # that still counts of the present view
        self._focal, self._aspect = _ViewMean(), _ViewMean()
        self._measured_s = 0.0
        self.has_build_focal = has_build_focal
        self._measured_sd = _UNMEASURED_SD  # of the stated log-focal; the least in this flight, which has one camera
        self._scene_m = 0.0
        self._seen_off = 0.0  # by how much log-focal is surely off in the present image

    @property
    def mismatch(self) -> bool:
        """Whether the camera is not the stated one."""
        if self._measured_s < _LEAST_S:
            return False
        least = max(_LEAST_LOG_FOCAL, _MOST_SD * self._expected_sd)
        return self._difference > math.hypot(least, _SURE_SDS * self._focal.sd) or self._is_stretched

    @property
    def _is_stretched(self) -> bool:
        """Whether landmarks fit a lens of another aspect, as where images were stretched along one axis."""
        aspect = self._aspect
        if self._measured_s < _LEAST_S or aspect.information == 0.0:
            return False
        return abs(aspect.mean) > math.hypot(_LEAST_LOG_ASPECT, _SURE_SDS * aspect.sd)

    @property
    def is_confirmed(self) -> bool:
        """Whether the stated focal length is the build's, or landmarks have confirmed it in this flight."""
        return self.has_build_focal or self._measured_sd <= _CONFIRMED_SD

    @property
    def _difference(self) -> float:
        return abs(self._focal.mean - self._expected)

    @property
    def _stated_sd(self) -> float:
        """Of the stated log-focal: no less than what landmarks are sure of, in this image or over views."""
        sure = self._difference - _SURE_SDS * self._focal.sd if self._focal.information > 0.0 else 0.0
        return max(0.0 if self.has_build_focal else self._measured_sd, sure, self._seen_off)

    def update(self, pose: LandmarkPose | None, T_world_camera: FloatArray, elapsed_s: float) -> None:
        """Take in a frame's landmark pose, and where the camera is believed to be, (4, 4).

        A view counts for a quarter of a second, as one measurement: for as long as the camera hovers there, misplaced
        landmarks suggest the same wrong focal length.
        """
        self._seen_off = 0.0
        if pose is None or not math.isfinite(pose.log_focal_sd):
            return
        sd = math.hypot(log_focal_sd(pose), self._expected_sd)
        self._seen_off = max(0.0, abs(pose.log_focal - self._expected) - _SURE_SDS * sd)
        if self._views.is_new(T_world_camera):
            self._left_s = MOST_COUNTED_S
        counted_s = min(elapsed_s, self._left_s)
        if counted_s == 0.0:
            return
        decay, part = math.exp(-counted_s / _MEMORY_S), counted_s / MOST_COUNTED_S
        self._left_s -= counted_s
        self._measured_s += counted_s
        self._focal.add(pose.log_focal, log_focal_sd(pose), decay, part)
        self._aspect.add(pose.log_aspect, _log_aspect_sd(pose), decay, part)
        if self._measured_s >= _MEASURED_S:
            error = math.hypot(self._difference, self._focal.sd, self._expected_sd)
            self._measured_sd = min(self._measured_sd, max(WELL_OBSERVED_SD, error))

    def widened(self, belief: Estimate, depth: DepthPrediction | None) -> Estimate:
        """The belief with a covariance that allows for a wrong focal length, and for the aspect that was measured.

        Args:
            depth: of the frame; None where it was not its turn, so that the scene is as far as before.
        """
        if depth is not None and (depth.depth_m > 0.0).any():
            self._scene_m = float(np.median(depth.depth_m[depth.depth_m > 0.0]))
        if self._stated_sd == 0.0 and not self._is_stretched:
            return belief
        covariance = belief.covariance.copy()
        covariance[2, 2] += (self._stated_sd * self._scene_m) ** 2
        if self._is_stretched:
            sd_rad = _SHARE_OF_ASPECT * abs(self._aspect.mean)
            covariance += np.diag(np.repeat([sd_rad * self._scene_m, sd_rad], 3) ** 2)
        return replace(belief, covariance=covariance)
