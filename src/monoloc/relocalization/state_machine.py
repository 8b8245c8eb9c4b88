"""What happens to a camera that is lost: it is searched for, by landmarks or by scans.

Landmarks that agree on a pose without a prior are decisive if it does not rest on a few corners: the belief starts
anew there, in the same frame. If it does, or while the belief is only uncertain, two searches in turn must find the
same place. A scan is not decisive: it can fit where the camera is not. So scans search only where landmarks cannot:
in a room without any, and with a depth sensor in the dark. A pose that a scan found is first only followed, for a
second; it is believed if the search then finds no better place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np

from monoloc.evaluation.consistency import FAR_M
from monoloc.geometry import FloatArray, invert, pose_distance_m
from monoloc.landmarks.influential_corners import sd_without_influential_corners
from monoloc.landmarks.pnp import LandmarkPose, is_within_prior
from monoloc.likelihood.scan import Scan
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization.search import GlobalRelocalizer

SUSPECTED = 0.5
"""Probability of a wrong belief from which the camera is searched for."""

Doubt = Literal["none", "uncertain", "lost"]
"""Of a belief: its state; none where it is vouched for, or where landmarks are found near it."""

_SCAN_PERIOD_S, _LANDMARK_PERIOD_S = 1.0, 0.2  # between searches
# Pose distance of two poses that count as one place, and of what two searches by landmarks find there. Wrong poses of
# flat pictures lie some decimetres apart from image to image.
_SAME_PLACE_M, _FOUND_AGAIN_M = 0.3, 0.15
# Standard deviation of a position without its most influential corners: up to the first, one search is enough, and up
# to the second two are.
_FOUND_SD_M, _FOUND_AGAIN_SD_M = 0.1, FAR_M


class Mode(Enum):
    """Mode of the relocalisation."""

    TRACKING = "tracking"
    """The belief is followed, by scans and landmarks."""
    SEARCHING = "searching"
    """The pose is unknown; only odometry moves the belief."""
    VERIFYING = "verifying"
    """The particles are where a search found the camera and follow scans; the belief does not follow them yet."""


class Event(Enum):
    """What changes the mode."""

    POSITION_LOST = "position lost"
    """The belief's covariance no longer says where in the room the camera is."""
    LANDMARKS_FOUND = "landmarks found"
    """Landmarks found a place other than the belief's."""
    NOT_FOUND = "not found"
    """A scan's search found no place that fits."""
    FOUND = "found"
    """A scan's search found a place that fits, and that is not under verification."""
    UNDECIDED = "undecided"
    """A scan's search found the place under verification again, but it does not fit well enough."""
    CONFIRMED = "confirmed"
    """A scan's search found the place under verification again."""


TRANSITIONS: dict[tuple[Mode, Event], Mode] = {
    (Mode.TRACKING, Event.POSITION_LOST): Mode.SEARCHING,
    (Mode.TRACKING, Event.LANDMARKS_FOUND): Mode.TRACKING,
    (Mode.TRACKING, Event.NOT_FOUND): Mode.TRACKING,
    (Mode.TRACKING, Event.FOUND): Mode.VERIFYING,
    (Mode.SEARCHING, Event.POSITION_LOST): Mode.SEARCHING,
    (Mode.SEARCHING, Event.LANDMARKS_FOUND): Mode.TRACKING,
    (Mode.SEARCHING, Event.NOT_FOUND): Mode.SEARCHING,
    (Mode.SEARCHING, Event.FOUND): Mode.VERIFYING,
    (Mode.VERIFYING, Event.POSITION_LOST): Mode.VERIFYING,
    (Mode.VERIFYING, Event.LANDMARKS_FOUND): Mode.TRACKING,
    (Mode.VERIFYING, Event.NOT_FOUND): Mode.SEARCHING,
    (Mode.VERIFYING, Event.FOUND): Mode.VERIFYING,
    (Mode.VERIFYING, Event.UNDECIDED): Mode.VERIFYING,
    (Mode.VERIFYING, Event.CONFIRMED): Mode.TRACKING,
}
"""The mode after an event, for every event that can happen in a mode."""


@dataclass(frozen=True)
class Relocalization:
    """What the relocalisation made of a frame.

    Attributes:
        mode: for this frame.
        particles: where they go on from.
        landmark_pose: where landmarks found the camera at this frame; the belief starts anew there.
        confirmed: whether a place that scans had found was confirmed at this frame.
        awaits_landmarks: whether the camera is lost, or is searched for, where landmarks could be seen. A scan says
            nothing of the belief then: particles of a lost camera wander, and sooner or later their scan fits as at
            right poses.
        is_searched: whether the room was searched at this frame, which takes time.
    """

    mode: Mode
    particles: Particles
    landmark_pose: LandmarkPose | None = None
    confirmed: bool = False
    awaits_landmarks: bool = False
    is_searched: bool = False


class RelocalizationStateMachine:
    """Decides when a camera is searched for, and by what.

    Args:
        relocalizer: draws particles around places, and searches by scans.
        searches_by_scan: whether one scan tells the places of the room apart.
        searches_by_landmarks: whether the room has landmarks; scans then search only in images that say nothing.
            Where neither searches, a lost camera stays with its belief, which scans may correct: no search could
            bring it back.
        thresholds: of the scan's likelihood.
        mode: at the start; ``SEARCHING`` where nothing is known of the pose.
    """

    def __init__(
        self,
        relocalizer: GlobalRelocalizer,
        searches_by_scan: bool,
        searches_by_landmarks: bool,
        thresholds: LikelihoodThresholds,
        mode: Mode = Mode.TRACKING,
    ) -> None:
        self._relocalizer = relocalizer
        self._searches_by_scan, self._searches_by_landmarks = searches_by_scan, searches_by_landmarks
        self._thresholds = thresholds
        self.mode = mode
        self._since_scan_search_s = _SCAN_PERIOD_S
        self._since_landmark_search_s = _LANDMARK_PERIOD_S
        # From the belief to where the last search by landmarks found the camera instead, in the world's frame.
        self._elsewhere: FloatArray | None = None

    def update(
        self,
        particles: Particles,
        belief: Estimate,
        scan: Scan,
        elapsed_s: float,
        probability_wrong: float,
        doubt: Doubt,
        by_landmarks: Callable[[], LandmarkPose | None] | None,
        rng: np.random.Generator,
    ) -> Relocalization:
        """The mode for a frame, after a search where one is due: by landmarks, or else by the scan.

        Args:
            particles, belief: predicted for this frame.
            scan: of this frame; empty where depth says nothing.
            elapsed_s: since the previous frame.
            probability_wrong: that the belief is wrong.
            doubt: after the frame before.
            by_landmarks: relocalises by landmarks; called only if a search is due. None where the image says nothing.
            rng: used only if a search is due.
        """
        if not (self._searches_by_scan or self._searches_by_landmarks):
            return Relocalization(self.mode, particles)
        if belief.position_is_unknown:
            self._transition(Event.POSITION_LOST)
        self._since_scan_search_s += elapsed_s
        self._since_landmark_search_s += elapsed_s
        is_sought = self.mode is not Mode.TRACKING or probability_wrong >= SUSPECTED
        if not is_sought and doubt == "none":
            self._elsewhere = None
            return Relocalization(self.mode, particles)
        is_due = self._searches_by_landmarks and self._since_landmark_search_s >= _LANDMARK_PERIOD_S
        search = by_landmarks if is_due else None
        seen = None
        if search is not None:
            self._since_landmark_search_s = 0.0
            seen = self._other_place(search(), belief, is_sought)
        if seen is not None:
            self._transition(Event.LANDMARKS_FOUND)
            place = Estimate(seen.pose, seen.covariance, estimate(particles).log_scale)
            particles = self._relocalizer.sample_around(place, len(particles), rng)
            return Relocalization(self.mode, particles, landmark_pose=seen, is_searched=True)
        could_see = self._searches_by_landmarks and by_landmarks is not None
        if not is_sought or could_see:
            awaits = could_see and (is_sought or doubt == "lost")
            return Relocalization(self.mode, particles, awaits_landmarks=awaits, is_searched=search is not None)
        if len(scan) > 0 and self._searches_by_scan and self._since_scan_search_s >= _SCAN_PERIOD_S:
            self._since_scan_search_s = 0.0
            return self._search_by_scan(particles, scan, rng)
        return Relocalization(self.mode, particles)

    def _other_place(self, seen: LandmarkPose | None, belief: Estimate, is_sought: bool) -> LandmarkPose | None:
        """What a search by landmarks found, if the belief is to start anew there.

        A wrong place is seldom found twice. So a place must be one that the search before found too, if it rests on a
        few corners, or while the belief is only uncertain.
        """
        before, self._elsewhere = self._elsewhere, None
        if seen is None or self._is_believed(seen, belief):
            return None
        self._elsewhere = seen.pose @ invert(belief.pose)
        is_found_again = before is not None and _is_same_place(before @ belief.pose, seen.pose, _FOUND_AGAIN_M)
        if not (is_sought or is_found_again):
            return None
        most_m = _FOUND_AGAIN_SD_M if is_found_again else _FOUND_SD_M
        return seen if sd_without_influential_corners(seen) < most_m else None

    def _is_believed(self, seen: LandmarkPose, belief: Estimate) -> bool:
        """Whether landmarks found the camera where it is believed to be; then measuring near the prior is enough.

        It is not where the belief is more certain than it is right: it would be measured only within its covariance.
        """
        if self.mode is not Mode.TRACKING:
            return False
        is_within = is_within_prior(seen.pose, belief.pose, belief.covariance)
        return is_within and _is_same_place(seen.pose, belief.pose)

    def _search_by_scan(self, particles: Particles, scan: Scan, rng: np.random.Generator) -> Relocalization:
        current = estimate(particles)
        place, value = self._relocalizer.relocalize(scan, current, rng)
        event = self._event(value, float(pose_distance_m(current.pose, place.pose[None])[0]))
        was_verifying = self.mode is Mode.VERIFYING
        self._transition(event)
        if event is Event.FOUND:
            particles = self._relocalizer.sample_around(place, len(particles), rng)
        confirmed = was_verifying and event is Event.CONFIRMED
        return Relocalization(self.mode, particles, confirmed=confirmed, is_searched=True)

    def _event(self, value: float, distance_m: float) -> Event:
        """Of a scan's mean log-likelihood at the best place, and that place's distance from the current one."""
        if value < self._thresholds.lost:
            return Event.NOT_FOUND
        if self.mode is Mode.VERIFYING and distance_m < _SAME_PLACE_M:
            return Event.CONFIRMED if value >= self._thresholds.low else Event.UNDECIDED
        return Event.FOUND

    def _transition(self, event: Event) -> None:
        self.mode = TRANSITIONS[self.mode, event]


def _is_same_place(pose: FloatArray, other: FloatArray, most_m: float = _SAME_PLACE_M) -> bool:
    return float(pose_distance_m(pose, other[None])[0]) < most_m
