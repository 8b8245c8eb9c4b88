"""Consistency checks of recording, network and map before a build's long computations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.builder.build_config import BuildConfig
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.scale_ratio import scale_ratio
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from monoloc.io.recording import Recording, evenly_spaced, scale_sd_of
from monoloc.io.upright import ON_THEIR_SIDE, STAND_UPRIGHT, walk_lies_on_side
from monoloc.likelihood.protocol import LikelihoodConfig, best_over_scales
from monoloc.likelihood.scan import Scan, scan_from_depth
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.map.cloud import voxel_thin
from monoloc.map.depth_rendering import map_depth, supervision
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress, Progress
from monoloc.recording_check.depth_between_frames import CHECK_DEPTH, find_disagreement
from monoloc.recording_check.depth_check import DepthCheck, check_depth
from monoloc.recording_check.explanations import small_delay
from monoloc.recording_check.lens_check import intrinsics_warnings
from monoloc.recording_check.pose_check import REFINE, compare_poses, require_agreement
from monoloc.recording_check.repeated_images import LEAVE_OUT, find_repeats
from monoloc.recording_check.time_stamps import TimeCheck, check_times

_FRAMES, _POINTS = 20, 300  # checked: enough for a mean, within seconds
_LEAST_POINTS = 50  # with fewer, a frame sees nothing of the map

_TURNS = make_pose(so3_exp(np.outer([0.5, 1.0, 1.5], [0.0, np.pi, 0.0])), np.zeros((3, 3)))


@dataclass(frozen=True)
class _PoseCheck:
    """Settings of the pose check for one kind of depth.

    The gain is the log-likelihood of the given poses minus that of the same cameras turned around, nats per point. A
    gain below ``good_gain`` gives a warning, one below ``least_gain`` an error. On RedKitchen the gain was 3.0 with
    sensor depth and 0.9 with the shipped network's depth, untuned. With all poses off by 30 cm and 7 degrees it was
    1.1 and 0.75. In five wrong coordinate frames it was at most 0.07 and 0.23, but the smallest network gave only
    0.12 at correct poses of one segment. So a network's depth can only give a warning, unless the turned cameras fit
    equally well.
    """

    likelihood: LikelihoodConfig
    log_scales: FloatArray
    good_gain: float
    least_gain: float


_SENSOR = _PoseCheck(LikelihoodConfig(kind="volume", noise_sd_m=0.05), np.zeros(1), good_gain=1.2, least_gain=0.25)
_NETWORK = _PoseCheck(
    LikelihoodConfig(kind="volume", noise_sd_m=0.2), np.linspace(-0.6, 0.6, 25), good_gain=0.5, least_gain=0.02
)

# Least shares of the visible surfaces that face the second and the third direction. A wall with 1 % depth noise
# gives up to 0.03 for both; RedKitchen gives 0.37 and 0.19, the corner of a room 0.28 and at least 0.05.
_FLAT, _TWO_DIRECTIONS = 0.05, 0.04

# Median ratio of depth to that of a metric network. The largest and the smallest shipped network gave 0.75 to 1.25 in
# RedKitchen, the desk and the living room; a cloud from structure from motion has any scale.
_LEAST_SCALE, _MOST_SCALE = 0.6, 1.6


@dataclass(frozen=True)
class _PosedScan:
    """A frame's scan, in the camera's frame, and the frame's ``T_world_camera``."""

    scan: Scan
    pose: FloatArray


def check_recording(
    recording: Recording,
    cloud: FloatArray | None,
    config: BuildConfig,
    progress: Progress = NoProgress(),
    if_poor: str | None = None,
) -> list[str]:
    """Check that times, depth, poses and images of a recording agree, and that its scale is plausible.

    Args:
        recording: posed frames; with depth, unless the cloud is given.
        cloud: (N, 3) world frame, metres, if one was supplied.
        config: of the build.
        if_poor: what to do about noisy poses; None advises to refine them, which takes depth, or to check them.

    Returns:
        Warnings, one line each.

    Raises:
        DataError: the recording is consistent only if it is read otherwise, it contradicts itself, or a frame cannot
            be read.
    """
    with progress.task("check", 3) as step:
        warnings = _refused_or_warned(recording.name, check_times(recording))
        thin = None if cloud is None else voxel_thin(cloud, config.voxel_m)
        check, evidence = compare_poses(recording, thin)
        step(1)
        # A wrong focal length or convention also bends planes and shifts edges: poses have the first word.
        advice = if_poor or (REFINE if recording.has_depth else check.fix)
        warnings += require_agreement(recording.name, check, config.refine_poses, advice)
        agreeing = evidence if check.verdict == "agree" else None
        delay = None if agreeing is None or config.refine_poses else small_delay(agreeing)
        warnings += [] if delay is None else [f"{delay[0]}, by the corners; give {delay[1]}"]
        warnings += intrinsics_warnings(agreeing, recording.camera)
        step(2)
        if recording.has_depth:
            warnings += _refused_or_warned(recording.name, check_depth(recording), "otherwise ")
        step(3)
    repeats = find_repeats(recording)
    if repeats is not None:
        warnings.append(f"{repeats}; {LEAVE_OUT}")
    disagreement = None if config.refine_poses else find_disagreement(recording)
    if disagreement is not None:
        warnings.append(f"{disagreement}; {CHECK_DEPTH}")
    if walk_lies_on_side(recording):
        warnings.append(f"{ON_THEIR_SIDE}; {STAND_UPRIGHT}")
    return warnings


def _refused_or_warned(name: str, check: TimeCheck | DepthCheck, before_remedy: str = "") -> list[str]:
    """What a check warns of, at most one line: the problem, then ``before_remedy`` and what to do about it.

    Raises:
        DataError: its problem is certain.
    """
    if check.problem is None:
        return []
    if check.is_certain:
        raise DataError(name, check.problem, check.remedy)
    return [f"{check.problem}; {before_remedy}{check.remedy}"]


def _check_scale(recording: Recording, cloud: FloatArray, model: DepthModel) -> list[str]:
    """Compare the sensor's depth, or else the cloud's, with that of a network of known scale."""
    if model.spec.scale is None:
        return []
    depth_of = recording.depth if recording.has_depth else map_depth(recording, cloud)
    what = "depth" if recording.has_depth else "the cloud"
    predictor = DepthPredictor(model, recording.camera)
    ratios = [
        ratio
        for index in evenly_spaced(len(recording), _FRAMES).tolist()
        if (ratio := scale_ratio(depth_of(index), recording.camera, predictor(recording.color(index)))) is not None
    ]
    if not ratios:
        return []
    scale = float(np.median(ratios))
    if _LEAST_SCALE < scale < _MOST_SCALE:
        return []
    found = f"{what} is {scale:.2f} times as far as the network's"
    if scale_sd_of(recording) is not None:  # its scale was asked for, and a network may err by half
        return [f"{found}, which may be off as much; check the size, distance or depth that --scale named"]
    return [f"{found}; it may be in a scale of its own, not in metres"]


def check_frames(
    recording: Recording,
    cloud: FloatArray,
    mixture: GaussianMixture,
    cloud_is_given: bool,
    model: DepthModel,
    rng: np.random.Generator,
) -> list[str]:
    """Check that frames, map and the network's depth can determine a pose.

    Args:
        recording: posed frames; with depth, unless the cloud is given.
        cloud, mixture: the room's cloud, (N, 3) world frame, metres, and the map fitted to it.
        cloud_is_given: whether the cloud was supplied separately, so that its frame may differ from that of the
            poses.
        model: predicts depth if the recording has none; if its scale is known, the scales are compared.
        rng: draws the scan points.

    Returns:
        Warnings, one line each, about weaknesses that reduce pose accuracy.

    Raises:
        DataError: the frames see nothing of the cloud, their poses are in another frame, they see only one flat
            surface, or a frame cannot be read.
    """
    chosen = evenly_spaced(len(recording), _FRAMES)
    poses = recording.poses
    assert poses is not None
    depth_of = supervision(recording, cloud)
    seen = [_PosedScan(_scan(DepthPrediction(depth_of(int(i)), recording.camera), rng), poses[i]) for i in chosen]
    blind = sum(len(posed.scan) < _LEAST_POINTS for posed in seen)
    if 2 * blind > len(seen):
        what = "the cloud" if cloud_is_given else "the room"
        problem = f"{blind} of {len(seen)} frames looked at see next to nothing of {what}"
        raise DataError(recording.name, problem, "give poses and cloud in one frame, in metres")
    warnings: list[str] = []
    if cloud_is_given and (recording.has_depth or model.spec.scale is not None):  # else it is fitted later
        # Do not use the supervision: where the sensor has no depth it holds the cloud's own depth, which always fits.
        predictor = None if recording.has_depth else DepthPredictor(model, recording.camera)
        posed_scans = []
        for i in chosen.tolist():
            depth = (
                DepthPrediction(recording.depth(i), recording.camera)
                if predictor is None
                else predictor(recording.color(i))
            )
            posed_scans.append(_PosedScan(_scan(depth, rng), poses[i]))
        check = _SENSOR if recording.has_depth else _NETWORK
        warnings = _check_poses(recording.name, posed_scans, mixture, check)
    # At wrong poses, the check of surfaces is meaningless.
    warnings = warnings or _check_surfaces(recording.name, seen, mixture)
    return warnings + _check_scale(recording, cloud, model)


def _scan(depth: DepthPrediction, rng: np.random.Generator) -> Scan:
    return scan_from_depth(depth, _POINTS, rng)


def _check_poses(name: str, posed_scans: list[_PosedScan], mixture: GaussianMixture, check: _PoseCheck) -> list[str]:
    """Check that most poses explain their scans better than the same cameras turned by 90, 180 and 270 degrees."""
    likelihood = VolumeLikelihood(mixture, check.likelihood)

    def log_likelihoods(turn: FloatArray) -> FloatArray:
        """Best mean log-likelihood of each scan over depth scales."""
        return np.array(
            [
                best_over_scales(likelihood, posed.pose @ turn, posed.scan, check.log_scales)[0]
                for posed in posed_scans
                if len(posed.scan)
            ]
        )

    at_pose = log_likelihoods(np.eye(4))
    if len(at_pose) == 0:
        return []
    gain = min(float(np.median(at_pose - log_likelihoods(turn))) for turn in _TURNS)
    finding = f"depth fits the cloud only {gain:.2f} nats a point better at the poses than with cameras turned around"
    if gain < check.least_gain:
        problem = f"poses and cloud are not in one frame ({finding})"
        raise DataError(
            name,
            problem,
            "give T_world_camera, camera axes as in OpenCV, and the cloud in that world",
            page="how-to/check-a-recording",
        )
    return [f"{finding}; poses and cloud may not be in one frame"] if gain < check.good_gain else []


def _check_surfaces(name: str, posed_scans: list[_PosedScan], mixture: GaussianMixture) -> list[str]:
    """Check that surfaces face three directions; along a direction that none faces, a pose can slide unnoticed."""
    shares = [_facing(posed, mixture) for posed in posed_scans if len(posed.scan) >= _LEAST_POINTS]
    (weakest, second, _), axes = np.linalg.eigh(np.mean(shares, axis=0))
    if second < _FLAT:
        problem = f"all frames see one flat surface ({1.0 - weakest - second:.0%} faces one way)"
        fix = "record a trajectory that shows walls, floor and furniture"
        raise DataError(name, problem, fix, page="how-to/record-a-room")
    if weakest < _TWO_DIRECTIONS:
        direction = ", ".join(f"{value:.2f}" for value in axes[:, 0])
        return [f"only {weakest:.0%} of what the frames see faces along ({direction}); poses will slide that way"]
    flat = sum(float(np.linalg.eigvalsh(share)[1]) < _FLAT for share in shares)
    if 2 * flat > len(shares):
        return [f"{flat} of {len(shares)} frames looked at see one flat surface only; poses will slide along it"]
    return []


def _facing(posed: _PosedScan, mixture: GaussianMixture) -> FloatArray:
    """Directions that the visible surfaces face: the mean of ``n n^T`` over the scan's points, (3, 3) with trace one.

    It is the information that point-to-plane distances give about translation. A point's normal is the thinnest axis
    of its most likely component, weighted by the component's flatness.
    """
    points_world = transform(posed.pose, posed.scan.points)
    component = np.argmax(mixture.responsibilities(points_world), axis=1)
    variances, axes = np.linalg.eigh(mixture.covariances)
    flatness = (1.0 - variances[:, 0] / variances[:, 1])[component]
    normals = axes[component, :, 0]
    moments = np.einsum("p,pi,pj->ij", flatness, normals, normals)
    return np.asarray(moments / np.trace(moments))
