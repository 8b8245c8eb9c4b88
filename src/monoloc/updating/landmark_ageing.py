"""Landmarks that are no longer there, and corners that may become landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.landmark_triangulation import DEPTH_SD, Corners, landmarks_of
from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.editing.joined_landmarks import is_among
from monoloc.geometry import FloatArray, invert, transform
from monoloc.landmarks.features import Keypoints, match_descriptors
from monoloc.landmarks.landmark_map import FAMILIAR_TIMES, Landmarks, LandmarkViews
from monoloc.supervision.integrity import IntegrityModel
from monoloc.supervision.map_change import touching
from monoloc.updating.observed_flight import ObservedFlight, UsableFrame
from monoloc.updating.tally import MOST_NATS, Tally, bernoulli_nats

_RADIUS_PX = 8.0  # around a corner's expected pixel, as for landmarks
_MOST_CANDIDATES = 6000  # 500 kB
_LEAST_FINDS = 3  # views of a flight that found a corner, for a new candidate
_MOST_RATE = 0.95
_CELL_M, _NEIGHBOUR_NATS = 0.2, 1.0  # edge of the cells around landmarks; what one says of others


@dataclass(frozen=True)
class Candidates:
    """Corners that may become landmarks.

    Attributes:
        corners: their points, descriptors and the views of the map from near which they were found.
        tally: of their being there.
    """

    corners: Landmarks
    tally: Tally

    @classmethod
    def none(cls, views: LandmarkViews) -> Candidates:
        found = np.zeros((len(views.poses), 0), dtype=np.bool_)
        return cls(replace(Landmarks.none(), views=LandmarkViews(views.poses, found)), Tally.new(0))

    def __len__(self) -> int:
        return len(self.corners)

    def select(self, chosen: NDArray[np.bool_ | np.int64]) -> Candidates:
        return Candidates(self.corners.select(chosen), self.tally[chosen])


def landmarks_after(tally: Tally, landmarks: Landmarks, flight: ObservedFlight, model: IntegrityModel) -> Tally:
    """Evidence that landmarks are gone, after a flight.

    A landmark that is there is found as often as the flight's familiar landmarks are, which says how blurred and how
    dim the flight was; one that is gone, as often as landmarks that are not there. What moves is larger than a
    landmark: those around one speak for it, too, but a landmark of which no view spoke keeps its odds.
    """
    expected, found = _familiar_counts(flight, len(tally))
    there, strange = _found_rates(expected, found, model)
    missed = expected - found
    nats = bernoulli_nats(expected, missed, 1.0 - strange, 1.0 - there)
    nats = np.where(expected > 0, nats + _of_neighbours(landmarks, nats), 0.0)
    return tally.after_flight(expected, missed, nats)


def candidates_after(
    candidates: Candidates,
    landmarks: Landmarks,
    flight: ObservedFlight,
    is_sensor_depth: bool,
    model: IntegrityModel,
) -> Candidates:
    """Evidence for new landmarks, after a flight.

    Those of earlier flights are expected near the views from which they were found; those that this flight shows for
    the first time wait for the next.
    """
    views = landmarks.views
    assert views is not None
    near = [views.nearest(frame.pose) for frame in flight.frames]
    expected, found, seen_from = _sought(candidates.corners, flight, near)
    rates = _found_rates(*_familiar_counts(flight, len(landmarks)), model)
    nats = bernoulli_nats(expected, found, *rates)
    tally = candidates.tally.after_flight(expected, found, nats)
    known = candidates.corners.views
    assert known is not None
    corners = replace(candidates.corners, views=LandmarkViews(views.poses, known.found | seen_from))
    before = Candidates(corners, tally)
    before = before.select(tally.is_above_prior)  # not those that were not found again
    fresh = _fresh(before.corners, landmarks, flight, near, is_sensor_depth)
    return _bounded(Candidates(with_more(before.corners, fresh.corners), before.tally + fresh.tally))


def with_more(landmarks: Landmarks, others: Landmarks) -> Landmarks:
    """Landmarks, and others that the same views found."""
    views, found = landmarks.views, others.views
    assert views is not None and found is not None
    return Landmarks(
        np.concatenate([landmarks.points, others.points]),
        np.concatenate([landmarks.descriptors, others.descriptors]),
        LandmarkViews(views.poses, np.concatenate([views.found, found.found], axis=1)),
    )


def without_known(candidates: Candidates, landmarks: Landmarks) -> Candidates:
    """The candidates that are no landmarks yet."""
    return candidates.select(~is_among(candidates.corners, landmarks))


def _found_rates(
    expected: NDArray[np.int64], found: NDArray[np.int64], model: IntegrityModel
) -> tuple[FloatArray, FloatArray]:
    """How often a flight finds landmarks that are there, and that are not."""
    rate = (found.sum() + model.familiar_found) / (expected.sum() + 1.0)
    strange = np.asarray(model.strange_found)
    return np.clip(rate, 1.5 * strange, max(_MOST_RATE, model.familiar_found)), strange


def _of_neighbours(landmarks: Landmarks, nats: FloatArray) -> FloatArray:
    """What the landmarks in the cell of each, and in those that touch it, say of it, (L,).

    Each has as little weight as it has in the state *map-changed*, since what hides one hides it for long.
    """
    bounded = np.clip(nats, -_NEIGHBOUR_NATS, _NEIGHBOUR_NATS)
    cells, cell_of = np.unique(np.floor(landmarks.points / _CELL_M).astype(np.int64), axis=0, return_inverse=True)
    cell_of = cell_of.reshape(-1)
    cell, other = touching(cells)
    sums = np.bincount(cell, np.bincount(cell_of, bounded, len(cells))[other], len(cells))
    most = MOST_NATS - _NEIGHBOUR_NATS  # so that neighbours alone decide nothing
    return np.asarray(np.clip(sums[cell_of] - bounded, -most, most))


def _familiar_counts(flight: ObservedFlight, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """In how many frames each of L landmarks was expected, and of these found, (L,)."""
    expected, found = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    for frame in flight.frames:
        is_expected = frame.familiar[frame.visible]
        expected[frame.visible[is_expected]] += 1
        found[frame.visible[is_expected & frame.is_found]] += 1
    return expected, found


def _sought(
    corners: Landmarks, flight: ObservedFlight, near: list[NDArray[np.int64]]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """In how many frames C corners were expected, and of these found, (C,), and from near which views, (V, C)."""
    views = corners.views
    assert views is not None
    expected = np.zeros(len(corners), dtype=np.int64)
    found = np.zeros(len(corners), dtype=np.int64)
    seen_from = np.zeros_like(views.found)
    for frame, nearest in zip(flight.frames, near, strict=True):
        which = _found_in(corners, frame, flight.detected)
        is_expected = np.zeros(len(corners), dtype=np.bool_)
        is_expected[_in_view(corners, frame, flight.detected)[0]] = True
        is_expected &= views.found[nearest].sum(axis=0) >= FAMILIAR_TIMES
        expected += is_expected
        found[which] += is_expected[which]
        seen_from[np.ix_(nearest, which)] = True
    return expected, found, seen_from


def _found_in(corners: Landmarks, frame: UsableFrame, detected: Camera) -> NDArray[np.int64]:
    """Indices of corners that a frame finds among its keypoints that are no landmarks."""
    if not len(corners):
        return np.zeros(0, dtype=np.int64)
    visible, pixels = _in_view(corners, frame, detected)
    seen = frame.keypoints.select(np.flatnonzero(~frame.is_landmark))
    which, _ = match_descriptors(pixels, corners.descriptors[visible], seen.pixels, seen.descriptors, _RADIUS_PX)
    return np.asarray(visible[which])


def _in_view(corners: Landmarks, frame: UsableFrame, detected: Camera) -> tuple[NDArray[np.int64], FloatArray]:
    """Indices of corners in view of a frame, (E,), and their pixels, (E, 2)."""
    return detected.in_view(transform(invert(frame.pose), corners.points.astype(np.float64)))


def _fresh(
    known: Landmarks,
    landmarks: Landmarks,
    flight: ObservedFlight,
    near: list[NDArray[np.int64]],
    is_sensor_depth: bool,
) -> Candidates:
    """Corners that this flight is the first to show."""
    poses = np.stack([frame.pose for frame in flight.frames])
    depth_sd = DEPTH_SD if is_sensor_depth else float(flight.depth_error.sd_m(np.array(1.0)))  # relative, at a metre
    seen = landmarks_of([_unmatched(frame, flight) for frame in flight.frames], flight.detected, poses, depth_sd)
    seen = seen.select(~is_among(seen, known) & ~is_among(seen, landmarks))
    views = known.views
    assert views is not None
    seen = replace(seen, views=LandmarkViews(views.poses, np.zeros((len(views.poses), len(seen)), dtype=np.bool_)))
    _, _, seen_from = _sought(seen, flight, near)
    finds = np.zeros(len(seen), dtype=np.int64)
    for frame in flight.frames:
        finds[_found_in(seen, frame, flight.detected)] += 1
    is_seen = (finds >= _LEAST_FINDS) & (seen_from.sum(axis=0) >= FAMILIAR_TIMES)
    seen = replace(seen, views=LandmarkViews(views.poses, seen_from)).select(is_seen)
    counts = finds[is_seen]
    certain = np.full(len(seen), np.inf)
    return Candidates(seen, Tally.new(len(seen)).after_flight(counts, counts, certain))


def _unmatched(frame: UsableFrame, flight: ObservedFlight) -> Corners:
    """Keypoints that are no landmarks, as uncertain as the pose makes them."""
    seen = frame.keypoints.select(np.flatnonzero(~frame.is_landmark))
    if frame.depth is None:
        return Corners(seen, np.zeros(len(seen.pixels)))
    depth = frame.depth
    depth_m = sample_depth(seen.pixels.astype(np.float32), flight.detected, depth.depth_m, depth.camera)
    nearest_m = np.maximum(depth_m, 0.5)
    by_pose_px = flight.detected.focal_px * np.hypot(frame.pose_sd_m / nearest_m, frame.pose_sd_rad)
    return Corners(Keypoints(seen.pixels, seen.descriptors, np.hypot(seen.sd_px, by_pose_px)), depth_m)


def _bounded(candidates: Candidates) -> Candidates:
    """The likeliest ones, of equal odds the newest."""
    if len(candidates) <= _MOST_CANDIDATES:
        return candidates
    order = np.lexsort((np.arange(len(candidates)), candidates.tally.log_odds))
    return candidates.select(np.sort(order[-_MOST_CANDIDATES:]))
