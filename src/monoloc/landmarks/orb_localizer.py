"""Localises a camera by a room's ORB landmarks, with a prior pose and without one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import FloatArray, invert, pose_distance_m, transform
from monoloc.landmarks.features import MATCH_BITS, KeypointDetector, Keypoints, match_descriptors, nearest_descriptors
from monoloc.landmarks.influential_corners import are_few_of_many
from monoloc.landmarks.landmark_cells import LandmarkCells
from monoloc.landmarks.landmark_map import LEAST_RELOCALIZED, Landmarks
from monoloc.landmarks.pnp import (
    LEAST_LANDMARKS,
    PRIOR_COVARIANCE,
    LandmarkMeasurement,
    LandmarkPose,
    PoseFit,
    fit_matches,
    flat_view_starts,
    is_within_prior,
    pose_by_consensus,
    prior_radius_m,
)

_LEAST_RADIUS_PX, _MOST_RADIUS_PX = 8.0, 50.0  # of the search around a landmark's expected pixel
_RATIO = 0.85  # of the best match's distance to that of the best match at another place (Lowe 2004)
_CANDIDATES, _OTHER_PLACE_M = 8, 0.05  # best matches among which another place is sought, and its distance
# Least spread of the landmarks that agree on a relocalisation. All landmarks of a narrower band may lie on a single
# object that was moved, such as a window on a screen. At true poses the least was 0.076 and 0.093 (two real rooms,
# frames near those of the build).
_LEAST_SPREAD = 0.075
# Largest height of an image, in focal lengths, that the spread is divided by; that of one of these rooms. A wider
# lens has a taller image, but a band of the same angle is worth as much in it.
_TALLEST = 0.914
# Pose distance from which two poses without a prior are two places, since a position that far off is of no use, and
# the share of the better pose's landmarks from which the other one is a rival.
_APART_M, _RIVAL_SHARE = FAR_M, 0.3
# Of a twist, m and rad, up to which two poses of a view are the same. In views that determine the pose, others that
# the same matches lead to were at 0.02 at most; those with which more landmarks agreed, beyond (a desk, two bundles).
_SAME_POSE = 0.02
_RIVAL_CANDIDATES, _MOST_RIVALS = 32, 8  # best matches of a keypoint among which other places are sought
_TRIPLES, _RIVAL_TRIPLES = 2000, 200  # of RANSAC
# A part of the image shows nothing where squares of so many tiles a side have no keypoint, and if such squares make
# up so much of the image.
_TILE_PX, _BLANK_TILES, _LEAST_BLANK = 40.0, 3, 0.25


@dataclass(frozen=True)
class _Agreement:
    """Landmarks that a camera near a prior may see, and those of them whose matches agree with one pose.

    Attributes:
        possible: (E,) indices of the landmarks.
        is_in_view: (E,) whether the image holds their expected pixel.
        is_shown: (E,) whether the image shows keypoints where they should be, see :func:`_is_shown`.
        found: (A,) indices in ``possible`` of those that agree.
        keypoints: (A,) indices of their keypoints.
        fit: the pose; None where too few agree, or where they leave a direction undetermined.
    """

    possible: NDArray[np.int64]
    is_in_view: NDArray[np.bool_]
    is_shown: NDArray[np.bool_]
    found: NDArray[np.int64]
    keypoints: NDArray[np.int64]
    fit: PoseFit | None

    def measurement(self) -> LandmarkMeasurement:
        is_found = np.zeros(len(self.possible), dtype=np.bool_)
        is_found[self.found] = True
        pose = None if self.fit is None else self.fit.measurement()
        visible = np.flatnonzero(self.is_in_view | is_found)
        return LandmarkMeasurement(
            len(visible), len(self.found), pose, self.possible[visible], is_found[visible], self.is_shown[visible]
        )


class OrbLandmarkLocalizer:
    """Finds a room's landmarks in the images of one camera.

    With a prior, each landmark is matched near its expected pixel. Without one, descriptors are matched over the
    whole image, and the pose is one that most matches agree with (RANSAC).

    Attributes:
        detector: of the keypoints in the camera's images.
    """

    def __init__(self, landmarks: Landmarks, camera: Camera) -> None:
        self._landmarks = landmarks
        self.detector = KeypointDetector(camera)
        self._cells = LandmarkCells(landmarks)

    def detect(self, color: NDArray[np.uint8]) -> Keypoints:
        """As :meth:`LandmarkLocalizer.detect`."""
        return self.detector(color)

    def measure(self, seen: Keypoints, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """As :meth:`LandmarkLocalizer.measure`; a prior that is vague only tells which landmarks are in view.

        Where two places that look alike are both within such a prior, nothing is measured.

        The prior's covariance is widened: otherwise, a belief that has drifted would select the matches that agree
        with it.
        """
        stated, covariance = covariance, covariance + PRIOR_COVARIANCE
        possible, local = self._possible(prior)
        if self._radius_px(local, covariance) <= _MOST_RADIUS_PX:
            return self._agreeing(seen, prior, covariance, (possible, local)).measurement()
        # Too vague to say where in the image a landmark is to be sought, but not where in the room.
        found = self._confirmed(seen, possible)
        if found is None or found.fit is None or not is_within_prior(found.fit.pose, prior, stated):
            return LandmarkMeasurement(len(self.detector.camera.in_view(local)[0]))
        measured = found.measurement()
        off_m = float(pose_distance_m(prior, found.fit.pose[None])[0])
        if measured.pose is None or off_m + prior_radius_m(stated) < _APART_M:  # no other place is within the prior
            return measured
        is_expected = partial(is_within_prior, prior=prior, covariance=stated)
        if self._fits_elsewhere(seen, found.keypoints, measured.pose, is_expected):
            return LandmarkMeasurement()  # they do not tell which of the places it is
        return measured

    def relocalize(self, seen: Keypoints) -> LandmarkPose | None:
        """As :meth:`LandmarkLocalizer.relocalize`; None too where two places look alike."""
        found, is_only_place = self.best_place(seen)
        return found if is_only_place else None

    def best_place(self, seen: Keypoints) -> tuple[LandmarkPose | None, bool]:
        """Pose that most landmarks agree with, without a prior, and whether no other place looks alike."""
        agreement = self._confirmed(seen, np.arange(len(self._landmarks)))
        found = None if agreement is None else agreement.measurement().pose
        if agreement is None or found is None:
            return None, False
        return found, not self._fits_elsewhere(seen, agreement.keypoints, found)

    def measure_near(self, seen: Keypoints, prior: FloatArray, covariance: FloatArray) -> LandmarkMeasurement:
        """As :meth:`measure`, with the prior's covariance as it is, and every landmark sought near its pixel."""
        return self._agreeing(seen, prior, covariance).measurement()

    def matched_keypoints(
        self, seen: Keypoints, prior: FloatArray
    ) -> tuple[LandmarkMeasurement, NDArray[np.int64], NDArray[np.int64]]:
        """Landmarks near a prior, and the indices, (A,), of those that agree and of their keypoints."""
        agreement = self._agreeing(seen, prior, PRIOR_COVARIANCE)
        return agreement.measurement(), agreement.possible[agreement.found], agreement.keypoints

    def _agreeing(
        self,
        seen: Keypoints,
        prior: FloatArray,
        covariance: FloatArray,
        sought: tuple[NDArray[np.int64], FloatArray] | None = None,
    ) -> _Agreement:
        """The matches near a prior that agree with one pose.

        Args:
            sought: of :meth:`_possible` at the prior, where it is known already.
        """
        possible, local = self._possible(prior) if sought is None else sought
        camera, room = self.detector.camera, self._landmarks
        expected = camera.project(local)
        which, where = match_descriptors(
            expected,
            room.descriptors.take(possible, axis=0),
            seen.pixels,
            seen.descriptors,
            self._radius_px(local, covariance),
        )
        points = room.points[possible[which]].astype(np.float64)
        agree, fit = fit_matches(points, seen.select(where), camera, prior, covariance)
        is_shown = self.detector.reaches(expected) & _is_shown(expected, seen.pixels, camera)
        return _Agreement(possible, camera.contains(expected), is_shown, which[agree], where[agree], fit)

    def _possible(self, prior: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Landmarks that a camera near the prior may see: indices (M,), and points in the prior's frame, (M, 3).

        Also those a little beyond the border of the image, since the prior may be wrong by so much.
        """
        nearby, points = self._cells.nearby(prior, self.detector.camera)
        local = transform(invert(prior), points)
        possible = np.flatnonzero(self.detector.camera.in_sight(local))
        return nearby.take(possible), local.take(possible, axis=0)

    def _radius_px(self, local: FloatArray, covariance: FloatArray) -> float:
        """Three standard deviations of the expected pixel of points (M, 3) in the camera's frame."""
        depth_m = float(np.median(local[:, 2])) if len(local) else 1.0
        return max(_LEAST_RADIUS_PX, 3.0 * self.detector.camera.focal_px * _direction_sd(covariance, depth_m))

    def _pose_without_prior(self, seen: Keypoints, possible: NDArray[np.int64]) -> FloatArray | None:
        """``T_world_camera`` (4, 4) from descriptors of some landmarks; None where too few agree."""
        if min(len(seen.descriptors), len(possible)) < LEAST_LANDMARKS:
            return None
        # One that differs by more bits is not the best match, nor near enough to the best for the ratio test.
        most_bits = math.ceil(MATCH_BITS / _RATIO)
        bits, nearest = self._candidates(seen, possible, _CANDIDATES, most_bits)
        # One corner may have several landmarks, one a scale: the ratio test is with the best at another place.
        found = self._landmarks.points[nearest]
        is_elsewhere = np.linalg.norm(found - found[:, :1], axis=2) > _OTHER_PLACE_M
        others = np.where(is_elsewhere, bits, 256).min(axis=1)
        matched = np.flatnonzero((bits[:, 0] < MATCH_BITS) & (bits[:, 0] < _RATIO * others))
        return self._pose_by_consensus(seen.select(matched), nearest[matched, 0], _TRIPLES)

    def _confirmed(self, seen: Keypoints, possible: NDArray[np.int64]) -> _Agreement | None:
        """What agrees with a pose from descriptors alone; None where too little does.

        Args:
            possible: indices of the landmarks that may be in view.
        """
        place = self._pose_without_prior(seen, possible)
        if place is None:
            return None
        best = self._best_of_flat_view(seen, place)
        where = best.keypoints
        is_confirmed = len(where) >= LEAST_RELOCALIZED and self._spread(seen.pixels[where]) >= _LEAST_SPREAD
        return best if is_confirmed and not self._may_agree_by_chance(best) else None

    def _may_agree_by_chance(self, agreement: _Agreement) -> bool:
        if agreement.fit is None:
            return False
        points = self._landmarks.points[agreement.possible[agreement.found]].astype(np.float64)
        in_view = int(np.count_nonzero(agreement.is_in_view & agreement.is_shown))
        return are_few_of_many(transform(invert(agreement.fit.pose), points), in_view)

    def _best_of_flat_view(self, seen: Keypoints, place: FloatArray) -> _Agreement:
        """Of the poses that a flat view leads to from a place (4, 4), the one that most landmarks agree with.

        Landmarks are matched anew only around poses that the matches at the place allow.
        """
        best = self._agreeing(seen, place, PRIOR_COVARIANCE)
        if best.fit is None:
            return best
        starts, (rivals, _) = flat_view_starts(best.fit.pose, best.fit.covariance), best.fit.rivals
        for start in starts[np.linalg.norm(rivals, axis=1) > _SAME_POSE]:
            other = self._agreeing(seen, start, PRIOR_COVARIANCE)
            if other.fit is not None and len(other.keypoints) > len(best.keypoints):
                best = other
        return best

    def _spread(self, pixels: FloatArray) -> float:
        """Standard deviation of pixels (A, 2) along the direction in which it is least, in image heights."""
        variance = float(np.linalg.eigvalsh(np.cov(pixels.T))[0])
        camera = self.detector.camera
        return math.sqrt(max(variance, 0.0)) / min(camera.height, _TALLEST * camera.focal_px)

    def _fits_elsewhere(
        self,
        seen: Keypoints,
        where: NDArray[np.int64],
        found: LandmarkPose,
        is_possible: Callable[[FloatArray], bool] = lambda pose: True,
    ) -> bool:
        """Whether keypoints that agree with a pose agree with another one, far away, nearly as well.

        Args:
            where: (A,) indices of the keypoints that agree with the pose.
            is_possible: whether the camera may be at a pose (4, 4).
        """
        agreeing = seen.select(where)
        bits, nearest = self._candidates(agreeing, np.arange(len(self._landmarks)), _RIVAL_CANDIDATES, MATCH_BITS)
        points = self._landmarks.points[nearest]
        local = transform(invert(found.pose), points.reshape(-1, 3)).reshape(points.shape)
        off_m = np.linalg.norm(
            local[..., :2] - local[..., 2:] * agreeing.rays(self.detector.camera)[0][:, None], axis=2
        )
        is_rival = (off_m > _OTHER_PLACE_M) & (bits < MATCH_BITS)
        # Several places may look alike; each is as wide as what agrees.
        width_m = 2.0 * float(
            np.percentile(np.linalg.norm(found.points - np.median(found.points, axis=0), axis=1), 90)
        )
        for _ in range(_MOST_RIVALS):
            if np.count_nonzero(is_rival.any(axis=1)) < LEAST_LANDMARKS:
                return False
            seed = np.unravel_index(int(np.where(is_rival, bits, 256).argmin()), bits.shape)
            is_here = is_rival & (np.linalg.norm(points - points[seed], axis=2) < width_m)
            rival = self._rival_at(seen, agreeing, np.where(is_here, bits, 256), nearest, found)
            if rival is not None and is_possible(rival):
                return True
            is_rival &= ~is_here
        return False

    def _rival_at(
        self,
        seen: Keypoints,
        agreeing: Keypoints,
        bits: NDArray[np.int32],
        nearest: NDArray[np.int64],
        found: LandmarkPose,
    ) -> FloatArray | None:
        """A pose (4, 4) at another place that the candidates of the A agreeing keypoints allow; None without one.

        Args:
            bits, nearest: of the candidates, (A, C); those that are not of that place have 256 bits.
        """
        rows, best = np.flatnonzero(bits.min(axis=1) < MATCH_BITS), bits.argmin(axis=1)
        other = self._pose_by_consensus(agreeing.select(rows), nearest[rows, best[rows]], _RIVAL_TRIPLES)
        rival = None if other is None else self.measure_near(seen, other, PRIOR_COVARIANCE).pose
        if rival is None or float(pose_distance_m(found.pose, rival.pose[None])[0]) < _APART_M:
            return None
        return rival.pose if len(rival.points) >= _RIVAL_SHARE * len(found.points) else None

    def _candidates(
        self, seen: Keypoints, possible: NDArray[np.int64], count: int, most_bits: int
    ) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Of each of N keypoints, the differing bits and the indices of the most similar landmarks, (N, C) each.

        Args:
            possible: indices of the landmarks to choose from.
            count: of landmarks a keypoint, at most.
            most_bits: as :func:`monoloc.landmarks.features.nearest_descriptors`.
        """
        known = self._landmarks.descriptors.take(possible, axis=0)
        bits, nearest = nearest_descriptors(seen.descriptors, known, min(count, len(known)), most_bits)
        return bits, possible[nearest]

    def _pose_by_consensus(self, seen: Keypoints, landmarks: NDArray[np.int64], triples: int) -> FloatArray | None:
        """``T_world_camera`` (4, 4) that most of N keypoints and their landmarks agree with; None where too few do.

        Args:
            landmarks: (N,) indices.
            triples: of RANSAC, at most.
        """
        points = self._landmarks.points[landmarks].astype(np.float64)
        return pose_by_consensus(points, seen, self.detector.camera, triples)


def _is_shown(pixels: FloatArray, keypoints: FloatArray, camera: Camera) -> NDArray[np.bool_]:
    """Whether the image shows anything at pixels (E, 2): false within large parts of it without a keypoint (N, 2)."""
    size = np.array([max(1, round(side / _TILE_PX)) for side in (camera.width, camera.height)])
    tile_px = np.array([camera.width, camera.height]) / size

    def tile_of(places: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        columns, rows = np.clip((places / tile_px).astype(np.int64), 0, size - 1).T
        return rows, columns

    is_blank = np.ones(size[::-1], dtype=np.uint8)
    is_blank[tile_of(keypoints)] = 0
    square = np.ones((_BLANK_TILES, _BLANK_TILES), np.uint8)
    large = cv2.morphologyEx(is_blank, cv2.MORPH_OPEN, square, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    if large.mean() < _LEAST_BLANK:
        return np.ones(len(pixels), dtype=np.bool_)
    return np.asarray(large[tile_of(pixels)] == 0)


def _direction_sd(covariance: FloatArray, depth_m: float) -> float:
    """Standard deviation, rad, of the direction to a point at a depth."""
    position = float(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    rotation = float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])
    return float(np.sqrt(position / depth_m**2 + rotation))
