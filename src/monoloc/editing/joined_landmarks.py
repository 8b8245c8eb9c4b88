"""Landmarks of two origins in one room: each once, with the views of both."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.builder.landmark_triangulation import Corners, corners_of, landmarks_of
from monoloc.camera import Camera
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.features import MATCH_BITS, KeypointDetector
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import PRIOR_COVARIANCE

_SAME_M, _CANDIDATES = 0.05, 8  # distance within which landmarks that look alike are one; best matches looked at
_MOST_FRAMES = 150


def joined(landmarks: Landmarks, others: Landmarks) -> Landmarks:
    """Landmarks of two maps of one world; those of the second that the first has too are one with these."""
    place = _places_among(others, landmarks)
    new = place < 0
    points = np.concatenate([landmarks.points, others.points[new]])
    descriptors = np.concatenate([landmarks.descriptors, others.descriptors[new]])
    first, second = landmarks.views, others.views
    if first is None or second is None:
        return Landmarks(points, descriptors, _padded(first, int(new.sum())))
    found = np.zeros((len(first.poses) + len(second.poses), len(points)), dtype=np.bool_)
    found[: len(first.poses), : len(landmarks)] = first.found
    place[new] = len(landmarks) + np.arange(new.sum())
    view, other = np.nonzero(second.found)
    found[len(first.poses) + view, place[other]] = True
    return Landmarks(points, descriptors, LandmarkViews(np.concatenate([first.poses, second.poses]), found))


def with_recording(landmarks: Landmarks, recording: Recording, poses: FloatArray) -> Landmarks:
    """With the landmarks that a recording with depth sees, and its frames as views of all of them.

    Args:
        poses: ``T_world_camera`` of its frames, (N, 4, 4), in the landmarks' world.
    """
    detect = KeypointDetector(recording.camera)
    frames = evenly_spaced(len(recording), _MOST_FRAMES)
    corners = list(corners_of(recording, frames, detect, recording.depth))
    seen = landmarks_of(corners, detect.camera, poses[frames])
    both = joined(landmarks, seen)
    if landmarks.views is None:
        return both
    new_views = _views(both, corners, recording.camera, poses[frames])
    first = both.views
    assert first is not None
    views = LandmarkViews(
        np.concatenate([first.poses, new_views.poses]), np.concatenate([first.found, new_views.found])
    )
    return Landmarks(both.points, both.descriptors, views)


def _views(landmarks: Landmarks, corners: list[Corners], camera: Camera, poses: FloatArray) -> LandmarkViews:
    localizer = OrbLandmarkLocalizer(landmarks, camera)
    found = np.zeros((len(poses), len(landmarks)), dtype=np.bool_)
    for row, each, pose in zip(found, corners, poses, strict=True):
        measured = localizer.measure_near(each.keypoints, pose, PRIOR_COVARIANCE)
        row[measured.visible[measured.is_found]] = True
    return LandmarkViews(poses, found)


def _padded(views: LandmarkViews | None, count: int) -> LandmarkViews | None:
    if views is None:
        return None
    return LandmarkViews(views.poses, np.pad(views.found, ((0, 0), (0, count))))


def is_among(landmarks: Landmarks, others: Landmarks) -> NDArray[np.bool_]:
    """Whether each of L landmarks is one of the others, (L,)."""
    return _places_among(landmarks, others) >= 0


def _places_among(landmarks: Landmarks, others: Landmarks) -> NDArray[np.int64]:
    """Which of the others each of L landmarks is, the most similar one, (L,); -1 if none."""
    if not len(landmarks) or not len(others):
        return np.full(len(landmarks), -1, dtype=np.int64)
    bits, nearest = cv2.batchDistance(
        landmarks.descriptors,
        others.descriptors,
        cv2.CV_32S,
        normType=cv2.NORM_HAMMING,
        K=min(_CANDIDATES, len(others)),
    )
    nearest = np.asarray(nearest, dtype=np.int64)
    apart = np.linalg.norm(others.points[nearest] - landmarks.points[:, None], axis=2)
    is_same = (np.asarray(bits) < MATCH_BITS) & (apart < _SAME_M)
    first = np.argmax(is_same, axis=1)[:, None]  # they are sorted by similarity
    return np.where(is_same.any(axis=1), np.take_along_axis(nearest, first, axis=1)[:, 0], -1)
