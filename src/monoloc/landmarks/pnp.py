"""Pose of a camera from the landmarks that it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import monoloc._core as _core
from monoloc.camera import Camera
from monoloc.evaluation.consistency import CHI2_6_QUANTILE_99, is_covariance
from monoloc.geometry import FloatArray, invert, is_rigid, se3_exp, se3_log
from monoloc.landmarks.features import Keypoints

PRIOR_COVARIANCE = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2
"""Covariance of a prior pose, (6, 6), where no belief states one."""

LEAST_LANDMARKS = 15
"""Number of landmarks that determine a pose."""

# Standard deviations at which a landmark's weight is a quarter.
_KERNEL_SDS = np.array([24.0, 12.0, 6.0, 3.0, 3.0, 3.0])
_LEAST_VARIANCE = 1e-8  # of a prior, m^2 and rad^2: a start may be stated as exact
_UNOBSERVABLE_SD = 0.3  # m or rad: a direction that landmarks constrain no better is not determined
_NEAREST_M = 0.05  # depth of a landmark
# Narrower, since the pose is known except for the effect of the lens.
_LENS_KERNEL_SDS = np.array([12.0, 6.0, 3.0, 3.0, 3.0])
# Prior of the pose's error by a wrong lens, and of the logarithms of its focal length and aspect: inverse covariance.
_ASPECT_INFORMATION = np.diag(np.repeat([0.5, 0.1, 0.2], [3, 3, 2]) ** -2)
_FOCAL_INFORMATION = np.diag(np.diag(_ASPECT_INFORMATION)[:7])
_AGREE_WEIGHT = 0.25  # of a landmark that agrees
_MOST_LEVERAGE = 1.0  # of a match, out of 2: above, the pose follows this match more than all others together
_AGREE_PX, _LEAST_AGREEING, _CONFIDENCE = 4.0, 8, 1.0 - 1e-6  # with a pose of a triple
_TURNS_RAD = np.array([-0.3, -0.15, 0.15, 0.3])  # from which the other poses of a flat view are sought
_PRIOR_INFORMATION = np.linalg.inv(PRIOR_COVARIANCE)
_NO_INDICES, _NO_FLAGS = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)


@dataclass(frozen=True)
class LandmarkPose:
    """Pose of a camera from landmarks.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of its twist (rho, phi) in the camera's frame, from the corners' localisation error alone.
        points: (M, 3) of the landmarks that agree with it, world frame, metres.
        log_focal: logarithm of true over stated focal length under which the landmarks fit best; 0 where it is not
            known.
        log_focal_sd: its standard deviation, by the corners' localisation error alone.
        log_aspect: logarithm of the true over the stated aspect of the lens, the focal length along y over that along
            x, under which the landmarks fit best; 0 where it is not known.
        log_aspect_sd: as ``log_focal_sd``.
        rivals: (K, 6) twists from it to other poses that the landmarks allow, in the camera's frame: a flat view has
            several, and the covariance at one of them does not cover the others.
        rival_nats: (K,) by how much less likely these are, by the corners' localisation error alone; not negative.

    Raises:
        ValueError: the pose is not rigid, or the covariance is not finite, symmetric and positive semidefinite.
    """

    pose: FloatArray
    covariance: FloatArray
    points: FloatArray
    log_focal: float = 0.0
    log_focal_sd: float = math.inf
    log_aspect: float = 0.0
    log_aspect_sd: float = math.inf
    rivals: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    rival_nats: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if np.shape(self.pose) != (4, 4) or not is_rigid(self.pose):
            raise ValueError("the pose of landmarks must be a rigid T_world_camera, (4, 4)")
        if np.shape(self.covariance) != (6, 6) or not np.isfinite(self.covariance).all():
            raise ValueError("the covariance of a landmark pose must be finite, (6, 6)")
        if not is_covariance(self.covariance):
            raise ValueError("the covariance of a landmark pose must be symmetric and positive semidefinite")


@dataclass(frozen=True)
class LandmarkMeasurement:
    """What an image shows of the landmarks that should be in view.

    Attributes:
        expected: number of landmarks in view of a camera at the prior.
        found: number of these that agree with one pose near the prior.
        pose: that pose; None where too few agree, or where they leave a direction undetermined.
        visible: (E,) int64, indices in the room's landmarks of those in view; empty where it is not known which of
            them were found.
        is_found: (E,) bool, whether each of these agrees.
        is_shown: (E,) bool, false at the border, where no keypoint is detected, and where a large part of the image
            shows nothing at all, such as a hand before half of the lens, which is no evidence about the room. If it
            is not given, the image shows something everywhere.

    Raises:
        ValueError: ``is_found`` does not have the length of ``visible``.
    """

    expected: int = 0
    found: int = 0
    pose: LandmarkPose | None = None
    visible: NDArray[np.int64] = field(default_factory=lambda: _NO_INDICES)
    is_found: NDArray[np.bool_] = field(default_factory=lambda: _NO_FLAGS)
    is_shown: NDArray[np.bool_] = field(default_factory=lambda: _NO_FLAGS)

    def __post_init__(self) -> None:
        if len(self.is_found) != len(self.visible):
            raise ValueError(
                f"is_found must have shape ({len(self.visible)},) as visible, got ({len(self.is_found)},)"
            )
        if len(self.is_shown) != len(self.visible):
            object.__setattr__(self, "is_shown", np.ones(len(self.visible), dtype=np.bool_))


def is_within_prior(pose: FloatArray, prior: FloatArray, covariance: FloatArray) -> bool:
    """Whether a pose (4, 4) lies within the 99 % bound of a prior; landmarks are then searched for near it.

    Args:
        prior, covariance: as given to :meth:`LandmarkLocalizer.measure`, which widens the prior.
    """
    offset = se3_log(invert(prior) @ pose)
    return float(offset @ np.linalg.solve(covariance + PRIOR_COVARIANCE, offset)) < CHI2_6_QUANTILE_99


def prior_radius_m(covariance: FloatArray) -> float:
    """A pose distance that no pose within the bound of :func:`is_within_prior` exceeds.

    The distance is at most ``|rho| + |phi|`` of the twist. Its square, over the ellipsoid ``x^T C^-1 x < q``, is at
    most ``q (largest variance of rho + of phi + 2 largest covariance of both)``.

    Args:
        covariance: of the prior, as for :func:`is_within_prior`.
    """
    wide = covariance + PRIOR_COVARIANCE
    shift, turn, both = (np.linalg.norm(part, 2) for part in (wide[:3, :3], wide[3:, 3:], wide[:3, 3:]))
    return float(np.sqrt(CHI2_6_QUANTILE_99 * (shift + turn + 2.0 * both)))


Seen = TypeVar("Seen")
"""What a :class:`LandmarkLocalizer` detects in an image, such as keypoints."""


class LandmarkLocalizer(Protocol[Seen]):
    """Measures poses by landmarks; :class:`monoloc.landmarks.orb_localizer.OrbLandmarkLocalizer` is one.

    With ``threads = 2``, :meth:`detect` and :meth:`measure` run in a second thread, beside odometry and particles.
    """

    def detect(self, color: NDArray[np.uint8]) -> Seen:
        """What an image (H, W, 3) uint8 RGB shows, before anything is known of the pose."""
        ...

    def measure(self, seen: Seen, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """Landmarks in an image, near a prior.

        Args:
            seen: of :meth:`detect`.
            prior: ``T_world_camera``, (4, 4), and its covariance, (6, 6).

        Returns:
            Its pose is the measurement alone, without the prior, since the filter fuses both.
        """
        ...

    def relocalize(self, seen: Seen) -> LandmarkPose | None:
        """Pose from an image, without a prior; None where too few landmarks agree.

        It must be strict: this pose overrules the scan.

        Args:
            seen: of :meth:`detect`.
        """
        ...


class NoLandmarks:
    """For a room without landmarks."""

    def detect(self, color: NDArray[np.uint8]) -> None:
        return None

    def measure(self, seen: None, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        return LandmarkMeasurement()

    def relocalize(self, seen: None) -> LandmarkPose | None:
        return None


@dataclass(frozen=True)
class PoseFit:
    """A pose that M matches lead to.

    Attributes:
        pose: ``T_world_camera``, (4, 4), without the prior that led to it.
        covariance: (6, 6) of its twist, from the corners' localisation error alone.
        points: (M, 3) of the landmarks, world frame, metres.
        rays, sd: of the keypoints, as :meth:`monoloc.landmarks.features.Keypoints.rays` gives them.
        weights: (M,) by which the matches count, 0 to 1.
    """

    pose: FloatArray
    covariance: FloatArray
    points: FloatArray
    rays: FloatArray
    sd: FloatArray
    weights: FloatArray

    def measurement(self) -> LandmarkPose:
        """The pose with what the same matches say of the lens and of rivals."""
        seen = self.points, self.rays, self.sd, self.pose
        focal = _core.fit_log_focal(*seen, _FOCAL_INFORMATION, _LENS_KERNEL_SDS, _NEAREST_M)
        aspect = _core.fit_log_aspect(*seen, _ASPECT_INFORMATION, _LENS_KERNEL_SDS, _NEAREST_M)
        rivals, nats = self.rivals
        less_likely = np.maximum(nats - _nats(self.weights), 0.0)
        points = self.points[self.weights > _AGREE_WEIGHT]
        return LandmarkPose(self.pose, self.covariance, points, *focal, *aspect, rivals, less_likely)

    @cached_property
    def rivals(self) -> tuple[FloatArray, FloatArray]:
        """Other poses that the matches lead to, as twists (K, 6) from the one found, and their costs (K,), nats."""
        starts = flat_view_starts(self.pose, self.covariance)
        poses, nats = np.empty_like(starts), np.empty(len(starts))
        for index, start in enumerate(starts):
            fit = _core.fit_pose(self.points, self.rays, self.sd, start, _PRIOR_INFORMATION, _KERNEL_SDS, _NEAREST_M)
            poses[index], _, _, weights = fit
            nats[index] = _nats(weights)
        return se3_log(invert(self.pose) @ poses), nats


def fit_matches(
    points: FloatArray, seen: Keypoints, camera: Camera, prior: FloatArray, covariance: FloatArray
) -> tuple[NDArray[np.bool_], PoseFit | None]:
    """Pose of a camera that sees points (M, 3), world frame, as M keypoints, of which some are wrong matches.

    Gauss-Newton with Geman-McClure weights that start wide (Yang et al., *Graduated Non-Convexity for Robust Spatial
    Perception*, 2020) rejects wrong matches with the help of the prior. The pose returned is the measurement without
    the prior, since the filter fuses both. The formulas: :mod:`monoloc.landmarks.landmark_numpy_twins`.

    A wrong match far from all others agrees with the pose that it leads to. So a pose that rests on one match more
    than on the others is fitted again without it.

    Returns:
        Which points agree, (M,) bool, and the pose: None where these are too few, or where they leave a direction
        undetermined.
    """
    rays, sd = seen.rays(camera)
    information = np.asarray(np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(6)), dtype=np.float64)
    kept, agree = np.arange(len(points)), np.zeros(len(points), dtype=np.bool_)
    while True:
        some = points[kept], rays[kept], sd[kept]
        pose, normal, gradient, weights = _core.fit_pose(*some, prior, information, _KERNEL_SDS, _NEAREST_M)
        agree[kept] = weights > _AGREE_WEIGHT
        if int(agree.sum()) < LEAST_LANDMARKS or np.linalg.eigvalsh(normal)[0] < 1.0 / _UNOBSERVABLE_SD**2:
            return agree, None
        spread = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        leverages = _core.leverages(*some, pose, spread, weights, _NEAREST_M)
        worst = int(leverages.argmax())
        if leverages[worst] <= _MOST_LEVERAGE:
            return agree, PoseFit(pose @ se3_exp(-spread @ gradient), spread, *some, weights)
        agree[kept[worst]] = False
        kept = np.delete(kept, worst)


def pose_by_consensus(points: FloatArray, seen: Keypoints, camera: Camera, triples: int) -> FloatArray | None:
    """``T_world_camera`` (4, 4) that most of N matches agree with; None where too few do.

    RANSAC over the poses of triples, each fitted to the matches that agree with it; see
    :func:`monoloc.landmarks.landmark_numpy_twins.find_consensus`.

    Args:
        points: (N, 3) of the landmarks, world frame.
        seen: their keypoints.
        triples: that are tried, at most.
    """
    if len(points) < LEAST_LANDMARKS:
        return None
    rays = camera.rays(seen.pixels)[:, :2]
    pose, agreeing = _core.find_consensus(
        points, rays, camera.ray_spread(rays), _NEAREST_M, _AGREE_PX, triples, _CONFIDENCE
    )
    return pose if len(agreeing) >= _LEAST_AGREEING else None


def flat_view_starts(pose: FloatArray, covariance: FloatArray) -> FloatArray:
    """From where the other poses of a flat view are found, if one of them is known: (S, 4, 4).

    A plane that is seen from afar looks nearly the same from poses turned about it (Schweighofer and Pinz, *Robust
    Pose Estimation from a Planar Target*, 2006). They lie along the direction that it determines least.
    """
    weakest = np.linalg.eigh(covariance)[1][:, -1]
    turn = float(np.linalg.norm(weakest[3:]))
    return pose @ se3_exp(_TURNS_RAD[:, None] / turn * weakest) if turn > 0.0 else np.zeros((0, 4, 4))


def _nats(weights: FloatArray) -> float:
    """Negative log-likelihood of landmarks from their Geman-McClure weights (M,), nats."""
    return 0.5 * float(_KERNEL_SDS[-1]) ** 2 * float(np.sum(1.0 - np.sqrt(weights)))
