"""Landmarks of a build's frames: corners that several of them saw in one place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.adapt.hold_out import HELD_OUT_SHARE, REGIONS, hold_out_regions
from monoloc.adapt.lasting import lasting_errors
from monoloc.camera import Camera
from monoloc.datasets.base import Recording
from monoloc.depth_image import sample_depth
from monoloc.evaluation.trajectory import twist_errors
from monoloc.filter.lasting import LastingErrors
from monoloc.geometry import FloatArray, invert, se3_log, transform, viewpoints_apart
from monoloc.landmarks import KeypointDetector, Keypoints, Landmarks, pairs
from monoloc.progress import Progress
from monoloc.sighting import LandmarkSight

_REACH_PX = 6.0  # from where a corner should be, by a frame's pose and another's depth
_DEPTH_JUMP = 0.15  # corners beside a larger relative jump of depth sit on an edge
_DEPTH_SD = 0.01  # of measured depth, as a share of it
_HUBER, _STEPS = 2.0, 5
_AGREE_SD = 2.5  # standard deviations within which half of a landmark's corners have to be
_A_FRAME = 100  # landmarks that a frame is to see of its own
_LOOKED_FOR = np.diag([0.05, 0.05, 0.05, 0.03, 0.03, 0.03]) ** 2  # how far beside the true pose, to be measured


def build_landmarks(
    recording: Recording, depth_of: Callable[[int], NDArray[np.float32]], progress: Progress
) -> tuple[Landmarks, LastingErrors]:
    """Landmarks of a recording, and how wide the errors are of what they say, near its viewpoints and away from them.

    Near: every other frame is looked at by the landmarks of the others. Away: frames of regions that are held out by
    landmarks that no frame there saw.

    Args:
        recording: posed frames, five at least.
        depth_of: a frame's depth, (H, W) m, 0 where there is none.

    Returns:
        No landmarks where too few are seen again to tell a pose.
    """
    poses = recording.poses
    assert poses is not None
    frames = np.arange(len(recording))
    held_out = np.sort(np.concatenate(hold_out_regions(poses, REGIONS, HELD_OUT_SHARE)))
    with progress.task("landmarks", 2 * len(frames) + len(held_out)) as show:
        corners, camera = _corners_of(recording, depth_of, show)

        def errors(by: NDArray[np.int64], of: NDArray[np.int64], done: int) -> tuple[FloatArray, NDArray[np.int64]]:
            """Twists (M, 6) of the frames that see landmarks of others, and which frames those are."""
            landmarks = landmarks_of([corners[index] for index in by], camera, poses[by])
            sight = LandmarkSight(landmarks, recording.camera)
            found, seen = [], []
            for count, index in enumerate(of.tolist()):
                sighting = sight(recording.color(index), poses[index], _LOOKED_FOR)
                show(done + count + 1)
                if sighting is not None:
                    found.append(se3_log(invert(poses[index]) @ sighting.pose))
                    seen.append(index)
            return np.reshape(found, (-1, 6)), np.array(seen, dtype=np.int64)

        even, odd = frames[::2], frames[1::2]
        near = np.concatenate([errors(even, odd, len(frames))[0], errors(odd, even, len(frames) + len(odd))[0]])
        others = np.setdiff1d(frames, held_out)
        away, seen = errors(others, held_out, 2 * len(frames))
    if 2 * len(near) < len(frames):
        return Landmarks.none(), LastingErrors()
    distances_m = np.array([viewpoints_apart(poses[index], poses[others]).min() for index in seen])
    near_errors = twist_errors(near)
    lasting = lasting_errors(near_errors, near_errors, twist_errors(away), distances_m)
    return landmarks_of(corners, camera, poses), lasting


@dataclass(frozen=True)
class Corners:
    """Keypoints of one frame with their depth, (N,) m, 0 where there is none."""

    keypoints: Keypoints
    depth_m: FloatArray


def _corners_of(
    recording: Recording, depth_of: Callable[[int], NDArray[np.float32]], show: Callable[[int], None]
) -> tuple[list[Corners], Camera]:
    """Corners of every frame, and the camera of whose images they are."""
    detect = KeypointDetector(recording.camera)
    found = []
    for index in range(len(recording)):
        keypoints = detect(recording.color(index))
        pixels = keypoints.pixels.astype(np.float32)
        depth = sample_depth(pixels, detect.camera, depth_of(index), recording.camera, _DEPTH_JUMP)
        found.append(Corners(keypoints, depth))
        show(index + 1)
    return found, detect.camera


def landmarks_of(corners: list[Corners], camera: Camera, poses: FloatArray) -> Landmarks:
    """Landmarks of frames (N, 4, 4) ``T_world_camera`` of a camera: corners that two or more of them saw."""
    seen = _gathered(corners, camera, poses)
    points, agree = _placed(seen, corners, camera, poses)
    counts = np.bincount(seen.landmark, minlength=len(seen.points))
    chosen = _chosen(seen, counts, np.flatnonzero(agree & (counts >= 2)), len(corners))
    return Landmarks(points[chosen].astype(np.float32), _descriptors(seen, corners)[chosen])


@dataclass(frozen=True)
class _Seen:
    """L landmarks, where first lifted (L, 3), and of O corners the landmark, the frame and the number in it."""

    points: FloatArray
    landmark: NDArray[np.int64]
    frame: NDArray[np.int64]
    corner: NDArray[np.int64]


def _gathered(corners: list[Corners], camera: Camera, poses: FloatArray) -> _Seen:
    """Frame by frame, corners that look like a landmark near which they are, and new landmarks of the others."""
    points, known = np.zeros((0, 3)), np.zeros((0, 32), np.uint8)
    landmark, frame, corner = [], [], []
    for index, (each, pose) in enumerate(zip(corners, poses, strict=True)):
        local = transform(invert(pose), points)
        ahead = np.flatnonzero(camera.in_sight(local))
        keypoints = each.keypoints
        which, where = pairs(
            camera.project(local[ahead]), known[ahead], keypoints.pixels, keypoints.descriptors, _REACH_PX
        )
        fresh = np.setdiff1d(np.flatnonzero(each.depth_m > 0.0), where)
        lifted = camera.rays(keypoints.pixels[fresh]) * each.depth_m[fresh, None]
        landmark.append(np.concatenate([ahead[which], len(points) + np.arange(len(fresh))]))
        corner.append(np.concatenate([where, fresh]))
        frame.append(np.full(len(which) + len(fresh), index))
        points = np.concatenate([points, transform(pose, lifted)])
        known = np.concatenate([known, keypoints.descriptors[fresh]])
    return _Seen(points, np.concatenate(landmark), np.concatenate(frame), np.concatenate(corner))


def _placed(
    seen: _Seen, corners: list[Corners], camera: Camera, poses: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Where landmarks are likeliest, (L, 3), and whether half of their corners agree, (L,)."""
    rays = np.concatenate([camera.rays(each.keypoints.pixels)[:, :2] for each in corners])
    sd = np.concatenate([each.keypoints.sd_px for each in corners]) / camera.focal_px
    depth = np.concatenate([each.depth_m for each in corners])
    at = np.cumsum([0, *(len(each.depth_m) for each in corners)])[seen.frame] + seen.corner
    rays, sd, depth = rays[at], sd[at], depth[at]
    T_camera_world = invert(poses)[seen.frame]
    R = T_camera_world[:, :3, :3]
    points = seen.points.copy()
    for _ in range(_STEPS):
        local = np.einsum("nij,nj->ni", R, points[seen.landmark]) + T_camera_world[:, :3, 3]
        z = np.maximum(local[:, 2], 1e-3)
        slopes = np.zeros((len(z), 3, 3))
        slopes[:, 0, 0] = slopes[:, 1, 1] = 1.0 / z
        slopes[:, :2, 2] = -local[:, :2] / z[:, None] ** 2
        slopes[:, 2, 2] = 1.0 / z
        with np.errstate(divide="ignore"):
            off = np.where(depth > 0.0, np.log(z) - np.log(depth), 0.0)
        residuals = np.concatenate(
            [(local[:, :2] / z[:, None] - rays) / sd[:, None], off[:, None] / _DEPTH_SD], axis=1
        )
        slopes[:, :2] /= sd[:, None, None]
        slopes[:, 2] *= np.where(depth > 0.0, 1.0 / _DEPTH_SD, 0.0)[:, None]
        weights = np.minimum(1.0, _HUBER / np.maximum(np.abs(residuals), 1e-9))
        jacobian = slopes @ R
        normal, gradient = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(normal, seen.landmark, np.einsum("nij,ni,nik->njk", jacobian, weights, jacobian))
        np.add.at(gradient, seen.landmark, np.einsum("nij,ni->nj", jacobian, weights * residuals))
        points -= np.linalg.solve(normal + 1e-6 * np.eye(3), gradient[..., None])[..., 0]
    off_sd = np.linalg.norm(residuals[:, :2], axis=1)
    agreeing = np.bincount(seen.landmark, off_sd < _AGREE_SD, len(points))
    return points, agreeing >= 0.5 * np.bincount(seen.landmark, minlength=len(points))


def _chosen(seen: _Seen, counts: NDArray[np.int64], candidates: NDArray[np.int64], frames: int) -> NDArray[np.int64]:
    """Those that most frames saw, until each frame has enough."""
    order = np.argsort(seen.landmark, kind="stable")
    starts = np.searchsorted(seen.landmark[order], np.arange(len(counts) + 1))
    has = np.zeros(frames, dtype=np.int64)
    chosen = []
    for index in candidates[np.argsort(-counts[candidates], kind="stable")].tolist():
        by = seen.frame[order[starts[index] : starts[index + 1]]]
        if np.any(has[by] < _A_FRAME):
            has[by] += 1
            chosen.append(index)
    return np.array(sorted(chosen), dtype=np.int64)


def _descriptors(seen: _Seen, corners: list[Corners]) -> NDArray[np.uint8]:
    """Of every landmark what most of its corners look like, bit by bit, (L, 32)."""
    all_ = np.concatenate([each.keypoints.descriptors for each in corners])
    at = np.cumsum([0, *(len(each.depth_m) for each in corners)])[seen.frame] + seen.corner
    votes = np.zeros((len(seen.points), 256), dtype=np.float32)
    np.add.at(votes, seen.landmark, 2.0 * np.unpackbits(all_[at], axis=1).astype(np.float32) - 1.0)
    return np.packbits(votes >= 0.0, axis=1)
