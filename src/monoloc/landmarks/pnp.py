"""Where a camera is by the landmarks that it sees."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.geometry import FloatArray, hat, invert, make_pose, ray_slopes, se3_exp, se3_log, so3_exp, transform
from monoloc.landmarks.features import ALIKE_BITS, KeypointDetector, Keypoints, Landmarks, pairs

BESIDE = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2
"""Covariance of a pose, (6, 6), beside which landmarks are looked for where no belief has its own."""

_LEAST_REACH_PX, _MOST_REACH_PX = 6.0, 40.0
_FEWEST = 15  # landmarks that tell a pose
_BETTER = 0.85  # of a corner's likest landmark anywhere, than the likest at another place, for this not to count
_LIKEST, _APART_M = 8, 0.05  # landmarks among which another place is looked for, and how far away that is
_INLIER_PX, _FEWEST_ANYWHERE, _FEWEST_FOUND = 3.0, 8, 20
_WIDTHS = (24.0, 12.0, 6.0, 3.0, 3.0, 3.0)  # standard deviations at which a landmark counts a quarter, step by step
_LEAST_VARIANCE = 1e-8  # of a belief, m^2 and rad^2: a start may be said to be exact
_OPEN_SD = 0.3  # m or rad: what landmarks leave open by as much, they do not tell
_NEAREST_M = 0.05  # that a landmark may be before the camera


@dataclass(frozen=True)
class Sighting:
    """Where the camera is by the landmarks that it sees.

    Attributes:
        pose: ``T_world_camera``, (4, 4).
        covariance: (6, 6) of its twist (rho, phi) in the camera's frame, as far as corners' places err.
        points: (M, 3) of the landmarks that agree with it, world frame, metres.
    """

    pose: FloatArray
    covariance: FloatArray
    points: FloatArray


class LandmarkSight:
    """Finds a room's landmarks in the images of one camera.

    Where the belief tells where they should be seen, they are looked for there; where it does not, anywhere, as in
    :mod:`monoloc_lab.baselines.keypoints`, by triples (Gao et al. 2003) and RANSAC (Fischler & Bolles 1981).
    """

    def __init__(self, landmarks: Landmarks, camera: Camera) -> None:
        self._landmarks = landmarks
        self._detect = KeypointDetector(camera)

    def __call__(self, color: NDArray[np.uint8], belief: FloatArray, covariance: FloatArray) -> Sighting | None:
        """The pose by the landmarks that are where the belief says, or not far from there; None where too few are.

        Args:
            color: (H, W, 3) uint8 RGB.
            belief: ``T_world_camera``, (4, 4), and its covariance, (6, 6).
        """
        ahead, local = self._in_sight(belief)
        reach_px = self._reach_px(local, covariance)
        if reach_px > _MOST_REACH_PX:
            return self.anywhere(color)
        return self._among(ahead, local, reach_px, self._detect(color), belief, covariance)

    def anywhere(self, color: NDArray[np.uint8]) -> Sighting | None:
        """The pose by landmarks wherever they are, for a camera of which nothing is known; None where too few agree.

        Args:
            color: (H, W, 3) uint8 RGB.
        """
        seen = self._detect(color)
        place = self._place(seen)
        found = None if place is None else self.near(seen, place, BESIDE)
        return None if found is None or len(found.points) < _FEWEST_FOUND else found

    def near(self, seen: Keypoints, belief: FloatArray, covariance: FloatArray) -> Sighting | None:
        """The pose by the landmarks that are near where a belief says, of keypoints that were found already."""
        ahead, local = self._in_sight(belief)
        return self._among(ahead, local, self._reach_px(local, covariance), seen, belief, covariance)

    def _in_sight(self, belief: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Landmarks that a camera at the belief has before it, (M,), and where, (M, 3) in its frame."""
        local = transform(invert(belief), self._landmarks.points)
        ahead = np.flatnonzero(self._detect.camera.in_sight(local))
        return ahead, local[ahead]

    def _among(
        self,
        ahead: NDArray[np.int64],
        local: FloatArray,
        reach_px: float,
        seen: Keypoints,
        belief: FloatArray,
        covariance: FloatArray,
    ) -> Sighting | None:
        """The pose by some landmarks, which are expected at ``local``."""
        camera, room = self._detect.camera, self._landmarks
        expected = camera.project(local)
        which, where = pairs(expected, room.descriptors[ahead], seen.pixels, seen.descriptors, reach_px)
        points = room.points[ahead[which]].astype(np.float64)
        return solve(points, seen.select(where), camera, belief, covariance)

    def _reach_px(self, in_sight: FloatArray, covariance: FloatArray) -> float:
        """How far landmarks may be from where they are expected, (M, 3) in the camera's frame, as a rule: 3 sigma."""
        depth_m = float(np.median(in_sight[:, 2])) if len(in_sight) else 1.0
        return max(_LEAST_REACH_PX, 3.0 * self._detect.camera.focal_px * _turn_sd(covariance, depth_m))

    def _place(self, seen: Keypoints) -> FloatArray | None:
        """A pose, ``T_world_camera``, by what landmarks look like alone; None where too few agree."""
        known = self._landmarks.descriptors
        if min(len(seen.descriptors), len(known)) < _FEWEST:
            return None
        bits, nearest = cv2.batchDistance(seen.descriptors, known, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=_LIKEST)
        # Of one corner there may be several landmarks, by its sizes: the next best is one at another place.
        found = self._landmarks.points[nearest]
        is_elsewhere = np.linalg.norm(found - found[:, :1], axis=2) > _APART_M
        others = np.where(is_elsewhere, bits, 256).min(axis=1)
        alike = np.flatnonzero((bits[:, 0] < ALIKE_BITS) & (bits[:, 0] < _BETTER * others))
        if len(alike) < _FEWEST:
            return None
        camera = self._detect.camera
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            self._landmarks.points[nearest[alike, 0]].astype(np.float64),
            seen.pixels[alike],
            camera.matrix,
            np.asarray(camera.distortion),
            iterationsCount=1000,
            reprojectionError=_INLIER_PX,
            confidence=0.999,
            flags=cv2.SOLVEPNP_P3P,
        )
        if not ok or inliers is None or len(inliers) < _FEWEST_ANYWHERE:
            return None
        T_camera_world = make_pose(so3_exp(rotation.ravel()), translation.ravel())
        return invert(T_camera_world) if np.all(np.isfinite(T_camera_world)) else None


def solve(
    points: FloatArray, seen: Keypoints, camera: Camera, belief: FloatArray, covariance: FloatArray
) -> Sighting | None:
    """The pose of a camera that sees points (M, 3), world frame, as M keypoints, though some of these are others.

    Which, is decided with the belief at hand, by Geman and McClure's weights that begin wide (Yang et al., *Graduated
    Non-Convexity for Robust Spatial Perception*, 2020). The pose is what the points say without the belief, which is
    joined with it afterwards and would count twice.

    Returns:
        None where too few agree, or where those that do leave a direction open.
    """
    rays, sd = seen.rays(camera)
    pose: FloatArray = belief
    prior = np.asarray(np.linalg.inv(covariance + _LEAST_VARIANCE * np.eye(6)), dtype=np.float64)
    for width in _WIDTHS:
        normal, gradient, _ = _evidence(pose, points, rays, sd, width)
        off = se3_log(invert(belief) @ pose)
        pose = pose @ se3_exp(-np.linalg.solve(normal + prior, gradient + prior @ off))
    normal, gradient, weights = _evidence(pose, points, rays, sd, _WIDTHS[-1])
    agree = points[weights > 0.25]
    if len(agree) < _FEWEST or np.linalg.eigvalsh(normal)[0] < 1.0 / _OPEN_SD**2:
        return None
    spread = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return Sighting(pose @ se3_exp(-spread @ gradient), spread, agree)


def _evidence(
    pose: FloatArray, points: FloatArray, rays: FloatArray, sd: FloatArray, width: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of a pose's twist the normal matrix (6, 6) and gradient (6,), and of points the weights (M,).

    These are a quarter for a residual of ``width`` standard deviations.
    """
    local = transform(invert(pose), points)
    local[:, 2] = np.maximum(local[:, 2], _NEAREST_M)
    residuals = (local[:, :2] / local[:, 2:] - rays) / sd
    weights = (1.0 + np.sum(residuals**2, axis=1) / width**2) ** -2
    slopes = (_slopes(local) / sd[..., None]).reshape(-1, 6)
    weighted = slopes * np.repeat(weights, 2)[:, None]
    return weighted.T @ slopes, weighted.T @ residuals.ravel(), weights


def _slopes(local: FloatArray) -> FloatArray:
    """Of rays' x and y by the camera's twist, (M, 2, 6), for points (M, 3) in its frame."""
    by_point = ray_slopes(local)
    return np.concatenate([-by_point, by_point @ hat(local)], axis=2)


def _turn_sd(covariance: FloatArray, depth_m: float) -> float:
    """Standard deviation of the direction, rad, in which something at a depth is expected."""
    aside_m2 = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    turned = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    return float(np.sqrt(aside_m2 / depth_m**2 + turned))
