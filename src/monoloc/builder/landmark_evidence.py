"""How far landmark poses are biased, and what the landmarks found in an image say of a belief and of the map."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.bias import fit_bias_model
from monoloc.builder.landmark_triangulation import Corners, landmarks_of
from monoloc.camera import Camera
from monoloc.evaluation.consistency import FAR_M
from monoloc.evaluation.hold_out import HELD_OUT_SHARE, REGIONS, hold_out_regions
from monoloc.evaluation.trajectory import CHI2_MEDIAN_3, PoseErrors, axis_sd, twist_errors
from monoloc.fusion.bias_model import COMMON_ERROR, BiasModel, LandmarkBiasModel
from monoloc.geometry import FloatArray, invert, pose_distance_m, se3_log
from monoloc.landmarks.landmark_map import FAMILIAR_TIMES, Landmarks, LandmarkViews
from monoloc.landmarks.orb_localizer import OrbLandmarkLocalizer
from monoloc.landmarks.pnp import LEAST_LANDMARKS, PRIOR_COVARIANCE, LandmarkPose
from monoloc.robust_statistics import robust_sd
from monoloc.supervision.camera_check import tells_focal
from monoloc.supervision.integrity import WRONG_DISTANCE_M, Classes, IntegrityModel

_LEAST_DISTANCE_M = 0.05
_LEAST_M, _LEAST_RAD = 0.001, 0.0005  # smallest errors, even of a static camera
_CHI2_90_3 = 6.251388631170325  # 90 % quantile of the chi-squared distribution with 3 degrees of freedom
_LEAST_FOCAL_FRAMES, _LEAST_FOCAL_SD = 10, 0.005  # frames that tell a deviation of log-focal, and the smallest
_LEAST_VIEWS = 10  # frames that tell how well nearby frames predict what is found
# Growth of the common error: the most likely one over two real rooms, the factors that are tried and their spread.
_COMMON_ERROR_GROWTH = 1.0
_GROWTH_FACTORS, _GROWTH_LOG_SD = 10.0 ** np.arange(-1.0, 1.1, 0.25), math.log(5.0)
_PRIOR_GROWTH = 0.02  # m/m and rad/m, measured in other rooms


@dataclass(frozen=True)
class LandmarkEvidence:
    """What landmarks say of a belief; the fields are those of :class:`IntegrityModel`."""

    landmarks: Classes = field(default_factory=Classes)
    unseen_share: float = 0.5
    focal_mean: float = 0.0
    focal_sd: float = 1.0
    familiar_found: float = 0.0
    strange_found: float = 0.5


@dataclass(frozen=True)
class _Localized:
    """Frames that are localised by other frames' landmarks.

    Attributes:
        frames: (M,) those that get a pose.
        distances_m: (M,) to the nearest frame whose landmarks localised them.
        twists: (M, 6) errors of these poses.
        poses: their landmark poses.
        found: landmarks found in each frame at its true pose.
        found_wrong: the same at another frame's pose, where there is one far enough away, and the landmarks do not
            lead back to the true pose.
        log_focal: (F,) see :class:`monoloc.landmarks.pnp.LandmarkPose`, of the poses where it is well observed.
    """

    frames: NDArray[np.int64]
    distances_m: FloatArray
    twists: FloatArray
    poses: list[LandmarkPose]
    found: list[int]
    found_wrong: list[int]
    log_focal: FloatArray

    def errors(self, model: LandmarkBiasModel) -> PoseErrors:
        """Errors beyond the noise of the landmark poses."""
        noise = [
            np.diag(model.covariance(pose, float(distance_m)))
            for pose, distance_m in zip(self.poses, self.distances_m, strict=True)
        ]
        return _beyond_noise(twist_errors(self.twists), np.reshape(noise, (-1, 6)))


def measure_landmarks(
    corners: list[Corners], camera: Camera, detected: Camera, poses: FloatArray
) -> tuple[LandmarkBiasModel, LandmarkEvidence] | None:
    """Bias and evidence of what frames see of other frames' landmarks; None if fewer than half get a pose.

    Args:
        corners: corners of each frame.
        camera, detected: intrinsics of the recording, and of the images in which corners were detected.
        poses: (N, 4, 4) ``T_world_camera`` of the frames.
    """

    def localized(by: NDArray[np.int64], of: NDArray[np.int64]) -> _Localized:
        localizer = OrbLandmarkLocalizer(landmarks_of([corners[index] for index in by], detected, poses[by]), camera)
        return _localized(localizer, corners, poses, by, of)

    frames = np.arange(len(corners))
    both = localized(frames[::2], frames[1::2]), localized(frames[1::2], frames[::2])
    if 2 * sum(len(each.frames) for each in both) < len(frames):
        return None
    held_out = np.sort(np.concatenate(hold_out_regions(poses, REGIONS, HELD_OUT_SHARE)))
    away = localized(np.setdiff1d(frames, held_out), held_out)
    growth = fit_common_error_growth(
        np.concatenate([each.twists for each in (*both, away)]),
        [pose for each in (*both, away) for pose in each.poses],
        np.concatenate([each.distances_m for each in (*both, away)]),
        axis_sd(twist_errors(np.concatenate([each.twists for each in both]))),
    )
    noise = LandmarkBiasModel(common_error=COMMON_ERROR, common_error_growth=growth)
    sizes = zip(*(astuple(each.errors(noise)) for each in both), strict=True)
    at_reference, away_errors = PoseErrors(*(np.concatenate(size) for size in sizes)), away.errors(noise)
    bias = fit_bias_model(at_reference, at_reference, away_errors, away.distances_m, _PRIOR_GROWTH)
    bias = widened(bias, at_reference, away_errors, away.distances_m)
    return noise.model_copy(update=bias.model_dump()), _evidence([*both, away])


def fit_common_error_growth(
    twists: FloatArray, poses: list[LandmarkPose], distances_m: FloatArray, floor: tuple[float, float]
) -> float:
    """Growth of the error that landmarks have in common, by its likelihood and a prior from two rooms.

    Args:
        twists: (N, 6) errors of landmark poses.
        poses: the N landmark poses.
        distances_m: (N,) to the nearest reference pose.
        floor: standard deviations an axis of the errors at the reference poses, metres and radians.
    """
    constant = np.diag(np.repeat(floor, 3) ** 2)
    best, best_value = _COMMON_ERROR_GROWTH, -np.inf
    for growth in _COMMON_ERROR_GROWTH * _GROWTH_FACTORS:
        model = LandmarkBiasModel(common_error=COMMON_ERROR, common_error_growth=growth)
        noise = [model.covariance(pose, float(distance)) for pose, distance in zip(poses, distances_m, strict=True)]
        covariances = constant + np.reshape(noise, (-1, 6, 6))
        squared = np.einsum("ni,ni->n", twists, np.linalg.solve(covariances, twists[..., None])[..., 0])
        prior = -0.5 * (math.log(growth / _COMMON_ERROR_GROWTH) / _GROWTH_LOG_SD) ** 2
        value = prior - 0.5 * float(np.sum(squared + np.linalg.slogdet(covariances)[1]))
        if value > best_value:
            best, best_value = float(growth), value
    return best


def widened(bias: BiasModel, at_reference: PoseErrors, away: PoseErrors, distances_m: FloatArray) -> BiasModel:
    """The bias model, wide enough for nine errors of ten, at the reference poses and then away from them.

    A model fitted to medians is too narrow where errors have heavy tails: a flat view has two poses that look alike.

    Args:
        bias: fitted to medians.
        at_reference, away: errors at the reference poses, and of N poses away from them.
        distances_m: (N,) from each of the latter to the nearest reference pose.
    """
    sd_m = max(bias.sd_at_reference_m, _sd_by_quantile(at_reference.position_m))
    sd_rad = max(bias.sd_at_reference_rad, _sd_by_quantile(at_reference.rotation_rad))
    return BiasModel.bounded(
        sd_at_reference_m=sd_m,
        sd_growth_m=max(bias.sd_growth_m, _growth_by_quantile(away.position_m, sd_m, distances_m)),
        sd_at_reference_rad=sd_rad,
        sd_growth_rad=max(bias.sd_growth_rad, _growth_by_quantile(away.rotation_rad, sd_rad, distances_m)),
    )


def _sd_by_quantile(errors: FloatArray) -> float:
    """Standard deviation an axis for which nine of ten errors (N,) are likely."""
    return float(np.percentile(errors, 90.0)) / math.sqrt(_CHI2_90_3)


def _growth_by_quantile(errors: FloatArray, sd_at_reference: float, distances_m: FloatArray) -> float:
    """The same of the growth with distance (N,); 0 without errors."""
    if len(errors) == 0:
        return 0.0
    beyond = np.maximum(errors**2 / _CHI2_90_3 - sd_at_reference**2, 0.0)
    return math.sqrt(float(np.percentile(beyond / np.maximum(distances_m, _LEAST_DISTANCE_M) ** 2, 90.0)))


def measure_views(
    landmarks: Landmarks, corners: list[Corners], camera: Camera, poses: FloatArray
) -> tuple[LandmarkViews, float, float]:
    """Which landmarks frames find at their true poses, and how well nearby frames tell that.

    Args:
        landmarks: of the frames.
        corners: corners of each frame.
        camera: intrinsics of the recording.
        poses: (N, 4, 4) ``T_world_camera`` of the frames.

    Returns:
        The frames as views, and ``familiar_found`` and ``strange_found`` of :class:`IntegrityModel`, of each frame by
        all others; ``familiar_found`` is 0 where too few frames have others nearby.
    """
    localizer = OrbLandmarkLocalizer(landmarks, camera)
    measured = [
        localizer.measure_near(each.keypoints, pose, PRIOR_COVARIANCE)
        for each, pose in zip(corners, poses, strict=True)
    ]
    found = np.zeros((len(poses), len(landmarks)), dtype=np.bool_)
    for row, each in zip(found, measured, strict=True):
        row[each.visible[each.is_found]] = True
    views = LandmarkViews(poses, found)
    familiar, strange = [], []
    for index, each in enumerate(measured):
        times = views.without(index).times_found(poses[index])
        if times is not None:
            familiar.append(each.is_found[times[each.visible] >= FAMILIAR_TIMES])
            strange.append(each.is_found[times[each.visible] == 0])
    if len(familiar) < _LEAST_VIEWS:
        return views, 0.0, 0.5
    # Laplace's rule, so that neither is 0 or 1.
    shares = [(float(np.sum(each)) + 1.0) / (len(each) + 2.0) for each in map(np.concatenate, (familiar, strange))]
    return views, shares[0], shares[1]


def _localized(
    localizer: OrbLandmarkLocalizer,
    corners: list[Corners],
    poses: FloatArray,
    by: NDArray[np.int64],
    of: NDArray[np.int64],
) -> _Localized:
    """Localise some frames by the landmarks of others."""
    seen: dict[int, LandmarkPose] = {}
    found, found_wrong = [], []
    for index in of.tolist():
        keypoints = corners[index].keypoints
        measured = localizer.measure_near(keypoints, poses[index], PRIOR_COVARIANCE)
        found.append(measured.found)
        if measured.pose is not None:
            seen[index] = measured.pose
        distances_m = pose_distance_m(poses[index], poses)
        if distances_m.max() >= WRONG_DISTANCE_M:
            # The nearest of the poses that are far enough away: they see most of the same landmarks.
            other = int(np.argmin(np.where(distances_m >= WRONG_DISTANCE_M, distances_m, np.inf)))
            measured = localizer.measure_near(keypoints, poses[other], PRIOR_COVARIANCE)
            if measured.pose is None or pose_distance_m(poses[index], measured.pose.pose[None])[0] > FAR_M:
                found_wrong.append(measured.found)
    twists = [se3_log(invert(poses[index]) @ landmark_pose.pose) for index, landmark_pose in seen.items()]
    return _Localized(
        frames=np.array(list(seen), dtype=np.int64),
        distances_m=np.array([pose_distance_m(poses[index], poses[by]).min() for index in seen]),
        twists=np.reshape(twists, (-1, 6)),
        poses=list(seen.values()),
        found=found,
        found_wrong=found_wrong,
        log_focal=np.array([pose.log_focal for pose in seen.values() if tells_focal(pose)]),
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
        landmarks=IntegrityModel.landmark_classes(right, wrong), unseen_share=(unseen + 1.0) / (len(away) + 2.0)
    )
    if len(log_focal) < _LEAST_FOCAL_FRAMES:
        return evidence
    focal_sd = max(_LEAST_FOCAL_SD, robust_sd(log_focal))
    return replace(evidence, focal_mean=float(np.median(log_focal)), focal_sd=focal_sd)


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
