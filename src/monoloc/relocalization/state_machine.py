"""What happens to a camera that is lost: it is searched for, and what is found is verified before it is believed.

One scan can fit where the camera is not. So a pose that was found is first only followed, for a second; it is
believed if the search then finds no better place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from monoloc.geometry import pose_distance_m
from monoloc.landmarks.pnp import LandmarkPose
from monoloc.likelihood.scan import Scan
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.particle_filter.estimate import Estimate, estimate
from monoloc.particle_filter.particles import Particles
from monoloc.relocalization.search import GlobalRelocalizer

_SEARCH_PERIOD_S = 1.0  # between searches; and time for which scans do not fit until a camera is suspected to be lost
_SAME_PLACE_M = 0.3  # pose distance of two poses that count as one place
_SAME_PLACE_BY_LANDMARKS_M = 1.0  # the same for landmark poses, between which particles have drifted with the depth


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
    NOT_FOUND = "not found"
    """A search found no place that fits."""
    FOUND = "found"
    """A search found a place other than the current one."""
    UNDECIDED = "undecided"
    """A search found the place under verification again, but it does not fit well enough."""
    CONFIRMED = "confirmed"
    """A search, or landmarks, found the current place again."""


TRANSITIONS: dict[tuple[Mode, Event], Mode] = {
    (Mode.TRACKING, Event.POSITION_LOST): Mode.SEARCHING,
    (Mode.TRACKING, Event.NOT_FOUND): Mode.TRACKING,
    (Mode.TRACKING, Event.FOUND): Mode.VERIFYING,
    (Mode.TRACKING, Event.CONFIRMED): Mode.TRACKING,
    (Mode.SEARCHING, Event.POSITION_LOST): Mode.SEARCHING,
    (Mode.SEARCHING, Event.NOT_FOUND): Mode.SEARCHING,
    (Mode.SEARCHING, Event.FOUND): Mode.VERIFYING,
    (Mode.VERIFYING, Event.POSITION_LOST): Mode.VERIFYING,
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
        relocalized: whether a lost camera was confirmed at this frame.
    """

    mode: Mode
    particles: Particles
    relocalized: bool = False


class RelocalizationStateMachine:
    """Decides whether a camera is lost, and finds it; per frame, :meth:`update` and then :meth:`assess`.

    Args:
        relocalizer: None where a room cannot be searched; then the mode is always ``TRACKING``.
        thresholds: of the scan's likelihood.
        mode: at the start; ``SEARCHING`` where nothing is known of the pose.
    """

    def __init__(
        self, relocalizer: GlobalRelocalizer | None, thresholds: LikelihoodThresholds, mode: Mode = Mode.TRACKING
    ) -> None:
        self._relocalizer = relocalizer
        self._thresholds = thresholds
        self.mode = Mode.TRACKING if relocalizer is None else mode
        self._misfit_s = 0.0  # for how long scans have not fitted
        self._since_search_s = _SEARCH_PERIOD_S

    def update(
        self,
        particles: Particles,
        scan: Scan,
        elapsed_s: float,
        position_lost: bool,
        by_landmarks: Callable[[], LandmarkPose | None],
        rng: np.random.Generator,
    ) -> Relocalization:
        """The mode for a frame, after a search where one is due: by landmarks, or else by the scan.

        Args:
            particles: predicted for this frame.
            scan: of this frame; empty where it says nothing.
            elapsed_s: since the previous frame.
            position_lost: whether the predicted belief says nothing about the position.
            by_landmarks: relocalises by landmarks; called only if a search is due.
            rng: used only if a search is due.
        """
        if position_lost:
            self._transition(Event.POSITION_LOST)
        self._since_search_s += elapsed_s
        if self._relocalizer is None or not self._search_is_due(scan):
            return Relocalization(self.mode, particles)
        self._since_search_s = 0.0
        previous, current = self.mode, estimate(particles)
        seen = by_landmarks()
        place: Estimate | None
        if seen is not None:
            event, place = self._event_by_landmarks(seen, current)
        else:
            event, place = self._event_by_scan(self._relocalizer, scan, current, rng)
        if place is not None:
            particles = self._relocalizer.sample_around(place, len(particles), rng)
        self._transition(event)
        return Relocalization(self.mode, particles, previous is Mode.VERIFYING and self.mode is Mode.TRACKING)

    def assess(self, mean_log_likelihood: float, belief: Estimate, elapsed_s: float) -> None:
        """Take in how a frame ended.

        Args:
            mean_log_likelihood: of the scan at the particles' pose; NaN for an empty scan.
            belief: after the frame.
            elapsed_s: since the previous frame.
        """
        if belief.position_is_unknown:
            self._transition(Event.POSITION_LOST)
        if not math.isnan(mean_log_likelihood):
            fits = mean_log_likelihood >= self._thresholds.lost
            self._misfit_s = 0.0 if fits else self._misfit_s + elapsed_s

    def _search_is_due(self, scan: Scan) -> bool:
        is_suspected = self._misfit_s >= _SEARCH_PERIOD_S
        is_sought = self.mode is not Mode.TRACKING or is_suspected
        return is_sought and self._since_search_s >= _SEARCH_PERIOD_S and len(scan) > 0

    def _event_by_landmarks(self, seen: LandmarkPose, current: Estimate) -> tuple[Event, Estimate]:
        """Landmarks decide however the scan fits: they are there for where depth is wrong."""
        place = Estimate(seen.pose, seen.covariance, current.log_scale)
        is_same = _distance_m(current, place) < _SAME_PLACE_BY_LANDMARKS_M
        return (Event.CONFIRMED if self.mode is not Mode.SEARCHING and is_same else Event.FOUND), place

    def _event_by_scan(
        self, relocalizer: GlobalRelocalizer, scan: Scan, current: Estimate, rng: np.random.Generator
    ) -> tuple[Event, Estimate | None]:
        """The event, and the place that the particles go to, None if they stay."""
        place, value = relocalizer.relocalize(scan, current, rng)
        if value < self._thresholds.lost:
            return Event.NOT_FOUND, None
        if self.mode is Mode.VERIFYING and _distance_m(current, place) < _SAME_PLACE_M:
            return (Event.CONFIRMED if value >= self._thresholds.low else Event.UNDECIDED), None
        return Event.FOUND, place

    def _transition(self, event: Event) -> None:
        if self._relocalizer is None:
            return
        self.mode = TRANSITIONS[self.mode, event]
        if event is Event.CONFIRMED:
            self._misfit_s = 0.0


def _distance_m(one: Estimate, other: Estimate) -> float:
    return float(pose_distance_m(one.pose, other.pose[None])[0])
