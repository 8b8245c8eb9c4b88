"""Corners matched between frames that see the same from places far apart, which tell scale and focal length.

Corners of neighbouring frames move mostly as the camera turns, which depth and the scale of the poses do not enter:
the more so, the more frames a second. So these pairs are chosen by how far the camera moved between them.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, rotation_angle
from monoloc.io.recording import evenly_spaced
from monoloc.landmarks.features import KeypointDetector, Keypoints, match_descriptors
from monoloc.recording_check.correspondences import LEAST_MATCHES, LEAST_MOTION, joined_pairs, median_motion_px
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.reprojection import LEAST_WITH_DEPTH

_PAIRS = 60
_LEAST_PAIRS = 8  # of fewer, the standard deviations mean little
# Distance between the two frames, share of the scene's depth, and turn. With up to twice the distance, right poses of
# 100 frames of RedKitchen had drifted, and the scale came out 7 % off in place of 4 %.
_LEAST_DISTANCE, _MOST_DISTANCE, _MOST_TURN_RAD = 0.075, 0.15, np.deg2rad(20.0)
_ANYWHERE_PX = 1e4  # radius in which a corner is looked for
_EPIPOLAR_PX, _CONFIDENCE = 1.5, 0.999


def match_wide(evidence: Evidence, scale: float = 1.0) -> Evidence | None:
    """Evidence of pairs of frames far apart; None if the recording has too few.

    Args:
        evidence: of neighbouring frames, which say how far away the scene is.
        scale: of the depth over that of the poses, as far as it is known.

    Raises:
        DataError: a frame cannot be read.
    """
    starts = evenly_spaced(len(evidence.recording), _PAIRS)
    depth_m = _scene_depth_m(evidence, starts)
    if depth_m is None:
        return None
    images = _Keypoints(evidence)
    found = []
    for start, scene_m in zip(starts.tolist(), (depth_m / scale).tolist(), strict=True):
        partner = _partner(evidence.poses, start, scene_m)
        pixels = None if partner is None else _matched(images(start), images(partner))
        if partner is not None and pixels is not None:
            found.append(((start, partner), pixels))
    least_px = LEAST_MOTION * images.camera.width  # a stream that froze shows none
    found = [pair for pair in found if median_motion_px(pair[1]) >= least_px]
    matches = joined_pairs(images.camera, found, np.array([median_motion_px(pixels) for _, pixels in found]))
    wide = evidence.of(evidence.recording, matches)
    with_depth = np.bincount(matches.pair[wide.depth_m(wide.poses) > 0.0], minlength=1)
    return wide if np.sum(with_depth >= LEAST_WITH_DEPTH) >= _LEAST_PAIRS else None


def _scene_depth_m(evidence: Evidence, starts: NDArray[np.int64]) -> FloatArray | None:
    """Median depth of the corners around frames (S,), metres; None if it is nowhere known."""
    matches, depth_m = evidence.matches, evidence.depth_m(evidence.poses)
    of_pairs = [depth_m[matches.of_pair(index)] for index in range(len(matches))]
    medians = np.array([np.median(of[of > 0.0]) if (of > 0.0).any() else np.nan for of in of_pairs])
    known = np.isfinite(medians)
    if not known.any():
        return None
    return np.asarray(np.interp(starts, matches.frames[known, 0], medians[known]))


def _partner(poses: FloatArray, start: int, scene_m: float) -> int | None:
    """The frame with the most parallax for its turn, before the camera looks elsewhere; None if it hardly moves.

    Poses drift between one visit and the next.
    """
    distance = np.linalg.norm(poses[:, :3, 3] - poses[start, :3, 3], axis=1) / scene_m
    turn_rad = rotation_angle(poses[:, :3, :3].transpose(0, 2, 1) @ poses[start, :3, :3])
    elsewhere = np.flatnonzero((distance > _MOST_DISTANCE) | (turn_rad > _MOST_TURN_RAD))
    begin = elsewhere[elsewhere < start].max(initial=-1) + 1
    end = elsewhere[elsewhere > start].min(initial=len(poses))
    far = begin + np.flatnonzero(distance[begin:end] > _LEAST_DISTANCE)
    return int(far[np.argmax(distance[far] - turn_rad[far])]) if len(far) else None


class _Keypoints:
    """Keypoints of a recording's frames, which several pairs may share."""

    def __init__(self, evidence: Evidence) -> None:
        self._recording = evidence.recording
        self._detect = KeypointDetector(self._recording.camera)
        self.camera = self._detect.camera
        self._known: dict[int, Keypoints] = {}

    def __call__(self, index: int) -> Keypoints:
        if index not in self._known:
            self._known[index] = self._detect(self._recording.color(index))
        return self._known[index]


def _matched(first: Keypoints, second: Keypoints) -> NDArray[np.float32] | None:
    """Corners (M, 2, 2) that one rigid motion explains; None if there are few."""
    a, b = match_descriptors(first.pixels, first.descriptors, second.pixels, second.descriptors, _ANYWHERE_PX)
    if len(a) < LEAST_MATCHES:
        return None
    pixels = np.stack([first.pixels[a], second.pixels[b]], axis=1).astype(np.float32)
    _, is_inlier = cv2.findFundamentalMat(pixels[:, 0], pixels[:, 1], cv2.FM_RANSAC, _EPIPOLAR_PX, _CONFIDENCE)
    if is_inlier is None or is_inlier.sum() < LEAST_MATCHES:
        return None
    return np.asarray(pixels[is_inlier.ravel() == 1])
