"""Pose of a camera from the landmarks that it sees."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import (
    FloatArray,
    hat,
    invert,
    make_pose,
    pose_distance_m,
    ray_jacobian,
    se3_exp,
    se3_log,
    so3_exp,
    transform,
)
from monoloc.landmarks.features import MATCH_BITS, KeypointDetector, Keypoints, match_descriptors
from monoloc.landmarks.landmark_map import Landmarks

PRIOR_COVARIANCE = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2
"""Covariance of a prior pose, (6, 6), where no belief states one."""

LEAST_LANDMARKS = 15
"""Number of landmarks that determine a pose."""

_LEAST_RADIUS_PX, _MOST_RADIUS_PX = 6.0, 40.0  # of the search around a landmark's expected pixel
_RATIO = 0.85  # of the best match's distance to that of the best match at another place (Lowe 2004)
_CANDIDATES, _OTHER_PLACE_M = 8, 0.05  # best matches among which another place is sought, and its distance
_INLIER_PX, _LEAST_INLIERS, _LEAST_CONFIRMED = 3.0, 8, 20
# Of a relocalisation: a single object that was moved, such as a window on a screen, may hold all of less spread.
# At true poses the least was 0.076 and 0.093 (two real rooms, frames near those of the build).
_LEAST_SPREAD = 0.075
# Of two poses without a prior: pose distance from which they are two, and the share of the better one's landmarks
# with which the other counts as well.
_APART_M, _RIVAL_SHARE = 0.5, 0.3
# Of RANSAC. Where two places look alike, most of the keypoints that agree with one agree with the other.
_ITERATIONS, _RIVAL_ITERATIONS = 1000, 100
_KERNEL_SDS = (24.0, 12.0, 6.0, 3.0, 3.0, 3.0)  # standard deviations at which a landmark's weight is a quarter
_LEAST_VARIANCE = 1e-8  # of a prior, m^2 and rad^2: a start may be stated as exact
_UNOBSERVABLE_SD = 0.3  # m or rad: a direction that landmarks constrain no better is not determined
_NEAREST_M = 0.05  # depth of a landmark
_FOCAL_KERNEL_SDS = (
    12.0,
    6.0,
    3.0,
    3.0,
    3.0,
)  # narrower: the pose is known, but for what the focal length does to it
_SHIFT_SD_M, _TURN_SD_RAD, _FOCAL_SD = 0.5, 0.1, 0.2  # of what a wrong focal length does to a pose, and of its log
_AGREE_WEIGHT = 0.25  # of a landmark that agrees
_CHI2_99_6 = 16.8  # 99 % quantile of the chi-squared distribution with 6 degrees of freedom
_NO_INDICES, _NO_FLAGS = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.bool_)


@dataclass(frozen=True)
class LandmarkPose:
    """Pose of a camera from landmarks.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of its twist (rho, phi) in the camera's frame, from the corners' localisation error alone.
        points: (M, 3) of the landmarks that agree with it, world frame, metres.
        log_focal: logarithm of true over stated focal length under which the landmarks fit best; 0 where they tell
            nothing of it.
        log_focal_sd: its standard deviation, by the corners' localisation error alone.
    """

    pose: FloatArray
    covariance: FloatArray
    points: FloatArray
    log_focal: float = 0.0
    log_focal_sd: float = math.inf


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
    """

    expected: int = 0
    found: int = 0
    pose: LandmarkPose | None = None
    visible: NDArray[np.int64] = field(default_factory=lambda: _NO_INDICES)
    is_found: NDArray[np.bool_] = field(default_factory=lambda: _NO_FLAGS)


class LandmarkLocalizer(Protocol):
    """Measures poses by landmarks; :class:`OrbLandmarkLocalizer` is one."""

    def measure(self, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """Landmarks in an image (H, W, 3) uint8 RGB, near a prior.

        Args:
            prior: ``T_world_camera``, (4, 4), and its covariance, (6, 6).

        Returns:
            Its pose is the measurement alone, without the prior, since the filter fuses both.
        """
        ...

    def relocalize(self, color: NDArray[np.uint8]) -> LandmarkPose | None:
        """Pose from an image (H, W, 3) uint8 RGB, without a prior; None where too few landmarks agree.

        It must be strict: this pose overrules the scan.
        """
        ...


class NoLandmarks:
    """For a room without landmarks."""

    def measure(self, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        return LandmarkMeasurement()

    def relocalize(self, color: NDArray[np.uint8]) -> LandmarkPose | None:
        return None


class OrbLandmarkLocalizer:
    """Finds a room's landmarks in the images of one camera.

    With a prior, each landmark is matched near its expected pixel. Without one, descriptors are matched over the
    whole image, and the pose comes from triples (Gao et al. 2003) and RANSAC (Fischler & Bolles 1981).
    """

    def __init__(self, landmarks: Landmarks, camera: Camera) -> None:
        self._landmarks = landmarks
        self._detect = KeypointDetector(camera)

    def measure(self, color: NDArray[np.uint8], prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """As :meth:`LandmarkLocalizer.measure`; a prior that is vague only tells which landmarks are in view.

        The prior counts as vaguer than it is stated: a belief that has drifted would else select the matches that
        agree with it.
        """
        covariance = covariance + PRIOR_COVARIANCE
        visible, local = self._visible(prior)
        seen = self._detect(color)
        if self._radius_px(local, covariance) <= _MOST_RADIUS_PX:
            return self.measure_keypoints(seen, prior, covariance)
        # Too vague to say where in the image a landmark is to be sought, but not where in the room.
        pose = self._confirmed(seen, visible)[0]
        if pose is None or not _is_within(pose.pose, prior, covariance):
            return LandmarkMeasurement(len(visible))
        return LandmarkMeasurement(len(visible), len(pose.points), pose)

    def relocalize(self, color: NDArray[np.uint8]) -> LandmarkPose | None:
        """As :meth:`LandmarkLocalizer.relocalize`; None too where two places look alike."""
        seen = self._detect(color)
        found, where = self._confirmed(seen, np.arange(len(self._landmarks)))
        return None if found is None or self._fits_elsewhere(seen, where, found) else found

    def measure_keypoints(self, seen: Keypoints, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """As :meth:`LandmarkLocalizer.measure`, from keypoints that are detected already."""
        return self._agreeing(seen, prior, covariance)[0]

    def _agreeing(
        self, seen: Keypoints, prior: FloatArray, covariance: FloatArray
    ) -> tuple[LandmarkMeasurement, NDArray[np.int64]]:
        """As :meth:`measure_keypoints`, with the indices of the keypoints whose landmarks agree."""
        visible, local = self._visible(prior)
        camera, room = self._detect.camera, self._landmarks
        which, where = match_descriptors(
            camera.project(local),
            room.descriptors[visible],
            seen.pixels,
            seen.descriptors,
            self._radius_px(local, covariance),
        )
        points = room.points[visible[which]].astype(np.float64)
        agree, pose = pose_from_matches(points, seen.select(where), camera, prior, covariance)
        is_found = np.zeros(len(visible), dtype=np.bool_)
        is_found[which[agree]] = True
        return LandmarkMeasurement(len(visible), int(agree.sum()), pose, visible, is_found), where[agree]

    def _visible(self, prior: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Indices (M,) of the landmarks in view of a camera at the prior, and their points in its frame, (M, 3)."""
        local = transform(invert(prior), self._landmarks.points)
        visible = np.flatnonzero(self._detect.camera.in_sight(local))
        return visible, local[visible]

    def _radius_px(self, local: FloatArray, covariance: FloatArray) -> float:
        """Three standard deviations of the expected pixel of points (M, 3) in the camera's frame."""
        depth_m = float(np.median(local[:, 2])) if len(local) else 1.0
        return max(_LEAST_RADIUS_PX, 3.0 * self._detect.camera.focal_px * _direction_sd(covariance, depth_m))

    def _pose_without_prior(self, seen: Keypoints, possible: NDArray[np.int64]) -> FloatArray | None:
        """``T_world_camera`` (4, 4) from descriptors of some landmarks; None where too few agree."""
        if min(len(seen.descriptors), len(possible)) < LEAST_LANDMARKS:
            return None
        bits, nearest = self._candidates(seen, possible)
        # One corner may have several landmarks, one a scale: the ratio test is with the best at another place.
        found = self._landmarks.points[nearest]
        is_elsewhere = np.linalg.norm(found - found[:, :1], axis=2) > _OTHER_PLACE_M
        others = np.where(is_elsewhere, bits, 256).min(axis=1)
        matched = np.flatnonzero((bits[:, 0] < MATCH_BITS) & (bits[:, 0] < _RATIO * others))
        return self._pose_by_consensus(seen.pixels[matched], nearest[matched, 0], _ITERATIONS)

    def _confirmed(
        self, seen: Keypoints, possible: NDArray[np.int64]
    ) -> tuple[LandmarkPose | None, NDArray[np.int64]]:
        """Pose from descriptors alone, and the indices of the keypoints whose landmarks agree.

        Args:
            possible: indices of the landmarks that may be in view.
        """
        place = self._pose_without_prior(seen, possible)
        if place is None:
            return None, _NO_INDICES
        measured, where = self._agreeing(seen, place, PRIOR_COVARIANCE)
        is_confirmed = len(where) >= _LEAST_CONFIRMED and self._spread(seen.pixels[where]) >= _LEAST_SPREAD
        return measured.pose if is_confirmed else None, where

    def _spread(self, pixels: FloatArray) -> float:
        """Standard deviation of pixels (A, 2) along the direction in which it is least, in image heights."""
        variance = float(np.linalg.eigvalsh(np.cov(pixels.T))[0])
        return math.sqrt(max(variance, 0.0)) / self._detect.camera.height

    def _fits_elsewhere(self, seen: Keypoints, where: NDArray[np.int64], found: LandmarkPose) -> bool:
        """Whether keypoints that agree with a pose agree with another one, far away, nearly as well.

        Args:
            where: (A,) indices of the keypoints that agree with the pose.
        """
        agreeing = seen.select(where)
        bits, nearest = self._candidates(agreeing, np.arange(len(self._landmarks)))
        local = transform(invert(found.pose), self._landmarks.points[nearest].reshape(-1, 3)).reshape(
            *nearest.shape, 3
        )
        off_m = np.linalg.norm(
            local[..., :2] - local[..., 2:] * agreeing.rays(self._detect.camera)[0][:, None], axis=2
        )
        rivals = np.where(off_m > _OTHER_PLACE_M, bits, 256)
        best = rivals.argmin(axis=1)
        rows = np.flatnonzero(rivals.min(axis=1) < MATCH_BITS)
        other = self._pose_by_consensus(agreeing.pixels[rows], nearest[rows, best[rows]], _RIVAL_ITERATIONS)
        rival = None if other is None else self.measure_keypoints(seen, other, PRIOR_COVARIANCE).pose
        if rival is None or float(pose_distance_m(found.pose, rival.pose[None])[0]) < _APART_M:
            return False
        return len(rival.points) >= _RIVAL_SHARE * len(found.points)

    def _candidates(
        self, seen: Keypoints, possible: NDArray[np.int64]
    ) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Of each of N keypoints, the differing bits and the indices of the most similar landmarks, (N, 8) each.

        Args:
            possible: indices of the landmarks to choose from.
        """
        known = self._landmarks.descriptors[possible]
        bits, nearest = cv2.batchDistance(
            seen.descriptors, known, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=min(_CANDIDATES, len(known))
        )
        return np.asarray(bits, dtype=np.int32), possible[np.asarray(nearest)]

    def _pose_by_consensus(
        self, pixels: FloatArray, landmarks: NDArray[np.int64], iterations: int
    ) -> FloatArray | None:
        """``T_world_camera`` (4, 4) that most of N matches agree with; None where they are too few.

        Args:
            pixels: (N, 2).
            landmarks: (N,) indices.
            iterations: of RANSAC, at most.
        """
        if len(pixels) < LEAST_LANDMARKS:
            return None
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            self._landmarks.points[landmarks].astype(np.float64),
            *self._detect.camera.for_pnp(pixels),
            iterationsCount=iterations,
            reprojectionError=_INLIER_PX,
            confidence=0.999,
            flags=cv2.SOLVEPNP_P3P,
        )
        if not ok or inliers is None or len(inliers) < _LEAST_INLIERS:
            return None
        T_camera_world = make_pose(so3_exp(rotation.ravel()), translation.ravel())
        return invert(T_camera_world) if np.all(np.isfinite(T_camera_world)) else None


def pose_from_matches(
    points: FloatArray, seen: Keypoints, camera: Camera, prior: FloatArray, covariance: FloatArray
) -> tuple[NDArray[np.bool_], LandmarkPose | None]:
    """Pose of a camera that sees points (M, 3), world frame, as M keypoints, of which some are wrong matches.

    Gauss-Newton with Geman-McClure weights that start wide (Yang et al., *Graduated Non-Convexity for Robust Spatial
    Perception*, 2020) rejects wrong matches with the help of the prior. The pose returned is the measurement without
    the prior, since the filter fuses both.

    Returns:
        Which points agree, (M,) bool, and the pose: None where these are too few, or where they leave a direction
        undetermined.
    """
    rays, sd = seen.rays(camera)
    pose: FloatArray = prior
    information = np.asarray(np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(6)), dtype=np.float64)
    for kernel_sd in _KERNEL_SDS:
        normal, gradient, _ = _normal_equations(pose, points, rays, sd, kernel_sd)
        offset = se3_log(invert(prior) @ pose)
        pose = pose @ se3_exp(-np.linalg.solve(normal + information, gradient + information @ offset))
    normal, gradient, weights = _normal_equations(pose, points, rays, sd, _KERNEL_SDS[-1])
    agree = weights > _AGREE_WEIGHT
    if int(agree.sum()) < LEAST_LANDMARKS or np.linalg.eigvalsh(normal)[0] < 1.0 / _UNOBSERVABLE_SD**2:
        return agree, None
    spread = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    focal = _log_focal(pose, points, rays, sd)
    return agree, LandmarkPose(pose @ se3_exp(-spread @ gradient), spread, points[agree], *focal)


def _log_focal(pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Logarithm of true over stated focal length, and its standard deviation, from landmarks (M, 3) seen as rays.

    The residuals of a wrong focal length grow with the radius; a step along the view takes up a part of them. So pose
    and focal length are estimated together, again from a wide kernel, since those that agreed with a wrong focal
    length are near the centre.
    """
    start, log_focal = pose, 0.0
    information = np.diag(np.repeat([_SHIFT_SD_M, _TURN_SD_RAD, _FOCAL_SD], [3, 3, 1]) ** -2)
    for kernel_sd in _FOCAL_KERNEL_SDS:
        seen = rays * np.exp(-log_focal)  # a ray is a pixel over the focal length
        residuals, jacobian = _residuals(pose, points, seen, sd)
        columns = np.concatenate([jacobian, (seen / sd)[..., None]], axis=2).reshape(-1, 7)
        weighted = columns * np.repeat(_weights(residuals, kernel_sd), 2)[:, None]
        normal = weighted.T @ columns + information
        offset = np.append(se3_log(invert(start) @ pose), log_focal)
        step = -np.linalg.solve(normal, weighted.T @ residuals.ravel() + information @ offset)
        pose, log_focal = pose @ se3_exp(step[:6]), log_focal + float(step[6])
    return log_focal, float(np.sqrt(np.linalg.inv(normal)[6, 6]))


def _normal_equations(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, kernel_sd: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrix (6, 6) and gradient (6,) of the pose's twist, and weights (M,) of the points.

    A weight is a quarter at a residual of ``kernel_sd`` standard deviations.
    """
    residuals, jacobian = _residuals(pose, points, rays, sd)
    weights = _weights(residuals, kernel_sd)
    flat = jacobian.reshape(-1, 6)
    weighted = flat * np.repeat(weights, 2)[:, None]
    return weighted.T @ flat, weighted.T @ residuals.ravel(), weights


def _weights(residuals: FloatArray, kernel_sd: float) -> FloatArray:
    """Geman-McClure weights (M,) of residuals (M, 2) in standard deviations."""
    return np.asarray((1.0 + np.sum(residuals**2, axis=1) / kernel_sd**2) ** -2)


def _residuals(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Residuals (M, 2) in standard deviations, and their derivative by the pose's twist, (M, 2, 6)."""
    local = transform(invert(pose), points)
    local[:, 2] = np.maximum(local[:, 2], _NEAREST_M)
    return (local[:, :2] / local[:, 2:] - rays) / sd, _jacobian(local) / sd[..., None]


def _jacobian(local: FloatArray) -> FloatArray:
    """Derivative of rays' x and y by the camera's twist, (M, 2, 6), for points (M, 3) in its frame."""
    by_point = ray_jacobian(local)
    return np.concatenate([-by_point, by_point @ hat(local)], axis=2)


def _is_within(pose: FloatArray, prior: FloatArray, covariance: FloatArray) -> bool:
    """Whether a pose (4, 4) is one that a prior expects, up to one in a hundred."""
    offset = se3_log(invert(prior) @ pose)
    return float(offset @ np.linalg.solve(covariance, offset)) < _CHI2_99_6


def _direction_sd(covariance: FloatArray, depth_m: float) -> float:
    """Standard deviation, rad, of the direction to a point at a depth."""
    position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    return float(np.sqrt(position / depth_m**2 + rotation))
