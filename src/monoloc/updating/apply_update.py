"""Apply what the evidence proposes: each proposal is one edit of the bundle, and can be undone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.editing.edits import Change, finish, with_surfaces, without_surfaces
from monoloc.editing.extension import SEEN_BY_UPDATE, with_frames
from monoloc.geometry import FloatArray
from monoloc.updating.landmark_ageing import with_more
from monoloc.updating.proposals import Proposal, ProposalKind
from monoloc.updating.room_evidence import Evidence, landmark_keys, realigned
from monoloc.updating.surface_ageing import VOXEL_M, Cells, cells_of, is_among_cells


def applied(
    bundle: Bundle,
    evidence: Evidence,
    chosen: Sequence[Proposal],
    rng: np.random.Generator,
) -> tuple[Bundle, Evidence]:
    """The bundle with some proposals applied, and the evidence that is left; both as they are if none is chosen.

    Raises:
        SettingError: surfaces that are to be removed are the whole map.
    """
    if not chosen:
        return bundle, evidence
    before = bundle
    for proposal in chosen:
        bundle = _with(bundle, evidence, proposal, rng)
    return bundle, _left(evidence, before, bundle, chosen)


def _with(bundle: Bundle, evidence: Evidence, proposal: Proposal, rng: np.random.Generator) -> Bundle:
    none = np.zeros((0, 3))
    edited, change = bundle, Change(none, none)
    if proposal.kind == "retire landmarks":
        kept = ~np.isin(landmark_keys(bundle.landmarks), proposal.members)
        edited = replace(bundle, landmarks=bundle.landmarks.select(kept))
    elif proposal.kind == "add landmarks":
        new = evidence.candidates.corners.select(np.sort(proposal.members))
        edited = replace(bundle, landmarks=with_more(bundle.landmarks, new))
    elif proposal.kind == "remove surfaces":
        edited, change = without_surfaces(bundle, _Voxels(proposal.members), rng)
    else:
        edited, change = with_surfaces(bundle, proposal.points, rng)
    # What the update used is no longer unseen.
    frames = {f"{SEEN_BY_UPDATE}{checksum:08x}": checksum for checksum in evidence.frames}
    provenance = with_frames(edited.provenance, edited.provenance.recording, frames)
    edited = replace(edited, provenance=provenance)
    newest = list(evidence.flights[-proposal.flights :])
    parameters: dict[str, Any] = {**proposal.described(), "newest_flights": newest}
    return finish(bundle, edited, "update", parameters, change, rng)


def _left(evidence: Evidence, before: Bundle, after: Bundle, chosen: Sequence[Proposal]) -> Evidence:
    """The evidence that has not been used, of the landmarks that the bundle has now."""
    none = np.zeros((0, 3), dtype=np.int64)

    def members(kind: ProposalKind, nothing: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.concatenate([nothing, *(each.members for each in chosen if each.kind == kind)])

    used = np.isin(np.arange(len(evidence.candidates)), members("add landmarks", none[:, 0]))
    return replace(
        evidence,
        landmarks=realigned(evidence.landmarks, landmark_keys(before.landmarks), after.landmarks),
        candidates=evidence.candidates.select(~used),
        surfaces=evidence.surfaces.without(members("remove surfaces", none), members("add surfaces", none)),
    )


class _Voxels:
    """The space of some voxels; a :class:`monoloc.map.local_fit.Region`."""

    def __init__(self, cells: Cells) -> None:
        self._cells = cells
        centres = (cells + 0.5) * VOXEL_M
        self.centre = centres.mean(axis=0)
        farthest_m = float(np.linalg.norm(centres - self.centre, axis=1).max())
        self.reach_m = farthest_m + VOXEL_M

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        return is_among_cells(cells_of(points), self._cells)
