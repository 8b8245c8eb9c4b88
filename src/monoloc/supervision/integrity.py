"""How probable it is that the belief is wrong, from what the map says of each frame.

A hidden Markov model (Rabiner 1989) of four conditions: the belief is right and landmarks are seen, it is right and
they are not (blur, darkness, a new viewpoint), landmarks of a thing that was moved mislead it, or it is wrong for
another reason. In the last two, the camera is not where the covariance says.
The build measures how often each number of landmarks, and each fit of the scan, occurs at right and at wrong poses.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, model_validator

from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import FloatArray
from monoloc.landmarks.landmark_map import FamiliarLandmarks
from monoloc.landmarks.pnp import LandmarkMeasurement
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate

WRONG_DISTANCE_M = 0.7
"""Pose distance from the true pose at which a build measures what a wrong belief looks like."""

LANDMARK_EDGES = (3.5, 7.5, 14.5, 29.5)  # between the classes of numbers of landmarks found
_LEAST_EXPECTED = 30  # landmarks in view, below which their number says nothing
_SCAN_PERCENTILES = (5.0, 20.0, 50.0)  # of the fits at right poses: edges between the classes of fits
_PSEUDO_COUNT = 0.5  # of each class, so that none is impossible
MOST_COUNTED_S = 0.25
"""That a frame adds to the time for which something was seen, however long ago the frame before was."""

# The errors of neighbouring frames are correlated: so long lasts what counts as one observation, of landmarks and of
# scans, whose depth errs alike for as long as the view is the same.
_LANDMARK_S, _SCAN_S = 0.15, 1.0
_FIRST_S = 0.05  # for which a first frame counts
_UNSEEN_S = 1.0  # time for which landmarks stay unseen
# Rates at which a belief becomes wrong, per second: with odometry, which a kidnap breaks; without, by motion as well.
_WRONG_RATE, _WRONG_RATE_WITHOUT_ODOMETRY = 0.001, 0.3
_WRONG_AT_BREAK = 0.1  # probability that the camera was displaced where odometry newly fails on an image
_LEAST_RIGHT = 1e-4  # probability of a right belief, however long the evidence against it: it can be believed again
_START_IS_WRONG, _LANDMARKS_ARE_WRONG = 0.02, 0.02  # probability of a given start, of a relocalisation by landmarks
# Probability of being misled where landmarks contradict a belief that was vouched for: landmarks that agree on one
# pose may all belong to a thing that was moved.
_MISLED_AT_CONTRADICTION, _VOUCHED_FOR_BELOW = 0.4, 0.05
_MISLED_S = 3.0  # time constant of trust in landmarks that go on agreeing
_LEAST_FAMILIAR = 30  # familiar landmarks in view, below which their share says nothing
# So large a part of the share that a build finds is assumed to be found in eight of ten frames at right poses, and in
# one of ten while a moved thing misleads.
_MANY_FOUND, _MANY_AT_RIGHT, _MANY_WHILE_MISLED = 0.65, 0.8, 0.1
_LEAST_SEARCH_PRECISION = 0.25  # of relocalisations by a scan, below which they are not tried


class Classes(BaseModel):
    """How often a quantity falls into each of C classes at right and at wrong poses.

    Attributes:
        edges: C - 1 ascending bounds between the classes.
        right, wrong: C probabilities each.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    edges: tuple[float, ...] = ()
    right: tuple[float, ...] = (1.0,)
    wrong: tuple[float, ...] = (1.0,)

    @model_validator(mode="after")
    def _check(self) -> Classes:
        if not len(self.right) == len(self.wrong) == len(self.edges) + 1:
            raise ValueError("right and wrong must have one probability more than there are edges")
        if min(*self.right, *self.wrong) <= 0.0 or list(self.edges) != sorted(self.edges):
            raise ValueError("probabilities must be positive, and edges ascending")
        return self

    @classmethod
    def from_values(cls, edges: ArrayLike, right: ArrayLike, wrong: ArrayLike) -> Classes:
        """From bounds (C - 1,) and measured values, any number each.

        Neighbouring classes are merged until a higher value never speaks less for a right pose (Ayer et al. 1955).
        Where values are as high at wrong poses as at right ones, a single class remains, which says nothing.
        """
        bounds = np.asarray(edges, dtype=np.float64).tolist()
        counts = np.stack(
            [
                np.bincount(np.searchsorted(bounds, values, side="right"), minlength=len(bounds) + 1)
                for values in (right, wrong)
            ]
        )
        while len(bounds):
            smoothed = counts + _PSEUDO_COUNT
            falls = np.flatnonzero(np.diff(smoothed[0] / smoothed[1]) < 0.0)
            if not len(falls):
                break
            first = int(falls[0])
            counts[:, first] += counts[:, first + 1]
            counts = np.delete(counts, first + 1, axis=1)
            del bounds[first]
        shares = (counts + _PSEUDO_COUNT) / (counts + _PSEUDO_COUNT).sum(axis=1, keepdims=True)
        return cls(edges=tuple(bounds), right=tuple(shares[0].tolist()), wrong=tuple(shares[1].tolist()))

    def likelihoods(self, value: float) -> tuple[float, float]:
        """Probability of a value's class at right and at wrong poses."""
        index = int(np.searchsorted(self.edges, value, side="right"))
        return self.right[index], self.wrong[index]


class IntegrityModel(BaseModel):
    """What a build measured of right and wrong poses.

    Attributes:
        scan: classes of the scan's mean log-likelihood at the particles' pose.
        landmarks: classes of the number of landmarks found; a single class where the room has none.
        unseen_share: share of frames at right poses, away from the build's viewpoints, whose landmarks are not seen.
        scan_search_precision: share of relocalisations by a scan that are less than :data:`FAR_M` off.
        focal_mean, focal_sd: of log-focal (:class:`monoloc.landmarks.pnp.LandmarkPose`) at right poses.
        familiar_found: share of the familiar landmarks in view that are found at right poses, see
            :class:`monoloc.supervision.map_change.MapChangeMonitor`; 0 if it was not measured, so that the map is
            never said to have changed.
        strange_found: the same of the landmarks that no view nearby found; such finds are wrong matches.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scan: Classes = Classes()
    landmarks: Classes = Classes()
    unseen_share: float = Field(0.5, gt=0.0, lt=1.0)
    scan_search_precision: float = Field(0.2, gt=0.0, lt=1.0)
    focal_mean: float = Field(0.0, ge=-10.0, le=10.0)
    focal_sd: float = Field(1.0, gt=0.0)
    familiar_found: float = Field(0.0, ge=0.0, lt=1.0)
    strange_found: float = Field(0.5, gt=0.0, lt=1.0)

    @property
    def supports_scan_search(self) -> bool:
        """Whether poses that a scan finds are right often enough to be verified."""
        return self.scan_search_precision >= _LEAST_SEARCH_PRECISION

    @property
    def scans_can_confirm(self) -> bool:
        """Whether there are fits that confirm a start."""
        return any(right > wrong for right, wrong in zip(self.scan.right, self.scan.wrong, strict=True))

    @property
    def knows_familiar(self) -> bool:
        """Whether familiar landmarks are found more often than wrong matches are; else their share says nothing."""
        return self.familiar_found > self.strange_found

    @staticmethod
    def scan_classes(right: ArrayLike, wrong: ArrayLike) -> Classes:
        """Classes of fits measured at right and at wrong poses."""
        edges = np.unique(np.percentile(np.asarray(right, dtype=np.float64), _SCAN_PERCENTILES))
        return Classes.from_values(edges, right, wrong)

    @staticmethod
    def landmark_classes(right: ArrayLike, wrong: ArrayLike) -> Classes:
        """Classes of numbers of landmarks found at right and at wrong poses."""
        return Classes.from_values(LANDMARK_EDGES, right, wrong)


class SensorModel(BaseModel):
    """What a build measured of a depth sensor's scans; by default nothing, so that they are no evidence.

    Attributes:
        thresholds: of their mean log-likelihood; None where the recording has no depth.
        scan, search_precision: as in :class:`IntegrityModel`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    thresholds: LikelihoodThresholds | None = None
    scan: Classes = Classes()
    search_precision: float = Field(0.2, gt=0.0, lt=1.0)


class IntegrityMonitor:
    """Follows the probability that a belief is wrong; a frame is :meth:`predict`, then :meth:`update`.

    Args:
        model: of the room.
        is_searched: whether the flight starts without a pose.
    """

    def __init__(self, model: IntegrityModel, is_searched: bool) -> None:
        self._model = model
        # Of four conditions: right and landmarks seen, right and not seen, misled by landmarks, wrong.
        self._probabilities = self._right_unless(1.0 if is_searched else _START_IS_WRONG)
        self._elapsed_s = 0.0
        self._odometry_tracked = True

    @property
    def probability_wrong(self) -> float:
        """That the belief is wrong, 0 to 1, whatever its covariance."""
        return float(self._probabilities[2:].sum())

    def probability_far(self, belief: Estimate) -> float:
        """That the position is more than :data:`FAR_M` off, because the belief is wrong or because it is wide."""
        sd_m = belief.position_sd_m
        if not math.isfinite(sd_m):
            return 1.0  # nothing is known of the position
        by_width = math.erfc(FAR_M / (math.sqrt(2.0) * sd_m)) if sd_m > 0.0 else 0.0
        return self.probability_wrong + (1.0 - self.probability_wrong) * by_width

    def with_doubt(self, belief: Estimate) -> Estimate:
        """The belief with a covariance that also covers a wrong one: off by :data:`WRONG_DISTANCE_M` in position, and
        by as many radians in rotation, in any direction.

        For frames that are not vouched for. It is never narrower than the belief's own.
        """
        wrong = np.eye(6) * (WRONG_DISTANCE_M**2 / 3.0)
        return replace(belief, covariance=belief.covariance + self.probability_wrong * wrong)

    def scan_speaks_for_the_pose(self, mean_log_likelihood: float) -> bool:
        """Whether a scan's fit is no less probable at right poses than at wrong ones."""
        right, wrong = self._model.scan.likelihoods(mean_log_likelihood)
        return right >= wrong

    def scan_confirms(self, mean_log_likelihood: float) -> bool:
        """Whether a scan's fit is more probable at right poses than at wrong ones, and so confirms a start."""
        right, wrong = self._model.scan.likelihoods(mean_log_likelihood)
        return right > wrong

    def landmarks_deny(self, landmarks: LandmarkMeasurement | None) -> bool:
        """Whether so few of the landmarks in view are found that this is more probable at wrong poses."""
        if landmarks is None or landmarks.expected < _LEAST_EXPECTED:
            return False
        right, wrong = self._model.landmarks.likelihoods(landmarks.found)
        return right < wrong

    def predict(self, elapsed_s: float, odometry_tracked: bool, image_is_new: bool) -> None:
        """The probabilities after a motion.

        Args:
            image_is_new: whether the image shows something, and not the same as before.
        """
        rate = _WRONG_RATE if odometry_tracked else _WRONG_RATE_WITHOUT_ODOMETRY
        becomes_wrong = 1.0 - math.exp(-rate * elapsed_s)
        if self._odometry_tracked and not odometry_tracked and image_is_new:
            becomes_wrong = max(becomes_wrong, _WRONG_AT_BREAK)
        self._elapsed_s = elapsed_s
        if image_is_new:  # of others odometry says nothing; the break shows at the next one
            self._odometry_tracked = odometry_tracked
        changes_sight = 1.0 - math.exp(-elapsed_s / _UNSEEN_S)
        seen, unseen, misled, wrong = self._probabilities
        trusted = misled * (1.0 - math.exp(-elapsed_s / _MISLED_S))
        right = seen + unseen + trusted
        unseen += changes_sight * (self._model.unseen_share * right - unseen)
        remaining = 1.0 - becomes_wrong
        self._probabilities = np.array(
            [(right - unseen) * remaining, unseen * remaining, misled - trusted, wrong + right * becomes_wrong]
        )

    def update(
        self,
        mean_log_likelihood: float,
        landmarks: LandmarkMeasurement | None,
        familiar: FamiliarLandmarks | None = None,
    ) -> None:
        """The probabilities after a frame's evidence.

        Args:
            mean_log_likelihood: of the scan; NaN where it says nothing, minus infinity where it fits elsewhere.
            landmarks: None where nothing was measured.
            familiar: those of them that views near the belief found; None where no view is near.
        """
        likelihood = np.ones(4)
        elapsed_s = self._elapsed_s if self._elapsed_s > 0.0 else _FIRST_S
        if not math.isnan(mean_log_likelihood):
            right, wrong = self._model.scan.likelihoods(mean_log_likelihood)
            likelihood *= np.array([right, right, wrong, wrong]) ** min(1.0, elapsed_s / _SCAN_S)
        if landmarks is not None and landmarks.expected >= _LEAST_EXPECTED:
            right, wrong = self._model.landmarks.likelihoods(landmarks.found)
            # A right belief whose landmarks are not seen finds as few as a wrong one, or some. One that is misled
            # finds many as long as the moved thing is in view, and few after that.
            some = max(wrong, 1.0 / len(self._model.landmarks.right))
            likelihood *= np.array([right, some, max(right, wrong), wrong]) ** min(1.0, elapsed_s / _LANDMARK_S)
        if familiar is not None and self._finds_many(familiar):
            misled = (_MANY_WHILE_MISLED / _MANY_AT_RIGHT) ** min(1.0, elapsed_s / _LANDMARK_S)
            likelihood *= np.array([1.0, 1.0, misled, 1.0])
        posterior = self._probabilities * likelihood
        self._probabilities = posterior / posterior.sum()
        if self.probability_wrong > 1.0 - _LEAST_RIGHT:
            self._probabilities *= 1.0 - _LEAST_RIGHT
            self._probabilities += _LEAST_RIGHT * self._right_unless(0.0)

    def _finds_many(self, familiar: FamiliarLandmarks) -> bool:
        """Whether so many of the familiar landmarks are found that hardly any can have been moved."""
        if not self._model.knows_familiar or len(familiar.indices) < _LEAST_FAMILIAR:
            return False
        return bool(familiar.is_found.mean() >= _MANY_FOUND * self._model.familiar_found)

    def contradicted_by_landmarks(self) -> None:
        """Landmarks measured a pose that the belief excluded; if the belief was vouched for, they may be wrong."""
        if self.probability_wrong < _VOUCHED_FOR_BELOW:
            self._probabilities *= 1.0 - _MISLED_AT_CONTRADICTION
            self._probabilities[2] += _MISLED_AT_CONTRADICTION

    def lose(self) -> None:
        """The position is unknown."""
        self._probabilities = self._right_unless(1.0)

    def found_by_landmarks(self) -> None:
        """The belief is a pose that landmarks found."""
        self._probabilities = self._right_unless(_LANDMARKS_ARE_WRONG)

    def found_by_scan(self) -> None:
        """The belief is a pose that scans found twice."""
        self._probabilities = self._right_unless((1.0 - self._model.scan_search_precision) ** 2)

    def _right_unless(self, wrong: float) -> FloatArray:
        unseen = self._model.unseen_share
        return np.array([(1.0 - wrong) * (1.0 - unseen), (1.0 - wrong) * unseen, 0.0, wrong])
