"""Checks of frames and map together, before the long work begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, make_pose, so3_exp, transform
from monoloc.io.recording import Recording
from monoloc.likelihood.protocol import LikelihoodConfig
from monoloc.likelihood.scan import Scan, scan_from_depth
from monoloc.likelihood.volume import VolumeLikelihood
from monoloc.map.depth_rendering import supervision
from monoloc.map.mixture import GaussianMixture

_FRAMES, _POINTS = 20, 300  # looked at: enough for a mean, and done in seconds
_LEAST_POINTS = 50  # a frame with fewer sees nothing

_TURNS = make_pose(so3_exp(np.outer([0.5, 1.0, 1.5], [0.0, np.pi, 0.0])), np.zeros((3, 3)))


@dataclass(frozen=True)
class _Trust:
    """Errors of one kind of depth, and how much better poses must fit than the same cameras turned round.

    Below ``good_gain`` nats a point poses are doubted, below ``least_gain`` refused. On RedKitchen the gain was 3.0
    with sensor depth and 0.9 with the shipped network's, untuned; with all poses 30 cm and 7 degrees off, 1.1 and
    0.75. With five wrong frames of reference it was at most 0.07 and 0.23, but the smallest network gave only 0.12 at
    right poses of one segment. So a network's depth can raise a doubt, and refuse only what fits as well turned
    round.
    """

    likelihood: LikelihoodConfig
    log_scales: FloatArray
    good_gain: float
    least_gain: float


_SENSOR = _Trust(LikelihoodConfig(kind="volume", noise_sd_m=0.05), np.zeros(1), good_gain=1.2, least_gain=0.25)
_NETWORK = _Trust(
    LikelihoodConfig(kind="volume", noise_sd_m=0.2), np.linspace(-0.6, 0.6, 25), good_gain=0.5, least_gain=0.02
)

# Shares of what is seen that faces the second and the third direction. A wall whose depth has 1 % of noise gives up
# to 0.03 for both; RedKitchen gives 0.37 and 0.19, the corner of a room 0.28 and 0.05 or more.
_FLAT, _TWO_WAYS = 0.05, 0.04


@dataclass(frozen=True)
class _Look:
    """A scan of what a frame sees, in the camera's frame, and the frame's ``T_world_camera``."""

    scan: Scan
    pose: FloatArray


def check_frames(
    recording: Recording,
    cloud: FloatArray,
    mixture: GaussianMixture,
    cloud_is_given: bool,
    model: DepthModel,
    rng: np.random.Generator,
) -> list[str]:
    """Whether frames, map and network's depth can give a pose at all.

    Args:
        recording: posed frames; with depth, unless the cloud is given.
        cloud, mixture: the room, (N, 3) world frame, metres, and the map fitted to it.
        cloud_is_given: whether the cloud came beside the recording and may be in another frame than its poses.
        model: predicts depth where the recording has none.

    Returns:
        Warnings, a line each: what is weak and will make poses poor.

    Raises:
        DataError: the frames see nothing of the cloud, their poses are in another frame, or all that they see is one
            flat surface; or a frame cannot be read.
    """
    chosen = np.unique(np.linspace(0, len(recording) - 1, _FRAMES).round().astype(np.int64))
    poses = recording.poses
    assert poses is not None
    depth_of = supervision(recording, cloud)
    seen = [_Look(_scan(DepthPrediction(depth_of(int(i)), recording.camera), rng), poses[i]) for i in chosen]
    blind = sum(len(look.scan) < _LEAST_POINTS for look in seen)
    if 2 * blind > len(seen):
        what = "the cloud" if cloud_is_given else "the room"
        problem = f"{blind} of {len(seen)} frames looked at see next to nothing of {what}"
        raise DataError(recording.name, problem, "give poses and cloud in one frame, in metres")
    doubts: list[str] = []
    if cloud_is_given and (recording.has_depth or model.spec.is_usable):
        # Not the supervision: where a sensor saw nothing, that is the cloud's own depth, which always fits.
        predictor = None if recording.has_depth else DepthPredictor(model, recording.camera)
        looks = []
        for i in chosen.tolist():
            depth = (
                DepthPrediction(recording.depth(i), recording.camera)
                if predictor is None
                else predictor(recording.color(i))
            )
            looks.append(_Look(_scan(depth, rng), poses[i]))
        trust = _SENSOR if recording.has_depth else _NETWORK
        doubts = _check_poses(recording.name, looks, mixture, trust)
    # Seen from poses that are not right, surfaces say nothing.
    return doubts or _check_surfaces(recording.name, seen, mixture)


def _scan(depth: DepthPrediction, rng: np.random.Generator) -> Scan:
    return scan_from_depth(depth, _POINTS, rng)


def _check_poses(name: str, looks: list[_Look], mixture: GaussianMixture, trust: _Trust) -> list[str]:
    """Most frames' poses must explain their scans better than the same cameras turned by 90, 180 and 270 degrees."""
    likelihood = VolumeLikelihood(mixture, trust.likelihood)

    def fits(turn: FloatArray) -> FloatArray:
        """Best mean log-likelihood of every scan over the depth's scale."""
        return np.array(
            [
                likelihood.mean_log_likelihood(
                    np.repeat((look.pose @ turn)[None], len(trust.log_scales), axis=0), trust.log_scales, look.scan
                ).max()
                for look in looks
                if len(look.scan)
            ]
        )

    at_pose = fits(np.eye(4))
    if len(at_pose) == 0:
        return []
    gain = min(float(np.median(at_pose - fits(turn))) for turn in _TURNS)
    said = f"depth fits the cloud at the poses only {gain:.2f} nats a point better than turned away from there"
    if gain < trust.least_gain:
        problem = f"poses and cloud are not in one frame ({said})"
        raise DataError(name, problem, "give T_world_camera, camera axes as in OpenCV, and the cloud in that world")
    return [f"{said}; poses and cloud may not be in one frame"] if gain < trust.good_gain else []


def _check_surfaces(name: str, looks: list[_Look], mixture: GaussianMixture) -> list[str]:
    """Surfaces must face three ways: along a direction that none faces, a pose can slide unseen."""
    shares = [_facing(look, mixture) for look in looks if len(look.scan) >= _LEAST_POINTS]
    (weakest, second, _), axes = np.linalg.eigh(np.mean(shares, axis=0))
    if second < _FLAT:
        problem = f"all frames see one flat surface ({1.0 - weakest - second:.0%} faces one way)"
        raise DataError(name, problem, "record a walk that shows walls, floor and furniture")
    if weakest < _TWO_WAYS:
        direction = ", ".join(f"{value:.2f}" for value in axes[:, 0])
        return [f"only {weakest:.0%} of what the frames see faces along ({direction}); poses will slide that way"]
    flat = sum(float(np.linalg.eigvalsh(share)[1]) < _FLAT for share in shares)
    if 2 * flat > len(shares):
        return [f"{flat} of {len(shares)} frames looked at see one flat surface only; poses will slide along it"]
    return []


def _facing(look: _Look, mixture: GaussianMixture) -> FloatArray:
    """Which ways the surfaces face that a frame sees: the mean of ``n n^T`` over its points, (3, 3) of trace one.

    This is the information that point-to-plane distances hold on translation. A point's normal is the thinnest axis
    of the component that it most likely belongs to, and counts as much as that component is flat.
    """
    points_world = transform(look.pose, look.scan.points)
    component = np.argmax(mixture.responsibilities(points_world), axis=1)
    variances, axes = np.linalg.eigh(mixture.covariances)
    flatness = (1.0 - variances[:, 0] / variances[:, 1])[component]
    normals = axes[component, :, 0]
    moments = np.einsum("p,pi,pj->ij", flatness, normals, normals)
    return np.asarray(moments / np.trace(moments))
