"""Mapping of landmarks: corners that several build frames saw in the same place."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.bias import fit_bias_model
from monoloc.camera import Camera
from monoloc.depth.depth_image import sample_depth
from monoloc.evaluation.consistency import FAR_M
from monoloc.evaluation.hold_out import HELD_OUT_SHARE, REGIONS, hold_out_regions
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, twist_errors
from monoloc.fusion.bias_model import BiasModel
from monoloc.geometry import FloatArray, invert, pose_distance_m, ray_jacobian, se3_log, transform
from monoloc.io.recording import Recording, evenly_spaced
from monoloc.landmarks.features import KeypointDetector, Keypoints, match_descriptors
from monoloc.landmarks.landmark_map import Landmarks
from monoloc.landmarks.pnp import LEAST_LANDMARKS, PRIOR_COVARIANCE, LandmarkPose, OrbLandmarkLocalizer
from monoloc.progress import Progress
from monoloc.supervision.camera_check import WELL_OBSERVED_SD
from monoloc.supervision.integrity import Classes, IntegrityModel

_RADIUS_PX = 6.0  # matching radius around the projection of a landmark lifted in another frame
_DEPTH_JUMP = 0.15  # relative; next to a larger jump a corner's depth is ambiguous
_DEPTH_SD = 0.01  # relative, of measured depth
_HUBER, _STEPS = 2.0, 5
_NEAREST_M, _LEAST_INFORMATION = 1e-3, 1e-6  # for a point behind a camera; for a point on a single ray
_AGREE_SD = 2.5  # standard deviations; half of a landmark's corners must lie within them
_MOST_FRAMES = 300  # computation time is quadratic in their number
_LANDMARKS_PER_FRAME = 100
_LEAST_M, _LEAST_RAD = 0.001, 0.0005  # smallest errors, even of a static camera
_WRONG_DISTANCE_M = 0.7  # pose distance between a true and a wrong pose
_CHI2_90_3 = 6.251388631170325  # 90 % quantile of the chi-squared distribution with 3 degrees of freedom
_NORMAL_MAD = 1.4826  # standard deviation over median deviation
_LEAST_FOCAL_FRAMES, _LEAST_FOCAL_SD = 10, 0.005  # frames that tell a deviation of log-focal, and the smallest
_PRIOR_GROWTH = 0.05  # m/m and rad/m, measured in other rooms


def build_landmarks(
    recording: Recording, depth_of: Callable[[int], NDArray[np.float32]], progress: Progress
) -> tuple[Landmarks, BiasModel, LandmarkEvidence]:
    """Map the landmarks of a recording, and measure the bias of landmark poses and what their number says.

    At the reference poses, each half of the frames is localised by the landmarks of the other half. Elsewhere,
    the frames of held-out regions are localised by landmarks from all other frames.

    Args:
        recording: posed frames, at least five; if there are more than 300, an even selection of 300 is used.
        depth_of: returns a frame's depth, (H, W) metres, 0 where there is none.
        progress: shows the number of frames done.

    Returns:
        Landmarks, bias and evidence; no landmarks if too few are seen repeatedly to determine poses.
    """
    poses = recording.poses
    assert poses is not None
    detect = KeypointDetector(recording.camera)
    frames = evenly_spaced(len(recording), _MOST_FRAMES)
    poses = poses[frames]
    with progress.task("landmarks", len(frames)) as show:
        corners = []
        for index in frames.tolist():
            keypoints = detect(recording.color(index))
            pixels = keypoints.pixels.astype(np.float32)
            depth = sample_depth(pixels, detect.camera, depth_of(index), recording.camera, _DEPTH_JUMP)
            corners.append(Corners(keypoints, depth))
            show(len(corners))
        measured = _measured(corners, recording.camera, detect.camera, poses)
        if measured is None:
            return Landmarks.none(), BiasModel(), LandmarkEvidence()
        return landmarks_of(corners, detect.camera, poses), *measured


@dataclass(frozen=True)
class LandmarkEvidence:
    """What landmarks say of a belief; the fields are those of :class:`IntegrityModel`."""

    found: Classes = field(default_factory=Classes)
    unseen_share: float = 0.5
    focal_mean: float = 0.0
    focal_sd: float = 1.0


@dataclass(frozen=True)
class Corners:
    """Keypoints of one frame and their depth, (N,) metres, 0 where there is none."""

    keypoints: Keypoints
    depth_m: FloatArray


@dataclass(frozen=True)
class _Localized:
    """Frames that are localised by other frames' landmarks.

    Attributes:
        frames: (M,) those that get a pose.
        errors: of these poses, beyond estimated noise.
        found: landmarks found in each frame at its true pose.
        found_wrong: the same at another frame's pose, where there is one far enough away, and the landmarks do not
            lead back to the true pose.
        log_focal: (F,) see :class:`monoloc.landmarks.pnp.LandmarkPose`, of the poses where it is well observed.
    """

    frames: NDArray[np.int64]
    errors: PoseErrors
    found: list[int]
    found_wrong: list[int]
    log_focal: FloatArray


def _measured(
    corners: list[Corners], camera: Camera, detected: Camera, poses: FloatArray
) -> tuple[BiasModel, LandmarkEvidence] | None:
    """Bias and evidence of what frames see of other frames' landmarks; None if fewer than half get a pose.

    Args:
        corners: corners of each frame.
        camera, detected: intrinsics of the recording, and of the images in which corners were detected.
        poses: (N, 4, 4) ``T_world_camera`` of the frames.
    """

    def localized(by: NDArray[np.int64], of: NDArray[np.int64]) -> _Localized:
        localizer = OrbLandmarkLocalizer(landmarks_of([corners[index] for index in by], detected, poses[by]), camera)
        return _localized(localizer, corners, poses, of)

    frames = np.arange(len(corners))
    both = localized(frames[::2], frames[1::2]), localized(frames[1::2], frames[::2])
    sizes = zip(*(astuple(each.errors) for each in both), strict=True)
    at_reference = PoseErrors(*(np.concatenate(size) for size in sizes))
    if 2 * len(at_reference.position_m) < len(frames):
        return None
    held_out = np.sort(np.concatenate(hold_out_regions(poses, REGIONS, HELD_OUT_SHARE)))
    others = np.setdiff1d(frames, held_out)
    away = localized(others, held_out)
    distances_m = np.array([pose_distance_m(poses[index], poses[others]).min() for index in away.frames])
    bias = fit_bias_model(at_reference, at_reference, away.errors, distances_m, _PRIOR_GROWTH)
    errors = PoseErrors(
        np.concatenate([at_reference.position_m, away.errors.position_m]),
        np.concatenate([at_reference.rotation_rad, away.errors.rotation_rad]),
    )
    all_distances_m = np.concatenate([np.zeros(len(at_reference.position_m)), distances_m])
    return widened(bias, errors, all_distances_m), _evidence([*both, away])


def widened(bias: BiasModel, errors: PoseErrors, distances_m: FloatArray) -> BiasModel:
    """The bias model, wide enough for nine errors of ten.

    A model fitted to medians is too narrow where errors have heavy tails: a flat view has two poses that look alike.

    Args:
        bias: fitted to medians.
        errors: of N poses.
        distances_m: (N,) from each to the nearest reference pose.
    """
    sds = np.stack([bias.sds(distance_m) for distance_m in distances_m])

    def factor(sizes: FloatArray, sd: FloatArray) -> float:
        return max(1.0, float(np.percentile(sizes / sd, 90.0)) / math.sqrt(_CHI2_90_3))

    by_m, by_rad = factor(errors.position_m, sds[:, 0]), factor(errors.rotation_rad, sds[:, 3])
    return bias.model_copy(
        update={
            "sd_at_reference_m": by_m * bias.sd_at_reference_m,
            "sd_growth_m": by_m * bias.sd_growth_m,
            "sd_at_reference_rad": by_rad * bias.sd_at_reference_rad,
            "sd_growth_rad": by_rad * bias.sd_growth_rad,
        }
    )


def _localized(
    localizer: OrbLandmarkLocalizer, corners: list[Corners], poses: FloatArray, of: NDArray[np.int64]
) -> _Localized:
    seen: dict[int, LandmarkPose] = {}
    found, found_wrong = [], []
    for index in of.tolist():
        keypoints = corners[index].keypoints
        measured = localizer.measure_keypoints(keypoints, poses[index], PRIOR_COVARIANCE)
        found.append(measured.found)
        if measured.pose is not None:
            seen[index] = measured.pose
        distances_m = pose_distance_m(poses[index], poses)
        if distances_m.max() >= _WRONG_DISTANCE_M:
            # The nearest of the poses that are far enough away: they see most of the same landmarks.
            other = int(np.argmin(np.where(distances_m >= _WRONG_DISTANCE_M, distances_m, np.inf)))
            measured = localizer.measure_keypoints(keypoints, poses[other], PRIOR_COVARIANCE)
            if measured.pose is None or pose_distance_m(poses[index], measured.pose.pose[None])[0] > FAR_M:
                found_wrong.append(measured.found)
    twists = [se3_log(invert(poses[index]) @ landmark_pose.pose) for index, landmark_pose in seen.items()]
    stated = [np.diag(landmark_pose.covariance) for landmark_pose in seen.values()]
    return _Localized(
        frames=np.array(list(seen), dtype=np.int64),
        errors=_beyond_noise(twist_errors(np.reshape(twists, (-1, 6))), np.reshape(stated, (-1, 6))),
        found=found,
        found_wrong=found_wrong,
        log_focal=np.array([pose.log_focal for pose in seen.values() if pose.log_focal_sd <= WELL_OBSERVED_SD]),
    )


def _evidence(measured: list[_Localized]) -> LandmarkEvidence:
    """From localised frames, those of held-out regions last."""
    right = [found for each in measured for found in each.found]
    wrong = [found for each in measured for found in each.found_wrong]
    if not wrong:
        return LandmarkEvidence()
    log_focal = np.concatenate([each.log_focal for each in measured])
    away = measured[-1].found
    unseen = sum(found < LEAST_LANDMARKS for found in away)
    evidence = LandmarkEvidence(
        found=IntegrityModel.landmark_classes(right, wrong), unseen_share=(unseen + 1.0) / (len(away) + 2.0)
    )
    if len(log_focal) < _LEAST_FOCAL_FRAMES:
        return evidence
    median = float(np.median(log_focal))
    deviation = _NORMAL_MAD * float(np.median(np.abs(log_focal - median)))
    return replace(evidence, focal_mean=median, focal_sd=max(_LEAST_FOCAL_SD, deviation))


def _beyond_noise(errors: PoseErrors, stated: FloatArray) -> PoseErrors:
    """Subtract estimated noise, variances of twists (N, 6), from errors; a third of each error remains."""

    def beyond(errors: FloatArray, variances: FloatArray, least: float) -> FloatArray:
        noise = CHI2_MEDIAN_3 * variances.mean(axis=1)
        return np.asarray(
            np.sqrt(np.maximum.reduce([errors**2 - noise, (errors / 3.0) ** 2, np.full(len(errors), least**2)]))
        )

    return PoseErrors(
        beyond(errors.position_m, stated[:, :3], _LEAST_M), beyond(errors.rotation_rad, stated[:, 3:], _LEAST_RAD)
    )


def landmarks_of(corners: list[Corners], camera: Camera, poses: FloatArray) -> Landmarks:
    """Map the landmarks of frames of one camera: corners that at least two frames saw.

    Args:
        corners: corners of each frame.
        camera: intrinsics of the images in which corners were detected.
        poses: (N, 4, 4) ``T_world_camera`` of the frames.
    """
    seen = _gathered(corners, camera, poses)
    points, is_one_place = _placed(seen, poses)
    chosen = _chosen(seen, is_one_place, len(corners))
    return Landmarks(points[chosen].astype(np.float32), _descriptors(seen, chosen))


@dataclass(frozen=True)
class _Observations:
    """L candidate landmarks, and O corners matched to them.

    Attributes:
        points: (L, 3) initial positions, lifted from one frame, world frame, metres.
        landmark, frame: (O,) landmark and frame index of each corner.
        rays: (O, 2) normalised image coordinates.
        sd: (O, 2) standard deviations of the rays.
        depth_m: (O,) metres, 0 where there is none.
        descriptors: (O, 32).
    """

    points: FloatArray
    landmark: NDArray[np.int64]
    frame: NDArray[np.int64]
    rays: FloatArray
    sd: FloatArray
    depth_m: FloatArray
    descriptors: NDArray[np.uint8]


def _gathered(corners: list[Corners], camera: Camera, poses: FloatArray) -> _Observations:
    """Match corners to known landmarks frame by frame; unmatched corners with depth start new landmarks."""
    points, known = np.zeros((0, 3)), np.zeros((0, 32), np.uint8)
    rows = []
    for index, (each, pose) in enumerate(zip(corners, poses, strict=True)):
        keypoints = each.keypoints
        local = transform(invert(pose), points)
        visible = np.flatnonzero(camera.in_sight(local))
        expected = camera.project(local[visible])
        which, again = match_descriptors(
            expected, known[visible], keypoints.pixels, keypoints.descriptors, _RADIUS_PX
        )
        fresh = np.setdiff1d(np.flatnonzero(each.depth_m > 0.0), again)
        corner = np.concatenate([again, fresh])
        landmark = np.concatenate([visible[which], len(points) + np.arange(len(fresh))])
        rays, sd = keypoints.rays(camera)
        columns = (rays, sd, each.depth_m, keypoints.descriptors)
        rows.append((landmark, np.full(len(corner), index), *(column[corner] for column in columns)))
        lifted = np.column_stack([rays[fresh], np.ones(len(fresh))]) * each.depth_m[fresh, None]
        points = np.concatenate([points, transform(pose, lifted)])
        known = np.concatenate([known, keypoints.descriptors[fresh]])
    return _Observations(points, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def _placed(seen: _Observations, poses: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Robust maximum-likelihood positions of landmarks, (L, 3), and whether half of their corners agree, (L,).

    Gauss-Newton on the rays of a landmark's corners and the logarithm of their depth, with Huber weights.
    """
    T_camera_world = invert(poses)[seen.frame]
    R_camera_world = T_camera_world[:, :3, :3]
    has_depth = seen.depth_m > 0.0
    log_depth = np.log(np.where(has_depth, seen.depth_m, 1.0))
    scale = np.column_stack([1.0 / seen.sd, has_depth / _DEPTH_SD])
    points = seen.points.copy()
    for _ in range(_STEPS):
        local = np.einsum("oij,oj->oi", R_camera_world, points[seen.landmark]) + T_camera_world[:, :3, 3]
        local[:, 2] = np.maximum(local[:, 2], _NEAREST_M)
        z = local[:, 2]
        offset = np.concatenate([local[:, :2] / z[:, None] - seen.rays, (np.log(z) - log_depth)[:, None]], axis=1)
        jacobian = np.zeros((len(z), 3, 3))
        jacobian[:, :2], jacobian[:, 2, 2] = ray_jacobian(local), 1.0 / z
        residuals, jacobian = scale * offset, scale[..., None] * jacobian @ R_camera_world
        weights = np.minimum(1.0, _HUBER / np.maximum(np.abs(residuals), _HUBER))
        normal, gradient = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(normal, seen.landmark, np.einsum("oij,oi,oik->ojk", jacobian, weights, jacobian))
        np.add.at(gradient, seen.landmark, np.einsum("oij,oi->oj", jacobian, weights * residuals))
        points -= np.linalg.solve(normal + _LEAST_INFORMATION * np.eye(3), gradient[..., None])[..., 0]
    agree = np.bincount(seen.landmark, np.linalg.norm(residuals[:, :2], axis=1) < _AGREE_SD, len(points))
    return points, agree >= 0.5 * np.bincount(seen.landmark, minlength=len(points))


def _chosen(seen: _Observations, is_one_place: NDArray[np.bool_], frames: int) -> NDArray[np.int64]:
    """Indices of the landmarks that most frames saw, at least two, until each frame has enough."""
    counts = np.bincount(seen.landmark, minlength=len(is_one_place))
    order = np.argsort(seen.landmark, kind="stable")
    saw = np.split(seen.frame[order], np.cumsum(counts)[:-1])
    candidates = np.flatnonzero(is_one_place & (counts >= 2))
    has = np.zeros(frames, dtype=np.int64)
    chosen = []
    for index in candidates[np.argsort(-counts[candidates], kind="stable")].tolist():
        if np.any(has[saw[index]] < _LANDMARKS_PER_FRAME):
            has[saw[index]] += 1
            chosen.append(index)
    return np.array(sorted(chosen), dtype=np.int64)


def _descriptors(seen: _Observations, chosen: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Descriptors of C landmarks, (C, 32): the bitwise majority of their corners' descriptors."""
    number = np.full(len(seen.points), -1)
    number[chosen] = np.arange(len(chosen))
    row = number[seen.landmark]
    votes = np.zeros((len(chosen), 256), dtype=np.int32)
    bits = np.unpackbits(seen.descriptors[row >= 0], axis=1).astype(np.int8)
    np.add.at(votes, row[row >= 0], 2 * bits - 1)
    return np.packbits(votes >= 0, axis=1)
