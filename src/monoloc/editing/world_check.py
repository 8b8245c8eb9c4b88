"""Whether a recording's poses are in the room's world, by the room's landmarks, or by surfaces where it has none.

A frame confirms its pose if landmarks localise it there, or if its depth is that of the landmarks that should be in
view. Away from the build's views few landmarks are recognised, but where they should be is known. It contradicts its
pose if landmarks localise it elsewhere, or if the depth is another one. Where no landmark should be in view, such as
in a part of the room that the build never saw, it says nothing. If no frame confirms its pose, nothing tells a new
part of the room from another room whose world happens to begin there, and the recording is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.bundle import Bundle
from monoloc.depth.depth_image import sample_depth
from monoloc.editing.alignment import (
    AGREE_M,
    LEAST_FRAMES,
    LEAST_OVERLAP,
    LOOKED_AT,
    PosedFrames,
    consensus,
    known,
)
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, pose_distance_m, transform
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.landmark_map import FAMILIAR_TIMES, LandmarkViews

# A landmark should be in view where so many views found it from a similar direction and distance.
_ALIKE_COS, _ALIKE_DISTANCES = np.cos(np.deg2rad(20.0)), 1.5
_LEAST_IN_VIEW = 100
_SAME_DEPTH = 0.1  # relative, with the errors of landmarks and depth
# Share of the landmarks in view with their depth, from which on the pose is confirmed. Of the frames that landmarks
# did not localise at their right poses (RedKitchen, the desk), 22 of 28 had more, and five 0.7 to 0.8.
_LEAST_SHARE = 0.8


@dataclass(frozen=True)
class WorldCheck:
    """How many frames of a recording confirm and contradict its poses, of those that were looked at."""

    confirmed: int
    contradicted: int
    looked_at: int


def check_same_world(bundle: Bundle, recording: Recording, posed: PosedFrames, cloud: FloatArray) -> WorldCheck:
    """Refuse a recording whose poses are in another world, as far as landmarks tell, or surfaces without them.

    Args:
        bundle: the room.
        recording: with poses and depth.
        posed: its :func:`monoloc.editing.alignment.poses_by_landmarks`.
        cloud: of the recording, (N, 3), where its poses place it, metres.

    Raises:
        DataError: landmarks agree on another world, most of the frames that they tell of contradict their poses, or
            no frame confirms its pose; or the room has no landmarks, and knows hardly any of the surfaces.
    """
    if not len(bundle.landmarks):
        _check_surfaces(bundle, recording.name, cloud)
        return WorldCheck(0, 0, 0)
    poses = recording.poses
    assert poses is not None
    found, there = posed
    here = poses[found]
    is_near = np.array([pose_distance_m(a, b[None])[0] < AGREE_M for a, b in zip(there, here, strict=True)], np.bool_)
    agreed = consensus(there, here)
    if agreed is not None and 2 * np.count_nonzero(is_near) < agreed[1]:
        shift_m = float(np.linalg.norm(transform(agreed[0], here[:1, :3, 3]) - here[0, :3, 3]))
        problem = f"is in another world: landmarks see its cameras {shift_m:.2f} m from where its poses say"
        raise DataError(recording.name, problem, "align it: --align")
    near, elsewhere = set(found[is_near].tolist()), set(found[~is_near].tolist())
    frames = evenly_spaced(len(recording), LOOKED_AT).tolist()
    said = [True if index in near else _said(bundle, recording, index, index in elsewhere) for index in frames]
    check = WorldCheck(said.count(True), said.count(False), len(frames))
    if check.contradicted > check.confirmed and check.contradicted >= min(LEAST_FRAMES, len(frames)):
        compared = check.confirmed + check.contradicted
        problem = f"contradicts the map: {check.confirmed} of {compared} frames see the landmarks that they should"
        raise DataError(recording.name, problem, "check its poses: monoloc check; or align it: --align")
    if check.confirmed == 0:
        problem = f"shows nothing of the map: its landmarks confirm none of the {len(frames)} frames looked at"
        fix = "give a walk that begins where the map's recording looked; for another room, build a place"
        raise DataError(recording.name, problem, fix, page="how-to/many-rooms")
    return check


def _check_surfaces(bundle: Bundle, name: str, cloud: FloatArray) -> None:
    overlap = float(known(bundle, cloud).mean())
    if overlap < LEAST_OVERLAP:
        problem = (
            f"shows too little of the map: where its poses place it, the map knows {overlap:.0%} of its surfaces"
        )
        fix = "give a walk in the map's world that begins where the map's recording looked"
        raise DataError(name, problem, fix)


def _said(bundle: Bundle, recording: Recording, index: int, is_elsewhere: bool) -> bool | None:
    """Whether a frame that landmarks do not localise at its pose confirms it all the same; None if nothing tells."""
    assert recording.poses is not None
    pose, camera, views = recording.poses[index], recording.camera, bundle.landmarks.views
    nothing = False if is_elsewhere else None
    if views is None:
        return nothing
    points = bundle.landmarks.points.astype(np.float64)
    local = transform(invert(pose), points)
    in_view = np.flatnonzero(camera.in_sight(local))
    in_view = in_view[_found_alike(views, in_view, points[in_view], pose[:3, 3])]
    pixels = camera.project(local[in_view]).astype(np.float32)
    depth_m = sample_depth(pixels, camera, recording.depth(index), camera)
    ratios = depth_m[depth_m > 0.0] / local[in_view, 2][depth_m > 0.0]
    if len(ratios) < _LEAST_IN_VIEW:
        return nothing
    return float(np.mean(np.abs(ratios - 1.0) < _SAME_DEPTH)) >= _LEAST_SHARE


def _found_alike(
    views: LandmarkViews, which: NDArray[np.int64], points: FloatArray, centre: FloatArray
) -> NDArray[np.bool_]:
    """Of landmarks (N,) at points (N, 3), those that views found from where a camera centre (3,) sees them alike."""
    ray = centre - points
    distance_m = np.linalg.norm(ray, axis=1)
    times = np.zeros(len(points), dtype=np.int64)
    for pose, found in zip(views.poses, views.found[:, which], strict=True):
        other = pose[:3, 3] - points
        other_m = np.linalg.norm(other, axis=1)
        is_alike = np.sum(ray * other, axis=1) > _ALIKE_COS * distance_m * other_m
        is_alike &= np.maximum(distance_m, other_m) < _ALIKE_DISTANCES * np.minimum(distance_m, other_m)
        times += found & is_alike
    return times >= FAMILIAR_TIMES
