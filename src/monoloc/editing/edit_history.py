"""The edits of a bundle as they are drawn: where each was made, what went and what came."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from monoloc.bundle import Bundle
from monoloc.edit_record import EditRecord
from monoloc.editing.box import Box
from monoloc.editing.paired_map import cloud_of, down_direction
from monoloc.editing.undo import states
from monoloc.geometry import FloatArray, so3_exp
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.map.local_fit import Components
from monoloc.map.mixture import GaussianMixture
from monoloc.map.surface import surface_points

_MOST_POINTS = 4000  # of the surfaces that went with an edit, and of those that came
_MOST = (2.0, 98.0)  # percentiles: single points may lie far off
_KNOWN = 0.5  # share of a surface's points from which on another map holds it too

_Length = Annotated[float, Field(allow_inf_nan=False)]
_Vector = tuple[_Length, _Length, _Length]


@dataclass(frozen=True)
class DrawnEdit:
    """One edit, as far as the map of today still shows it; world frame, metres.

    Attributes:
        number: as ``monoloc map edit BUNDLE log`` counts, from 1.
        record: of the edit.
        place: where it was made: the box that it was given, else the bounds of most of what it changed; None if it
            changed neither surfaces nor landmarks.
        moved_to: where a move put the content of ``place``; else None.
        is_taking: whether more went than came.
        went, came: points of surfaces, (N, 3), without those that a later edit brought back or took away.
        went_landmarks, came_landmarks: the same of landmarks.
    """

    number: int
    record: EditRecord
    place: Box | None
    moved_to: Box | None
    is_taking: bool
    went: FloatArray
    came: FloatArray
    went_landmarks: FloatArray
    came_landmarks: FloatArray

    @property
    def name(self) -> str:
        """Number and kind, as in the list of edits."""
        return f"{self.number} {self.record.kind}"


def drawn_edits(bundle: Bundle, rng: np.random.Generator) -> tuple[DrawnEdit, ...]:
    """All edits of a bundle that were not taken back, the first one first.

    Args:
        rng: draws the points of surfaces.

    Raises:
        BundleError: what undoes an edit is damaged.
    """
    edits = [_drawn(before, after, bundle, rng) for after, before in pairwise(states(bundle))]
    return tuple(reversed(edits))


def _drawn(before: Bundle, after: Bundle, today: Bundle, rng: np.random.Generator) -> DrawnEdit:
    went, came = _difference(before, after, rng), _difference(after, before, rng)
    went_landmarks, came_landmarks = (_landmarks_without(one, two) for one, two in ((before, after), (after, before)))
    record = after.edits[-1].record
    place, moved_to = _given_boxes(before, record.parameters)
    if place is None:
        surfaces = np.concatenate([went, came])
        landmarks = np.concatenate([went_landmarks.points, came_landmarks.points]).astype(np.float64)
        place = _bounds(surfaces if len(surfaces) else landmarks)
    elif record.kind != "update":  # which gives the bounds of its voxels' centres
        # Refitted components at the border may differ a little.
        went, came = went[place.contains(went)], came[(moved_to or place).contains(came)]
    return DrawnEdit(
        number=len(after.edits),
        record=record,
        place=place,
        moved_to=moved_to,
        is_taking=len(went) + len(went_landmarks) > len(came) + len(came_landmarks),
        went=went[~_holds(today, before, went)],
        came=came[_holds(today, after, came)],
        went_landmarks=_points(went_landmarks, ~_are_among(went_landmarks, today.landmarks)),
        came_landmarks=_points(came_landmarks, _are_among(came_landmarks, today.landmarks)),
    )


class _Given(BaseModel):
    """A box among the parameters of an edit, and what a move does with it."""

    model_config = ConfigDict(extra="ignore")

    lower_m: _Vector
    upper_m: _Vector
    yaw_deg: _Length = 0.0
    by_m: _Vector | None = None
    turn_deg: _Length = 0.0


def _given_boxes(before: Bundle, parameters: dict[str, Any]) -> tuple[Box | None, Box | None]:
    """The box that an edit was given, and where a move put it."""
    try:
        given = _Given.model_validate(parameters)
    except ValidationError:
        return None, None
    down = down_direction(before)
    box = Box.between(np.array(given.lower_m), np.array(given.upper_m), down, float(np.deg2rad(given.yaw_deg)))
    if given.by_m is None:
        return box, None
    turn = so3_exp(-np.deg2rad(given.turn_deg) * down)
    return box, Box(box.centre + np.array(given.by_m), box.half, turn @ box.R_world_box)


def _bounds(points: FloatArray) -> Box | None:
    if not len(points):
        return None
    lower, upper = np.percentile(points, _MOST, axis=0)
    return Box(0.5 * (lower + upper), 0.5 * (upper - lower), np.eye(3))


def _difference(one: Bundle, other: Bundle, rng: np.random.Generator) -> FloatArray:
    """Surface points (N, 3) of a map that another one does not hold."""
    chosen = ~np.isin(_component_keys(one.original), _component_keys(other.original))
    components = Components.of(one.original, cloud_of(one).points)[chosen]
    if not len(components):
        return np.zeros((0, 3))
    count = int(min(_MOST_POINTS, np.ceil(components.mass.sum())))
    points = surface_points(components.mixture(), count, rng)
    # Refitted components at the border of what changed are others, but of the same surface.
    return points[~_holds(other, one, points)]


def _holds(bundle: Bundle, other: Bundle, points: FloatArray) -> NDArray[np.bool_]:
    """Whether a map holds points (N, 3) of another map's surfaces, (N,)."""
    if not len(points):
        return np.zeros(0, dtype=np.bool_)
    here, there = (np.log(cloud_of(each).points) + each.original.log_density(points) for each in (bundle, other))
    return np.asarray(here - there > np.log(_KNOWN))


def _component_keys(mixture: GaussianMixture) -> NDArray[np.void]:
    arrays = mixture.to_arrays()
    return _keys(np.concatenate([arrays["means"], arrays["cholesky"]], axis=1).view(np.uint8))


def _landmark_keys(landmarks: Landmarks) -> NDArray[np.void]:
    points = np.ascontiguousarray(landmarks.points, dtype=np.float32).view(np.uint8)
    return _keys(np.concatenate([points, landmarks.descriptors], axis=1))


def _keys(rows: NDArray[np.uint8]) -> NDArray[np.void]:
    """Rows (N, B) of bytes as one value each, (N,)."""
    rows = np.ascontiguousarray(rows)
    return rows.view(f"V{rows.shape[1]}").reshape(-1)


def _are_among(landmarks: Landmarks, others: Landmarks) -> NDArray[np.bool_]:
    return np.isin(_landmark_keys(landmarks), _landmark_keys(others))


def _landmarks_without(one: Bundle, other: Bundle) -> Landmarks:
    return one.landmarks.select(~_are_among(one.landmarks, other.landmarks))


def _points(landmarks: Landmarks, chosen: NDArray[np.bool_]) -> FloatArray:
    return landmarks.points[chosen].astype(np.float64)
