"""Where the room is no longer as the map says.

Landmarks that the build found from views near the camera's are *familiar*: they are found again in two frames of
three, unless something else stands there now. Where those of one region are missing, while those of the rest of the
same images are found, the map has changed in that region.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray
from monoloc.landmarks.landmark_map import FamiliarLandmarks, Landmarks
from monoloc.supervision.distinct_views import DistinctViews
from monoloc.supervision.integrity import MOST_COUNTED_S, IntegrityModel

_CELL_M = 0.2  # edge of the cells of space; one is tested together with those that touch it
_OBSERVATION_S = 0.5  # that counts as one observation, since errors of neighbouring frames are correlated
_VIEW_MEMORY_S = 3.0  # time constant of the mean over images of one view, which is one observation however long it is
_FOUND_HERE_NATS = -0.7  # of a view's mean: a landmark that about half of its images show can be found from there
_FIRST_S = 0.05  # for which a first frame counts
# Evidence that one landmark gives, nats. It is bounded, since what hides a landmark hides it for long: only several
# missing landmarks show a change.
_LEAST_NATS, _MOST_NATS = -3.0, 1.0
_CHANGED_NATS, _UNCHANGED_NATS = 5.0, 2.5  # of evidence: from the first on a cell is changed, until below the second
_LEAST_S = 0.5  # for which it must be so while the cell is in view: what passes by does not change the map
_FORGOTTEN_S = 60.0  # time constant of evidence that is not renewed
_CERTAIN_BELOW = 0.05  # probability that the pose is far off
_LEAST_REST = 8  # familiar landmarks in view around a cell
_EXPLAINED = 0.5  # of the share of familiar landmarks that a build finds, at least found around a cell


@dataclass(frozen=True)
class ChangedRegion:
    """A box in which the map no longer holds.

    Attributes:
        lower, upper: corners, (3,), world frame, metres.
    """

    lower: FloatArray
    upper: FloatArray

    @property
    def centre(self) -> FloatArray:
        return np.asarray(0.5 * (self.lower + self.upper))

    @property
    def size(self) -> FloatArray:
        return np.asarray(self.upper - self.lower)


def merged(regions: Iterable[ChangedRegion]) -> list[tuple[ChangedRegion, int]]:
    """Regions of many frames, those that overlap as one, with the number of frames that named it; the most first."""
    found: list[tuple[ChangedRegion, int]] = []
    for region in regions:
        frames = 1
        apart = []
        for other, count in found:
            if np.all(region.lower < other.upper) and np.all(region.upper > other.lower):
                lower, upper = np.minimum(region.lower, other.lower), np.maximum(region.upper, other.upper)
                region, frames = ChangedRegion(lower, upper), frames + count
            else:
                apart.append((other, count))
        found = [*apart, (region, frames)]
    return sorted(found, key=lambda each: -each[1])


class MapChangeMonitor:
    """Follows the evidence that the map has changed, in each cell of space that has landmarks.

    Where nothing has changed, a familiar landmark is found as often as those in the rest of the image. Where
    something else stands now, it is found as often as landmarks that are not there.

    Args:
        landmarks: of the room.
        model: what the build measured.
    """

    def __init__(self, landmarks: Landmarks, model: IntegrityModel) -> None:
        self._tells_changes = model.knows_familiar
        self._familiar_found, self._strange_found = model.familiar_found, model.strange_found
        cells = np.floor(landmarks.points.astype(np.float64) / _CELL_M).astype(np.int64)
        self._cells, cell_of = np.unique(cells, axis=0, return_inverse=True)
        self._cell_of: NDArray[np.int64] = cell_of.reshape(-1)
        self._neighbours = _neighbours(self._cells)
        self._views = DistinctViews()
        # Of each landmark: evidence; that of earlier views; sum over the present view's images, times the seconds
        # between them; and these seconds.
        self._nats, self._earlier, self._sum, self._seen_s = np.zeros((4, len(landmarks)))
        self._is_found_here = np.zeros(len(landmarks), dtype=np.bool_)  # from the present view
        self._above_s = np.zeros(len(self._cells))
        self._is_changed = np.zeros(len(self._cells), dtype=np.bool_)
        self._was_in_view = np.zeros(len(self._cells), dtype=np.bool_)
        self._region: ChangedRegion | None = None  # in view in the last frame whose landmarks were looked for

    def forget(self) -> None:
        """Drop all evidence."""
        for each in (self._nats, self._earlier, self._sum, self._seen_s, self._above_s):
            each[:] = 0.0
        self._is_found_here[:], self._is_changed[:] = False, False
        self._region = None

    def update(
        self,
        familiar: FamiliarLandmarks | None,
        probability_far: float,
        pose: FloatArray,
        elapsed_s: float,
        is_left_out: bool = False,
    ) -> ChangedRegion | None:
        """The changed region in view after a frame; of several, the one with most evidence.

        Args:
            familiar: of the landmarks in a frame that gave a pose; None where there is no such pose, or where no view
                is near.
            probability_far: that the belief's position is far off; an uncertain pose is no evidence about the map.
            pose: of the belief, (4, 4).
            elapsed_s: since the previous frame.
            is_left_out: whether no landmarks were looked for, so that what was in view before still counts.
        """
        elapsed_s = elapsed_s if elapsed_s > 0.0 else _FIRST_S
        for each in (self._nats, self._earlier, self._sum):
            each *= math.exp(-elapsed_s / _FORGOTTEN_S)  # also in frames that say nothing
        is_certain = probability_far < _CERTAIN_BELOW
        if is_left_out and is_certain:
            return self._region
        self._region = None
        if familiar is None or not self._tells_changes or not is_certain:
            return None
        in_view = self._cell_of[familiar.indices]
        if self._views.is_new(pose):
            self._earlier[:], self._sum[:], self._seen_s[:], self._is_found_here[:] = self._nats, 0.0, 0.0, False
        self._observe(familiar.indices, self._evidence(in_view, familiar.is_found), elapsed_s)
        self._was_in_view[in_view] = True
        known, nats = np.flatnonzero(self._was_in_view), np.zeros(len(self._cells))
        nats[known] = self._around(self._sums(self._cell_of, self._nats), known)
        self._above_s[np.unique(in_view)] += min(elapsed_s, MOST_COUNTED_S)
        self._above_s[nats < _CHANGED_NATS] = 0.0
        self._is_changed = (self._above_s >= _LEAST_S) | (self._is_changed & (nats >= _UNCHANGED_NATS))
        self._region = self._region_in(nats, in_view)
        return self._region

    def _observe(self, indices: NDArray[np.int64], evidence: FloatArray, elapsed_s: float) -> None:
        """Add what an image says of some landmarks, (F,) each.

        Of a view, the mean over its images counts, since a landmark that is seldom found from there is missing for as
        long as the camera hovers. Once it was found from there, each half second without it is an observation.
        """
        fades, counted_s = math.exp(-elapsed_s / _VIEW_MEMORY_S), min(elapsed_s, _OBSERVATION_S)
        self._sum[indices] = fades * self._sum[indices] + counted_s * evidence
        self._seen_s[indices] = fades * self._seen_s[indices] + counted_s
        of_view = self._sum[indices] / np.maximum(self._seen_s[indices], _OBSERVATION_S)
        nats = np.where(
            self._is_found_here[indices],
            self._nats[indices] + counted_s / _OBSERVATION_S * evidence,
            self._earlier[indices] + of_view,
        )
        self._nats[indices] = np.clip(nats, _LEAST_NATS, _MOST_NATS)
        self._is_found_here[indices] |= of_view <= _FOUND_HERE_NATS

    def _evidence(self, cells: NDArray[np.int64], is_found: NDArray[np.bool_]) -> FloatArray:
        """Logarithm of how much more probable it is with a change that a landmark is found, or not, (F,).

        Args:
            cells: (F,) of the familiar landmarks in view.
            is_found: (F,) bool.
        """
        rest = len(cells) - self._around(self._sums(cells), cells)
        rest_found = is_found.sum() - self._around(self._sums(cells, is_found), cells)
        rate = (rest_found + self._familiar_found) / (rest + 1.0)
        is_explained = (rest >= _LEAST_REST) & (rate >= _EXPLAINED * self._familiar_found)
        rate = np.clip(rate, self._strange_found, self._familiar_found)
        strange = self._strange_found
        nats = np.where(is_found, np.log(strange / rate), np.log((1.0 - strange) / (1.0 - rate)))
        return np.where(is_explained, nats, 0.0)

    def _sums(self, cells: NDArray[np.int64], values: NDArray[Any] | None = None) -> FloatArray:
        """Sum over each cell of values (N,) in cells (N,), or their number, (C,)."""
        return np.bincount(cells, values, minlength=len(self._cells)).astype(np.float64)

    def _around(self, sums: FloatArray, cells: NDArray[np.int64]) -> FloatArray:
        """Sums (C,) over some cells (S,), each together with those that touch it: (S,)."""
        return np.asarray(np.append(sums, 0.0)[self._neighbours[cells]].sum(axis=1))

    def _region_in(self, nats: FloatArray, in_view: NDArray[np.int64]) -> ChangedRegion | None:
        """Changed cells that touch each other, of which one is in view."""
        seen = in_view[self._is_changed[in_view]]
        if len(seen) == 0:
            return None
        is_changed = np.append(self._is_changed, False)
        region, size = seen[[np.argmax(nats[seen])]], 0
        while len(region) > size:
            size, around = len(region), self._neighbours[region]
            region = np.unique(around[is_changed[around]])
        lower, upper = self._cells[region].min(axis=0), self._cells[region].max(axis=0) + 1
        return ChangedRegion(lower * _CELL_M, upper * _CELL_M)


def _neighbours(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of each cell (C, 3), itself and those that touch it, then C for want of more: (C, 27)."""
    cell, other = touching(cells)
    first = np.searchsorted(cell, np.arange(len(cells)))
    table = np.full((len(cells), 27), len(cells))
    table[cell, np.arange(len(cell)) - first[cell]] = other
    return table


def touching(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs of cells (C, 3) that touch each other, (2, P): of each cell all others, and itself."""
    numbers = {tuple(cell): number for number, cell in enumerate(cells.tolist())}
    steps = list(itertools.product((-1, 0, 1), repeat=3))
    pairs = [
        (number, numbers[other])
        for (x, y, z), number in numbers.items()
        for dx, dy, dz in steps
        if (other := (x + dx, y + dy, z + dz)) in numbers
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2).T
