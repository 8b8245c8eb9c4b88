"""Edits of a bundle's map: remove, add and move.

An edit changes the map of the room as it is; the transform that the build has learnt adapts what is new. Landmarks in
the region go with it. Which landmarks the build's views find is corrected where something new stands before them.
The biases at the reference poses are those of the scans' errors: where a part of a view has changed, the same part of
its bias is no longer known. Thresholds and covariances are of the network and of the room as a whole and stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle, Provenance
from monoloc.edit_record import EditKind, EditRecord
from monoloc.editing.box import Box
from monoloc.editing.paired_map import PairedMap, cloud_of
from monoloc.editing.undo import with_edit
from monoloc.editing.visibility import DepthBuffer, changed_share
from monoloc.errors import SettingError
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray, angle_between, transform
from monoloc.io.recording import evenly_spaced
from monoloc.landmarks.landmark_map import LandmarkViews
from monoloc.map.cloud import voxel_thin
from monoloc.map.down_direction import down_of
from monoloc.map.local_fit import Components, Region, fitted, part

_SHOWN = 4000  # points of the map that tell which part of a view has changed
_VIEWS = 300  # reference poses that are looked from; others lie between them
_LEAST_POINTS = 10  # of a cloud that is added
_LEAST_LEFT = 0.5  # of a map; if a removal leaves less, its box may be a wrong one
# Times as many points as at twice the map's spacing: four of a surface, two of a wire. At this, a surface has a third
# of its points; obstacles begin at a quarter.
_LEAST_THINNED = 1.5
_OTHER_GRAVITY_RAD = np.deg2rad(3.0)  # edits turn what floor and walls show by less; flights use gravity up to 6
_MOST_BEYOND_M = 10.0  # from the map to what an edit puts somewhere: farther, it is of no use in a room


@dataclass(frozen=True)
class Change:
    """What an edit changed of the map's surfaces, as points (N, 3), world frame: what is gone and what is new."""

    gone: FloatArray
    new: FloatArray


def remove(bundle: Bundle, box: Box, parameters: dict[str, Any], rng: np.random.Generator) -> Bundle:
    """Take away what lies in a box.

    Raises:
        SettingError: neither surfaces nor landmarks do, or all of the map does.
    """
    edited, change = without_surfaces(bundle, box, rng)
    inside = box.contains(bundle.landmarks.points.astype(np.float64))
    if not len(change.gone) and not inside.any():
        raise _empty(box, bundle)
    edited = replace(edited, landmarks=bundle.landmarks.select(~inside))
    return finish(bundle, edited, "remove", parameters, change, rng, **_much_removed(bundle, edited))


def without_surfaces(bundle: Bundle, region: Region, rng: np.random.Generator) -> tuple[Bundle, Change]:
    """The bundle without the surfaces in a region, as it is if there are none; its landmarks stay.

    Raises:
        SettingError: all of the map lies there.
    """
    paired = PairedMap.of(bundle)
    parted = part(paired.original, region, rng)
    if not len(parted.inner) and not parted.is_inside.any():
        return bundle, Change(np.zeros((0, 3)), np.zeros((0, 3)))
    rest = paired.select(parted.is_outside).with_new(parted.outer)
    if not len(rest):
        raise SettingError("box", "holds the whole map", "give a smaller one")
    gone = _points_of(paired.original[parted.is_inside] + parted.inner, rng)
    return rest.on(bundle), Change(gone, np.zeros((0, 3)))


def add(bundle: Bundle, cloud: FloatArray, parameters: dict[str, Any], rng: np.random.Generator) -> Bundle:
    """Add a cloud (N, 3), world frame, metres. It brings no landmarks.

    Raises:
        SettingError: too few points, or some far from the map.
    """
    _check_near(bundle, cloud, "cloud")
    edited, change = with_surfaces(bundle, cloud, rng)
    remarks = {"warnings": [problem]} if (problem := _sparseness(cloud, cloud_of(bundle).voxel_m)) else {}
    return finish(bundle, edited, "add", parameters, change, rng, **remarks)


def with_surfaces(bundle: Bundle, cloud: FloatArray, rng: np.random.Generator) -> tuple[Bundle, Change]:
    """The bundle with the surfaces of a cloud (N, 3), world frame, metres.

    Raises:
        SettingError: too few points.
    """
    paired = PairedMap.of(bundle)
    points = voxel_thin(cloud, paired.voxel_m)
    if len(points) < _LEAST_POINTS:
        problem = f"gives {len(points)} points {100.0 * paired.voxel_m:g} cm apart"
        raise SettingError("cloud", problem, f"give one in metres with at least {_LEAST_POINTS}")
    new = fitted(points, float(len(points)), len(points) * paired.components_a_point, rng)
    return paired.with_new(new).on(bundle), Change(np.zeros((0, 3)), points)


def move(
    bundle: Bundle, box: Box, T_new_old: FloatArray, parameters: dict[str, Any], rng: np.random.Generator
) -> Bundle:
    """Move what lies in a box by a rigid motion (4, 4), world frame; its landmarks go with it.

    Raises:
        SettingError: nothing lies there, or it would be far from the map.
    """
    paired = PairedMap.of(bundle)
    parted = part(paired.original, box, rng)
    content = paired.original[parted.is_inside] + parted.inner
    if not len(content):
        raise _empty(box, bundle)
    _check_near(bundle, transform(T_new_old, content.means), "by")
    rest = paired.select(parted.is_outside).with_new(parted.outer)
    landmarks = bundle.landmarks
    points = landmarks.points.astype(np.float64)
    inside = box.contains(points)
    points[inside] = transform(T_new_old, points[inside])
    # From where the build saw them they are no longer seen.
    views = landmarks.views if landmarks.views is None else _without_finds(landmarks.views, inside)
    moved = replace(landmarks, points=points.astype(np.float32), views=views)
    edited = replace(rest.with_new(content.moved(T_new_old)).on(bundle), landmarks=moved)
    gone = _points_of(content, rng)
    return finish(bundle, edited, "move", parameters, Change(gone, transform(T_new_old, gone)), rng)


def finish(
    before: Bundle,
    edited: Bundle,
    kind: EditKind,
    parameters: dict[str, Any],
    change: Change | None,
    rng: np.random.Generator,
    **measured: Any,
) -> Bundle:
    """Let views and biases follow a change of surfaces, and add the edit to the bundle's list.

    Args:
        change: None where the map has only grown, so that views and biases stay.
        measured: further entries of the record's changes.
    """
    if change is not None:
        edited = _views_follow(edited, change)
        shares = _changed_shares(before, change, rng)
        edited = replace(edited, reference_poses=_biases_follow(edited.reference_poses, shares))
        measured = {"largest_share_of_a_view": round(float(shares.max(initial=0.0)), 3), **measured}
    edited = replace(edited, provenance=_with_gravity_of(before, edited.provenance))
    if (problem := _other_gravity(before.down, edited)) is not None:
        measured["warnings"] = [*measured.get("warnings", []), problem]
    changes = {
        "components": [len(before.original), len(edited.original)],
        "landmarks": [len(before.landmarks), len(edited.landmarks)],
        "reference_poses": [len(before.reference_poses), len(edited.reference_poses)],
        **measured,
    }
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return with_edit(before, edited, EditRecord(time=now, kind=kind, parameters=parameters, changes=changes))


def _with_gravity_of(before: Bundle, provenance: Provenance) -> Provenance:
    """Of the edited bundle, with the direction of gravity that the map before shows, if it shows one.

    Flights level their poses by it, and the frame ``map`` that they publish. Found again in other surfaces, it would
    turn by some tenths of a degree at every edit.
    """
    if before.down is None or provenance.knows_down:
        return provenance
    x, y, z = (float(value) for value in before.down)
    return provenance.model_copy(update={"kept_down": (x, y, z)})


def _other_gravity(was: FloatArray | None, edited: Bundle) -> str | None:
    """What to say where the surfaces show another direction of gravity after an edit than the map had, (3,)."""
    if was is None and (now := edited.down) is not None:
        fix = "flights use it; undo if it is wrong"
        return f"the map now shows the direction of gravity, {now.round(3).tolist()}: {fix}"
    if was is None or edited.provenance.knows_down:
        return None
    shown = down_of(edited.original, was)
    if shown is None or (angle := angle_between(shown, was)) < _OTHER_GRAVITY_RAD:
        return None
    fix = "if it was wrong before, build the map again"
    return f"floor and walls now show gravity {np.rad2deg(angle):.0f} degrees from where the map keeps it; {fix}"


def _empty(box: Region, bundle: Bundle) -> SettingError:
    lower, upper = (", ".join(f"{value:.1f}" for value in bound) for bound in bundle.original.bounds_m(1.0))
    centre = ", ".join(f"{value:.2f}" for value in box.centre)
    return SettingError(
        "box", f"holds nothing of the map (centre {centre})", f"the map lies between ({lower}) and ({upper})"
    )


def _check_near(bundle: Bundle, points: FloatArray, field: str) -> None:
    """Refuse to put something far from the map: nearly always, its unit is another one."""
    beyond_m = bundle.original.beyond_m(points)
    if beyond_m > _MOST_BEYOND_M:
        problem = f"puts something {beyond_m:.4g} m beyond the map"
        raise SettingError(field, problem, "are these millimetres? give metres, in the map's world")


def _much_removed(before: Bundle, after: Bundle) -> dict[str, list[str]]:
    """A warning, if most of the map was removed: the box may be a wrong one."""
    counts = (
        (len(before.landmarks), len(after.landmarks), "landmarks"),
        (len(before.adapted), len(after.adapted), "components"),
    )
    lost = [f"{1.0 - left / had:.0%} of the {what}" for had, left, what in counts if left < _LEAST_LEFT * had]
    if not lost:
        return {}
    return {"warnings": [f"{' and '.join(lost)} lay in the box; if it was a wrong one, undo"]}


def _sparseness(cloud: FloatArray, voxel_m: float) -> str | None:
    """What a cloud (N, 3) lacks whose points are much farther apart than those of the map; None if they are not."""
    if len(voxel_thin(cloud, voxel_m)) >= _LEAST_THINNED * len(voxel_thin(cloud, 2.0 * voxel_m)):
        return None
    problem = f"its points are farther apart than the {100.0 * voxel_m:g} cm of the map"
    return f"{problem}: it is too thin for obstacles and exports; undo, add a denser one"


def _points_of(components: Components, rng: np.random.Generator) -> FloatArray:
    """Points (N, 3) of components, one for each that the cloud had, but not more than are needed."""
    count = int(min(_SHOWN, np.ceil(components.mass.sum())))
    return components.mixture().sample(count, rng) if len(components) else np.zeros((0, 3))


def _without_finds(views: LandmarkViews, chosen: NDArray[np.bool_]) -> LandmarkViews:
    found = views.found.copy()
    found[:, chosen] = False
    return LandmarkViews(views.poses, found)


def _views_follow(bundle: Bundle, change: Change) -> Bundle:
    """Landmarks that something new hides are not found from there any more."""
    views = bundle.landmarks.views
    if views is None or not len(change.new):
        return bundle
    points, found = bundle.landmarks.points.astype(np.float64), views.found.copy()
    for row, pose in zip(found, views.poses, strict=True):
        buffer = DepthBuffer(bundle.camera, pose, change.new)
        seen = np.flatnonzero(row)
        row[seen[buffer.hides(points[seen])]] = False
    return replace(bundle, landmarks=replace(bundle.landmarks, views=LandmarkViews(views.poses, found)))


def _changed_shares(before: Bundle, change: Change, rng: np.random.Generator) -> FloatArray:
    """Share of the view of each reference pose, (V,), that is gone or stands behind something new."""
    poses = before.reference_poses.poses
    if not len(poses) or not (len(change.gone) or len(change.new)):
        return np.zeros(len(poses))
    room = before.original.sample(_SHOWN, rng)
    some = evenly_spaced(len(poses), _VIEWS)
    shares = [changed_share(before.camera, pose, room, change.gone, change.new) for pose in poses[some]]
    return np.interp(np.arange(len(poses)), some, shares)


def _biases_follow(known: ReferencePoses, shares: FloatArray) -> ReferencePoses:
    """The bias of a view is the mean over its rays; of those that have changed, it is not known."""
    left = np.ones((len(known), 1))
    left[: len(shares), 0] = 1.0 - shares
    return ReferencePoses(known.poses, left * known.forward_bias, left * known.backward_bias)
