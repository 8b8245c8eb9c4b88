"""Where another recording or another map lies in a room: by landmarks first, then by surfaces.

Both must agree. Landmarks may stand on an object that was moved, and surfaces fit in several places; rarely both are
wrong alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.builder.pose_refinement import MixtureTarget, PosePrior
from monoloc.bundle import Bundle
from monoloc.editing.paired_map import cloud_of
from monoloc.errors import DataError
from monoloc.geometry import (
    FloatArray,
    invert,
    make_pose,
    nearest_rotation,
    pose_distance_m,
    se3_exp,
    se3_log,
    transform,
)
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.features import MATCH_BITS
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer

LOOKED_AT = 16
"""Frames of a recording that are localised in the room."""

LEAST_FRAMES = 3
"""Frames that must agree, and half of those that are localised."""

AGREE_M = 0.15
"""Pose distance within which poses agree, and landmarks and surfaces."""

LEAST_OVERLAP = 0.1
"""Share of the other's surfaces that the map must know."""

_POINTS, _ROUNDS = 1500, 4  # of the surfaces that are aligned, and how often
_PRIOR = PosePrior(0.1, 0.05)  # of what landmarks give
_KNOWN_POINTS = 0.2  # a voxel: a surface point is known where the map expects so many
_PAIR_M, _LEAST_PAIRS, _TRIALS = 0.06, 30, 500  # landmarks of two maps: distance of a pair, pairs, triples drawn
_ROUGHLY_M, _SCALE_PAIRS = 0.3, 5000  # distance of a pair in worlds of other scales; distances that are compared
_MOST_OFF = 0.05  # logarithm of a scale, as of depth
_RATIO = 0.85  # of the best match's distance to that of the second best


PosedFrames = tuple[NDArray[np.int64], FloatArray]
"""Frames that landmarks localise, (F,), and ``T_world_camera`` of each, (F, 4, 4)."""


@dataclass(frozen=True)
class Alignment:
    """Where another world lies in a room.

    Attributes:
        T_world_other: (4, 4).
        agreeing: how many frames of a recording, or landmarks of a bundle, agree.
        apart_m: pose distance between the placements by landmarks and by surfaces, at the middle of the surfaces.
        overlap: share of the other's surfaces that the map knows.
    """

    T_world_other: FloatArray
    agreeing: int
    apart_m: float
    overlap: float


def known(bundle: Bundle, points: FloatArray) -> NDArray[np.bool_]:
    """Whether a bundle's map knows surface points (N, 3), world frame, (N,)."""
    cloud = cloud_of(bundle)
    expected = cloud.points * cloud.voxel_m**3 * np.exp(bundle.original.log_density(points))
    return np.asarray(expected >= _KNOWN_POINTS)


def align_recording(
    bundle: Bundle, recording: Recording, posed: PosedFrames, cloud: FloatArray, rng: np.random.Generator
) -> Alignment:
    """Where a posed recording's world lies in a room.

    Args:
        bundle: the room.
        recording: with poses.
        posed: its :func:`poses_by_landmarks`.
        cloud: of the recording, (N, 3), its world frame, metres.

    Raises:
        DataError: landmarks do not place it, the surfaces do not overlap, or both do not agree.
    """
    assert recording.poses is not None
    if not len(bundle.landmarks):
        problem = "cannot be aligned: the bundle has no landmarks"
        raise DataError(recording.name, problem, "build it with landmarks, or record in its world: without --align")
    frames, there = posed
    agreed = consensus(there, recording.poses[frames])
    if agreed is None:
        problem = f"is not found in the room: landmarks agree on no place ({len(frames)} frames localised)"
        raise DataError(recording.name, problem, "record it from where the room's recording looked, too")
    return _by_surfaces(bundle, recording.name, cloud, *agreed, rng)


def align_bundle(bundle: Bundle, other: Bundle, name: str, rng: np.random.Generator) -> Alignment:
    """Where another bundle's world lies in a room.

    Args:
        name: of the other bundle, for messages.

    Raises:
        DataError: as :func:`align_recording`, or it is in another scale.
    """
    if not len(bundle.landmarks) or not len(other.landmarks):
        problem = f"cannot be merged: {'the other bundle' if len(other.landmarks) else 'it'} has no landmarks"
        raise DataError(name, problem, "build both with landmarks")
    pairs = _pairs(bundle.landmarks, other.landmarks)
    agreed = _rigid(*pairs, rng)
    if agreed is None:
        problem = f"does not overlap: no place where {_LEAST_PAIRS} of its landmarks are those of the room"
        raise DataError(name, problem, "merge rooms whose recordings looked at a common part")
    _check_scale(name, *pairs, agreed[0])
    return _by_surfaces(bundle, name, other.original.sample(4 * _POINTS, rng), *agreed, rng)


def poses_by_landmarks(bundle: Bundle, recording: Recording) -> PosedFrames:
    """Those of some frames that the room's landmarks localise, (F,), and ``T_world_camera`` of each, (F, 4, 4)."""
    localizer = OrbLandmarkLocalizer(bundle.landmarks, recording.camera)
    frames, poses = [], []
    for index in evenly_spaced(len(recording), LOOKED_AT).tolist():
        found = localizer.relocalize(localizer.detect(recording.color(index)))
        if found is not None:
            frames.append(index)
            poses.append(found.pose)
    return np.array(frames, dtype=np.int64), np.reshape(poses, (-1, 4, 4))


def consensus(there: FloatArray, here: FloatArray) -> tuple[FloatArray, int] | None:
    """``T_there_here`` on which most of the same cameras' poses (F, 4, 4) agree, and how many do."""
    if len(there) < LEAST_FRAMES:
        return None
    candidates = there @ invert(here)
    agree = np.stack([_distances_m(there, each @ here) < AGREE_M for each in candidates])
    best = int(np.argmax(agree.sum(axis=1)))
    count = int(agree[best].sum())
    if count < LEAST_FRAMES or 2 * count < len(there):
        return None
    # About the middle of the cameras, so that their errors of rotation do not shift them: medians are axis by axis.
    middle = make_pose(np.eye(3), here[agree[best], :3, 3].mean(axis=0))
    offsets = se3_log(invert(candidates[best] @ middle) @ candidates[agree[best]] @ middle)
    return candidates[best] @ middle @ se3_exp(np.median(offsets, axis=0)) @ invert(middle), count


def _distances_m(poses: FloatArray, others: FloatArray) -> FloatArray:
    return np.array([pose_distance_m(a, b[None])[0] for a, b in zip(poses, others, strict=True)])


def _by_surfaces(
    bundle: Bundle, name: str, cloud: FloatArray, by_landmarks: FloatArray, count: int, rng: np.random.Generator
) -> Alignment:
    """Align the part of a cloud that the map knows, from what landmarks give."""
    placed = transform(by_landmarks, cloud)
    is_known = known(bundle, placed)
    overlap = float(is_known.mean())
    if overlap < LEAST_OVERLAP:
        problem = f"does not fit: where landmarks place it, the map knows {overlap:.0%} of its surfaces"
        raise DataError(name, problem, "give one that overlaps the room")
    # About the middle of the surfaces, so that a turn does not shift them.
    middle = make_pose(np.eye(3), placed[is_known].mean(axis=0))
    points = transform(invert(middle), rng.permutation(placed[is_known])[:_POINTS])
    target, pose = MixtureTarget(bundle.original), middle
    for _ in range(_ROUNDS):
        pose = target.align(points, pose, middle, _PRIOR)
    apart_m = float(pose_distance_m(middle, pose[None])[0])
    if apart_m > AGREE_M:
        problem = f"landmarks and surfaces do not agree: they place it {apart_m:.2f} (metres plus radians) apart"
        raise DataError(name, problem, "check its poses and depth: monoloc check")
    return Alignment(pose @ invert(middle) @ by_landmarks, count, apart_m, overlap)


def _pairs(landmarks: Landmarks, others: Landmarks) -> tuple[FloatArray, FloatArray]:
    """Points of landmarks of two maps that look alike, (P, 3) each; one of the first may be in several pairs."""
    if min(len(landmarks), len(others)) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    bits, nearest = cv2.batchDistance(
        others.descriptors, landmarks.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2
    )
    chosen = np.flatnonzero((bits[:, 0] < MATCH_BITS) & (bits[:, 0] < _RATIO * bits[:, 1]))
    there = landmarks.points[np.asarray(nearest)[chosen, 0]].astype(np.float64)
    return there, others.points[chosen].astype(np.float64)


def _rigid(there: FloatArray, here: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, int] | None:
    """``T_there_here`` on which most pairs of points (P, 3) agree, by RANSAC (Fischler & Bolles 1981)."""
    if len(there) < _LEAST_PAIRS:
        return None
    best = np.zeros(len(there), dtype=np.bool_)
    for _ in range(_TRIALS):
        triple = rng.choice(len(there), 3, replace=False)
        agree = _agree(_fitted(there[triple], here[triple]), there, here)
        best = agree if agree.sum() > best.sum() else best
    for _ in range(3):
        if best.sum() < _LEAST_PAIRS:
            return None
        pose = _fitted(there[best], here[best])
        best = _agree(pose, there, here)
    return pose, int(best.sum())


def _check_scale(name: str, there: FloatArray, here: FloatArray, pose: FloatArray) -> None:
    """Refuse a world of another scale, by the distances between the points of pairs (P, 3) that agree roughly."""
    near = np.linalg.norm(transform(pose, here) - there, axis=1) < _ROUGHLY_M
    there, here = there[near], here[near]
    one, two = np.random.default_rng(0).integers(0, len(there), (2, _SCALE_PAIRS))
    there_m, here_m = (np.linalg.norm(points[one] - points[two], axis=1) for points in (there, here))
    is_far = there_m > _ROUGHLY_M
    if np.count_nonzero(is_far) < _LEAST_PAIRS:
        return
    factor = float(np.median(here_m[is_far] / there_m[is_far]))
    if abs(np.log(factor)) > _MOST_OFF:
        problem = f"is in another scale: its distances are {factor:.3g} times those of the room"
        fix = "build the wrong one again, from depth and poses in metres, or from its video with a better --scale"
        raise DataError(name, problem, fix)


def _agree(pose: FloatArray, there: FloatArray, here: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.linalg.norm(transform(pose, here) - there, axis=1) < _PAIR_M)


def _fitted(there: FloatArray, here: FloatArray) -> FloatArray:
    """Least-squares rigid motion between points (N, 3) (Umeyama 1991)."""
    centre_there, centre_here = there.mean(axis=0), here.mean(axis=0)
    rotation = nearest_rotation((there - centre_there).T @ (here - centre_here))
    return make_pose(rotation, centre_there - rotation @ centre_here)
