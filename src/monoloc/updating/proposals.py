"""What the evidence of several flights proposes to change in a map, region by region."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.editing.alignment import known
from monoloc.geometry import FloatArray
from monoloc.map.occupancy import OCCUPIED, surface_voxels
from monoloc.supervision.map_change import touching
from monoloc.updating.room_evidence import Evidence, landmark_keys
from monoloc.updating.surface_ageing import VOXEL_M, Cells, cells_of, is_among_cells
from monoloc.updating.tally import Tally

ProposalKind = Literal["retire landmarks", "add landmarks", "remove surfaces", "add surfaces"]

_REGION_M = 0.4  # cells whose touching ones make a region of landmarks
_LEAST_POINTS = 10  # of a new surface
_LEAST_VOXELS, _LEAST_LANDMARKS = 3, 5  # of a proposal; scattered landmarks are proposed together
_MOST_LANDMARKS = 7500  # of a map, up to which new ones are added; in one that has more, as many as are retired


@dataclass(frozen=True)
class Proposal:
    """A change of the map that can be applied.

    Attributes:
        kind: of the change.
        members: what changes: keys of landmarks, indices of candidates, or voxels, (N, 3).
        points: where, (N, 3), world frame, metres; of new surfaces the cloud.
        flights: in a row that agree, of the member with the fewest.
        views, agreeing: that looked there, and of them those that speak for the change; medians over members.
        odds: posterior odds of the change, median over members.
    """

    kind: ProposalKind
    members: NDArray[Any]
    points: FloatArray
    flights: int
    views: float
    agreeing: float
    odds: float

    @property
    def id(self) -> str:
        """Six digits that tell what is changed where: a proposal keeps them for as long as it is the same."""
        return blake2b(self.kind.encode() + self.points.tobytes(), digest_size=3).hexdigest()

    @property
    def lower(self) -> FloatArray:
        """Lower corner of its box, (3,), world frame, metres."""
        return np.asarray(self.points.min(axis=0), dtype=np.float64)

    @property
    def upper(self) -> FloatArray:
        return np.asarray(self.points.max(axis=0), dtype=np.float64)

    def described(self) -> dict[str, Any]:
        """Its figures, as JSON."""
        return {
            "id": self.id,
            "kind": self.kind,
            "count": len(self.members),
            "lower_m": self.lower.round(3).tolist(),
            "upper_m": self.upper.round(3).tolist(),
            "flights": self.flights,
            "views": self.views,
            "agreeing": self.agreeing,
            "odds": round(self.odds, 1),
        }


def proposals(evidence: Evidence, bundle: Bundle) -> list[Proposal]:
    """What the evidence proposes, those of most members first within each kind."""
    return [
        *_retired(evidence, bundle),
        *_new_landmarks(evidence, bundle),
        *_gone_surfaces(evidence, bundle),
        *_new_surfaces(evidence, bundle),
    ]


def _retired(evidence: Evidence, bundle: Bundle) -> Iterator[Proposal]:
    chosen = np.flatnonzero(evidence.landmarks.is_proven)
    points, keys = bundle.landmarks.points[chosen].astype(np.float64), landmark_keys(bundle.landmarks)[chosen]
    for part in _landmark_regions(points):
        yield _proposal("retire landmarks", keys[part], points[part], evidence.landmarks[chosen[part]])


def _new_landmarks(evidence: Evidence, bundle: Bundle) -> Iterator[Proposal]:
    """The likeliest, as many as there is room for once the others are retired, or as are retired in a full map."""
    candidates = evidence.candidates
    chosen = np.flatnonzero(candidates.tally.is_proven)
    retired = int(evidence.landmarks.is_proven.sum())
    room = max(0, _MOST_LANDMARKS - len(bundle.landmarks)) + retired
    chosen = np.sort(chosen[np.argsort(-candidates.tally.log_odds[chosen], kind="stable")][:room])
    points = candidates.corners.points[chosen].astype(np.float64)
    for part in _landmark_regions(points):
        yield _proposal("add landmarks", chosen[part], points[part], candidates.tally[chosen[part]])


def _gone_surfaces(evidence: Evidence, bundle: Bundle) -> Iterator[Proposal]:
    gone = evidence.surfaces.gone
    gone = gone[gone.tally.is_proven]
    if not len(gone):
        return
    centres: FloatArray = np.asarray((gone.cells + 0.5) * VOXEL_M, dtype=np.float64)
    is_there = surface_voxels(bundle.original, VOXEL_M).at(centres) == OCCUPIED
    gone, centres = gone[is_there], centres[is_there]
    for part in _regions(gone.cells):
        if len(part) >= _LEAST_VOXELS:
            yield _proposal("remove surfaces", gone.cells[part], centres[part], gone.tally[part])


def _new_surfaces(evidence: Evidence, bundle: Bundle) -> Iterator[Proposal]:
    new = evidence.surfaces.new
    new = new[new.tally.is_proven]
    points = evidence.surfaces.points.astype(np.float64)
    points = points[~known(bundle, points)]  # an edit may have added them since
    cells = cells_of(points)
    for part in _regions(new.cells):
        members = new.cells[part]
        cloud = points[is_among_cells(cells, members)]
        if len(part) >= _LEAST_VOXELS and len(cloud) >= _LEAST_POINTS:
            yield _proposal("add surfaces", members, cloud, new.tally[part])


def _proposal(kind: ProposalKind, members: NDArray[Any], points: FloatArray, tally: Tally) -> Proposal:
    return Proposal(
        kind,
        members,
        points,
        int(tally.flights.min()),
        float(np.median(tally.expected)),
        float(np.median(tally.agreeing)),
        float(np.median(tally.odds)),
    )


def _landmark_regions(points: FloatArray) -> list[NDArray[np.int64]]:
    """Indices of points (N, 3) by region, the largest first; those of small regions are the last."""
    parts = _regions(np.floor(points / _REGION_M).astype(np.int64))
    large = [part for part in parts if len(part) >= _LEAST_LANDMARKS]
    small = [part for part in parts if len(part) < _LEAST_LANDMARKS]
    return [*large, np.concatenate(small)] if small else large


def _regions(cells: Cells) -> list[NDArray[np.int64]]:
    """Indices of N things in cells (N, 3) by region, that is of cells that touch each other; the largest first."""
    if not len(cells):
        return []
    unique, cell_of = np.unique(cells, axis=0, return_inverse=True)
    cell, other = touching(unique)
    label, size = np.arange(len(unique)), -1
    while (total := int(label.sum())) != size:
        size = total
        np.minimum.at(label, cell, label[other])
    region = label[cell_of.reshape(-1)]
    parts = [np.flatnonzero(region == each) for each in np.unique(region)]
    return sorted(parts, key=len, reverse=True)
