"""A map that grows: extended by another recording, or merged with another bundle.

What the map knows already is left as it is; what it does not know is fitted with as many components a point as the
rest has, and adapted by the transform that the build has learnt. The network stays; what it has learnt of the room's
first part is of use in the second, but no frame there has tuned it. So after the extension of a tuned bundle its bias
is measured on the new frames, and the stated covariance is at least that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter

from monoloc.builder.bias import localizer_factory, measure_bias_at_reference
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.checks import check_recording
from monoloc.builder.frame_choice import spread_stretches
from monoloc.builder.kept_depth import KeptDepth
from monoloc.bundle import Bundle, Provenance, fingerprint
from monoloc.camera import Camera
from monoloc.editing.alignment import Alignment, align_bundle, align_recording, known, poses_by_landmarks
from monoloc.editing.depth_comparison import check_depth_scale
from monoloc.editing.edits import finish
from monoloc.editing.joined_landmarks import joined, with_recording
from monoloc.editing.paired_map import PairedMap, cloud_of
from monoloc.editing.world_check import check_same_world
from monoloc.errors import DataError
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import MOST_POSES, ReferencePoses
from monoloc.geometry import FloatArray, transform
from monoloc.io.corrected import with_poses
from monoloc.io.recording import Recording, Selection, evenly_spaced, narrowed
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.map.cloud import cloud_from_recording, remove_outliers
from monoloc.map.local_fit import Components, fitted, part
from monoloc.progress import NoProgress

_MAX_DEPTH_M = 4.5  # as in a build
_LEAST_POINTS = 10  # that the map does not know, for components of their own
_STRETCHES = 2  # of new frames in a row, along which a tuned network's bias is measured

_Model = TypeVar("_Model", bound=BiasModel)


def extend(
    bundle: Bundle, recording: Recording, is_aligned: bool, parameters: dict[str, Any], rng: np.random.Generator
) -> Bundle:
    """Extend a room by a posed recording with depth.

    Args:
        is_aligned: whether to find where its world lies in the room; else its poses are in the room's world.

    Raises:
        DataError: no poses or depth; it contradicts itself, see :func:`monoloc.builder.checks.check_recording`; the
            map was made of all of its frames; its depth is in another unit; it is in another world; or it is not
            found in the room, see :func:`monoloc.editing.alignment.align_recording`.
    """
    given = recording
    recording, measured = _checked(bundle, given)
    posed = poses_by_landmarks(bundle, recording)
    check_depth_scale(bundle, recording, posed, given)
    paired = PairedMap.of(bundle)
    cloud = cloud_from_recording(recording, paired.voxel_m, _MAX_DEPTH_M)
    T_world_other = np.eye(4)
    if is_aligned:
        alignment = align_recording(bundle, recording, posed, cloud, rng)
        T_world_other = alignment.T_world_other
        measured |= {"agreeing_frames": alignment.agreeing, **_described(alignment)}
    else:
        check = check_same_world(bundle, recording, posed, cloud)
        measured["frames_confirmed_by_landmarks"] = check.confirmed
        measured["frames_contradicted_by_landmarks"] = check.contradicted
        measured["frames_looked_at"] = check.looked_at
    assert recording.poses is not None
    cloud, poses = transform(T_world_other, cloud), T_world_other @ recording.poses
    unknown = remove_outliers(cloud[~known(bundle, cloud)], paired.voxel_m)
    if len(unknown) < _LEAST_POINTS:
        unknown = unknown[:0]
    new = fitted(unknown, float(len(unknown)), len(unknown) * paired.components_a_point, rng)
    edited = paired.with_new(new).on(bundle)
    edited = replace(
        edited,
        landmarks=with_recording(bundle.landmarks, recording, poses) if len(bundle.landmarks) else bundle.landmarks,
        reference_poses=_joined_references(bundle.reference_poses, ReferencePoses.without_bias(poses)),
        provenance=with_frames(bundle.provenance, recording.name, _fingerprints(recording)),
    )
    if bundle.provenance.tune != "none":
        edited = _with_bias_of(edited, recording, poses)
        measured["bias_sd_m"] = round(edited.settings.particle_bias.sd_at_reference_m, 4)
    measured |= {"unknown_points": len(unknown), "points": len(cloud)} | _other_camera(bundle, recording.camera)
    return finish(bundle, edited, "extend", parameters, None, rng, **measured)


def _checked(bundle: Bundle, recording: Recording) -> tuple[Recording, dict[str, Any]]:
    """The frames of a recording that are new to the map, and what was remarked: warnings, and frames left out.

    Raises:
        DataError: no poses or depth, it contradicts itself, or no frame is new.
    """
    if recording.poses is None or not recording.has_depth:
        what = "poses" if recording.poses is None else "depth"
        raise DataError(recording.name, f"has no {what}", "extend by a recording with poses and depth")
    remarks: dict[str, Any] = {}
    whole = KeptDepth(recording)
    if warnings := check_recording(whole, None, BuildConfig(), if_poor="check them: monoloc check"):
        remarks["warnings"] = warnings
    known_frames = _mapped_frames(bundle)
    new = [index for index in range(len(whole)) if fingerprint(whole.color(index)) not in known_frames]
    if not new:
        raise DataError(recording.name, "holds only frames that the map was made of", "extend by others: --frames")
    if len(new) < len(whole):
        remarks["frames_left_out"] = len(whole) - len(new)
    return Selection(whole, new), remarks


def _mapped_frames(bundle: Bundle) -> set[int]:
    """Checksums of the frames that a map was made of, without those that only an update used."""
    frames = bundle.provenance.frames.items()
    return {checksum for name, checksum in frames if not name.startswith(SEEN_BY_UPDATE)}


def merge(bundle: Bundle, other: Bundle, name: str, parameters: dict[str, Any], rng: np.random.Generator) -> Bundle:
    """Merge another bundle's map into a room; network, camera and settings stay the room's.

    Args:
        name: of the other bundle, for messages.

    Raises:
        DataError: the map was made of all of its frames, as after an earlier merge; or it is not found in the room,
            see :func:`monoloc.editing.alignment.align_bundle`.
    """
    others = _mapped_frames(other)
    if others and others <= _mapped_frames(bundle):
        raise DataError(name, "holds only frames that the map was made of", "merge a bundle of another recording")
    alignment = align_bundle(bundle, other, name, rng)
    T_world_other = alignment.T_world_other
    paired = PairedMap.of(bundle)
    cloud = cloud_of(other)
    points = cloud.points * (cloud.voxel_m / paired.voxel_m) ** 2  # of a surface, with this room's voxels
    moved = Components.of(other.original, points).moved(T_world_other)
    parted = part(moved, _KnownRegion(bundle), rng)
    new = moved[parted.is_outside] + parted.outer
    is_same_network = bundle.depth_model.content == other.depth_model.content
    known_bias = other.reference_poses
    poses = T_world_other @ known_bias.poses
    references = ReferencePoses.without_bias(poses)
    if is_same_network:
        references = ReferencePoses(poses, known_bias.forward_bias, known_bias.backward_bias)
    bias = _wider(bundle.settings.particle_bias, other.settings.particle_bias)
    landmark_bias = _wider(bundle.settings.landmark_bias, other.settings.landmark_bias)
    edited = replace(
        paired.with_new(new).on(bundle),
        landmarks=joined(bundle.landmarks, _moved(other.landmarks, T_world_other)),
        reference_poses=_joined_references(bundle.reference_poses, references),
        provenance=with_frames(bundle.provenance, other.provenance.recording, other.provenance.frames),
        settings=bundle.settings.model_copy(update={"particle_bias": bias, "landmark_bias": landmark_bias}),
        thresholds=LikelihoodThresholds(
            low=min(bundle.thresholds.low, other.thresholds.low),
            lost=min(bundle.thresholds.lost, other.thresholds.lost),
        ),
    )
    measured: dict[str, Any] = {"agreeing_landmarks": alignment.agreeing, **_described(alignment)}
    measured |= {"same_network": is_same_network, "new_components": len(new)} | _other_camera(bundle, other.camera)
    return finish(bundle, edited, "merge", parameters, None, rng, **measured)


def _other_camera(bundle: Bundle, camera: Camera) -> dict[str, Any]:
    """The camera behind the new reference poses, where it is another one: how wide it saw tells what is free."""
    return {} if camera == bundle.camera else {"camera": TypeAdapter(Camera).dump_python(camera, mode="json")}


class _KnownRegion:
    """Where a bundle's map knows surfaces; a :class:`monoloc.map.local_fit.Region`."""

    def __init__(self, bundle: Bundle) -> None:
        lower, upper = bundle.original.bounds_m()
        self.centre = 0.5 * (lower + upper)
        self.reach_m = 0.5 * float(np.linalg.norm(upper - lower))
        self._bundle = bundle

    def contains(self, points: FloatArray) -> Any:
        return known(self._bundle, points) if len(points) else np.zeros(0, dtype=np.bool_)


def _described(alignment: Alignment) -> dict[str, Any]:
    return {
        "T_world_other": alignment.T_world_other.round(6).tolist(),
        "landmarks_to_surfaces": round(alignment.apart_m, 4),
        "overlap": round(alignment.overlap, 3),
    }


def _fingerprints(recording: Recording) -> dict[str, int]:
    return {name: fingerprint(recording.color(index)) for index, name in enumerate(recording.frame_names)}


SEEN_BY_UPDATE = "flight "
"""Begins the name of a frame that an update used, but that gave the map no surfaces."""


def with_frames(provenance: Provenance, name: str, frames: dict[str, int]) -> Provenance:
    """With the frames of other recordings, name and checksum; equal names get a number.

    Args:
        provenance: of the map.
        name: of the recording, or of several as a provenance names them; those that the map has are not repeated.
        frames: name and checksum of each.
    """
    both = dict(provenance.frames)
    for frame, checksum in frames.items():
        key, number = frame, 2
        while both.get(key, checksum) != checksum:
            key, number = f"{frame} ({number})", number + 1
        both[key] = checksum
    names = dict.fromkeys([*provenance.recording.split(" + "), *name.split(" + ")])
    return provenance.model_copy(update={"frames": both, "recording": " + ".join(names)})


def _joined_references(first: ReferencePoses, second: ReferencePoses) -> ReferencePoses:
    """Both, of the second as many as there is room for, evenly."""
    some = evenly_spaced(max(1, len(second)), MOST_POSES - len(first))[: len(second)]
    pairs = zip(
        (first.poses, first.forward_bias, first.backward_bias),
        (second.poses, second.forward_bias, second.backward_bias),
        strict=True,
    )
    return ReferencePoses(*(np.concatenate([one, two[some]]) for one, two in pairs))


def _moved(landmarks: Landmarks, T_new_old: FloatArray) -> Landmarks:
    views = landmarks.views
    if views is not None:
        views = LandmarkViews(T_new_old @ views.poses, views.found)
    points = transform(T_new_old, landmarks.points.astype(np.float64)).astype(np.float32)
    return Landmarks(points, landmarks.descriptors, views)


def _wider(bias: _Model, other: _Model) -> _Model:
    pairs = zip(bias.model_dump().items(), other.model_dump().values(), strict=True)
    return bias.model_copy(update={name: max(value, others) for (name, value), others in pairs})


def _with_bias_of(bundle: Bundle, recording: Recording, poses: FloatArray) -> Bundle:
    """With a bias at the reference poses that is no less than measured along stretches of the new frames."""
    frames = spread_stretches(_STRETCHES, recording.timestamps_s, poses)
    new = narrowed(with_poses(recording, poses), frames)
    final = localizer_factory(replace(bundle, camera=recording.camera), 0)
    new_bias, _ = measure_bias_at_reference(final, new, False, NoProgress())
    bias = _wider(bundle.settings.particle_bias, new_bias)
    return replace(bundle, settings=bundle.settings.model_copy(update={"particle_bias": bias}))
