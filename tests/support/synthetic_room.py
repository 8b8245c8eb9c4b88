"""A textured room of known shape: depth and colour from any pose, recordings, bundles and localizers.

The blue channel of an image is its log-depth, so a network of two operators (:func:`depth_from_blue`) predicts depth
as well as 8 bits allow, and the localizer can be tested without a trained network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import TensorProto, helper, numpy_helper

import synthetic_recordings as synthetic
from monoloc.bundle import Bundle, Provenance, fingerprint
from monoloc.camera import Camera
from monoloc.components import Components, default_components
from monoloc.depth.predictor import DepthPrediction, DepthSource
from monoloc.depth.spec import FOCAL_KEY, DepthModel, monoloc_spec
from monoloc.fusion.bias_model import BiasModel
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import make_pose, so3_exp
from monoloc.landmarks.landmark_map import Landmarks, LandmarkViews
from monoloc.likelihood import make_likelihood
from monoloc.likelihood.protocol import LikelihoodConfig, ScanLikelihood
from monoloc.likelihood.scan import scan_from_depth
from monoloc.likelihood.thresholds import LikelihoodThresholds
from monoloc.localizer import Localizer
from monoloc.localizer_config import LocalizerConfig
from monoloc.map.em import fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.particle_filter.estimate import estimate
from monoloc.particle_filter.particles import Particles
from monoloc.start import Start
from monoloc.step import Step
from monoloc.supervision.integrity import LANDMARK_EDGES, Classes, IntegrityModel

FloatArray = NDArray[np.float64]

# Twice the network's input in both directions: the blue network needs no correction of its focal length.
CAMERA = Camera(320, 256, 272.0, 272.0, 159.5, 127.5)
FOCAL_PX = 136.0
SMALL_CAMERA = CAMERA.resized(160, 128)  # the network's input itself, for tests that write many files
FRAME_RATE_HZ = 15.0
FRAME_S = 1.0 / FRAME_RATE_HZ

_WALLS = np.array([[-2.5, -1.4, -2.0], [2.5, 1.2, 3.0]])
_BOXES = np.array(
    [
        [[-1.8, 0.3, 1.6], [-0.8, 1.2, 2.4]],
        [[0.9, -0.4, 2.2], [1.7, 1.2, 3.0]],
        [[-0.3, 0.7, 1.2], [0.4, 1.2, 1.7]],
        [[1.8, -1.4, 0.2], [2.5, -0.5, 1.4]],
    ]
)
_TEXEL_M = 0.012
NEAREST_M = 0.3  # depth at which blue is 0; it is 255 at 8 m
BLUE_SPAN = float(np.log(8.0 / NEAREST_M))


@cache
def _texture(seed: int) -> NDArray[np.float32]:
    """Gray levels that all surfaces read, with details of several sizes."""
    rng = np.random.default_rng(seed)
    noise = sum(
        cv2.GaussianBlur(rng.standard_normal((1024, 1024)), (0, 0), sigma, borderType=cv2.BORDER_REFLECT) * sigma
        for sigma in (1.5, 4.0, 12.0)
    )
    return np.clip(128.0 + 60.0 * noise / np.std(noise), 10.0, 245.0).astype(np.float32)


@dataclass(frozen=True)
class Room:
    """Four walls, floor, ceiling and four boxes; y points down. The seed determines the texture.

    Attributes:
        stretch: factor on all lengths along x, for a room of another shape.
    """

    seed: int = 0
    stretch: float = 1.0

    @property
    def _walls(self) -> FloatArray:
        return _WALLS * (self.stretch, 1.0, 1.0)

    @property
    def _boxes(self) -> FloatArray:
        return _BOXES * (self.stretch, 1.0, 1.0)

    def view(self, pose: FloatArray, camera: Camera = CAMERA) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Colour (H, W, 3) RGB and exact depth (H, W) seen from ``T_world_camera``."""
        directions = (camera.pixel_rays() @ pose[:3, :3].T).reshape(-1, 3)
        origin = pose[:3, 3]
        depth, face = self._cast(origin, directions)
        points = origin + depth[:, None] * directions
        axis = face % 3
        u, v = (np.take_along_axis(points, (axis[:, None] + shift) % 3, axis=1)[:, 0] for shift in (1, 2))
        # Every face reads another part of the one texture, which repeats at its borders.
        u, v = u / _TEXEL_M + 173.0 * face, v / _TEXEL_M + 311.0 * face
        shape = (camera.height, camera.width)
        gray = cv2.remap(
            _texture(self.seed),
            u.reshape(shape).astype(np.float32),
            v.reshape(shape).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        depth = depth.reshape(shape)
        blue = 255.0 * np.log(depth / NEAREST_M) / BLUE_SPAN
        color = np.stack([gray, gray, np.clip(blue, 0.0, 255.0)], axis=-1)
        return np.round(color).astype(np.uint8), depth.astype(np.float32)

    def cloud(self, spacing_m: float = 0.05) -> FloatArray:
        """Points all over the surfaces, (N, 3); the parts of walls behind boxes are there too."""
        faces = []
        for lower, upper in [self._walls, *self._boxes]:
            for axis in range(3):
                others = [a for a in range(3) if a != axis]
                grid = np.meshgrid(*(np.arange(lower[a], upper[a] + 1e-9, spacing_m) for a in others))
                for side in (lower[axis], upper[axis]):
                    points = np.full((grid[0].size, 3), side)
                    points[:, others[0]], points[:, others[1]] = grid[0].ravel(), grid[1].ravel()
                    faces.append(points)
        return np.concatenate(faces)

    def distance_m(self, points: FloatArray) -> FloatArray:
        """Distance of points inside the room to the nearest surface, (N, 3) -> (N,)."""
        distances = [np.abs(points[:, None, :] - self._walls[None]).min(axis=(1, 2))]
        for lower, upper in self._boxes:
            outside = np.maximum(np.maximum(lower - points, points - upper), 0.0)
            inside = np.minimum(points - lower, upper - points).min(axis=1)
            distances.append(np.where(inside > 0.0, inside, np.linalg.norm(outside, axis=1)))
        return np.min(distances, axis=0)

    def _cast(self, origin: FloatArray, directions: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Distance along each direction to the first surface, and the number of the face that it hits."""
        with np.errstate(divide="ignore"):
            inverse = 1.0 / np.ascontiguousarray(directions.T)  # one row an axis: many times faster than columns
        is_positive = inverse > 0.0
        lower, upper = self._walls
        ends = np.where(is_positive, (upper - origin)[:, None], (lower - origin)[:, None]) * inverse
        axis = ends.argmin(axis=0)
        rays = np.arange(len(directions))
        depth, face = ends[axis, rays], axis + 3 * is_positive[axis, rays]
        for number, (lower, upper) in enumerate(self._boxes, start=1):
            near, far = (lower - origin)[:, None] * inverse, (upper - origin)[:, None] * inverse
            near, far = np.minimum(near, far), np.maximum(near, far)
            entry = np.maximum(np.maximum(near[0], near[1]), near[2])
            end = np.minimum(np.minimum(far[0], far[1]), far[2])
            hit = np.flatnonzero((entry > 0.0) & (entry < end) & (entry < depth))
            axis = near[:, hit].argmax(axis=0)
            depth[hit] = entry[hit]
            face[hit] = 6 * number + axis + 3 * is_positive[axis, hit]
        return depth, face


def make_path(count: int, start_s: float = 0.0, rate_hz: float = FRAME_RATE_HZ) -> FloatArray:
    """Poses of a camera carried through the room at up to half a metre a second, (count, 4, 4)."""
    t = start_s + np.arange(count) / rate_hz
    positions = np.stack([0.6 * np.sin(0.8 * t), 0.1 * np.sin(1.1 * t), 0.4 * np.cos(0.7 * t) - 0.4], axis=1)
    turns = np.stack([0.1 * np.sin(0.9 * t), 0.5 * np.sin(0.6 * t + 0.3), 0.05 * np.sin(1.3 * t)], axis=1)
    return make_pose(so3_exp(turns), positions)


class RoomRecording:
    """A :class:`monoloc.io.recording.Recording` of a room, rendered once."""

    def __init__(self, room: Room, poses: FloatArray, camera: Camera = CAMERA, has_depth: bool = True) -> None:
        self.name = "room"
        self.camera = camera
        self.poses: FloatArray | None = poses
        self.has_depth = has_depth
        self.frame_names = [f"{index:06d}" for index in range(len(poses))]
        self.timestamps_s = np.arange(len(poses)) / FRAME_RATE_HZ
        self._views = [room.view(pose, camera) for pose in poses]

    def __len__(self) -> int:
        return len(self._views)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self._views[index][0]

    def depth(self, index: int) -> NDArray[np.float32]:
        return self._views[index][1]


def sparse_depth(recording: RoomRecording, index: int, stride: int = 4) -> DepthPrediction:
    """Every ``stride``-th pixel of a frame's exact depth, with the camera of those pixels."""
    camera = recording.camera
    depth = np.ascontiguousarray(recording.depth(index)[::stride, ::stride])
    height, width = depth.shape
    small = Camera(width, height, camera.fx / stride, camera.fy / stride, camera.cx / stride, camera.cy / stride)
    return DepthPrediction(depth, small)


@cache
def room_mixture(room: Room, components: int = 250) -> GaussianMixture:
    """The map of a room; fitted once, so nobody may change its arrays."""
    return fit_mixture(room.cloud(), components, np.random.default_rng(0)).mixture


# For exact depth: few outliers, every third point counted as independent, no errors but the map's own grain, and no
# correction of scale and tilt by corners, which are less exact. Enough particles that some start near the truth,
# since exact depth distinguishes millimetres.
SETTINGS = LocalizerConfig(
    particles=600,
    scan_points=300,
    log_scale_sd=0.03,
    scale_tilt=None,
    likelihood=LikelihoodConfig(outlier_share=0.1, noise_sd_m=0.03, log_depth_sd=0.02, effective_points=100.0),
    particle_bias=BiasModel(sd_at_reference_m=0.01, sd_at_reference_rad=0.004),
)


class NoNetwork:
    """For tests that give exact depth: no depth may be predicted."""

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        raise AssertionError("predicted depth although it was measured")


# The image of a camera whose lens is covered, and the depth of a sensor that is covered too.
BLACK = np.zeros((CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
NO_DEPTH = DepthPrediction(np.zeros((64, 80), dtype=np.float32), CAMERA.resized(80, 64))


@dataclass(frozen=True)
class ParticleStart(Start):
    """A start with given particles."""

    given: Particles | None = None

    @classmethod
    def of(cls, particles: Particles) -> ParticleStart:
        return cls(estimate(particles).pose, given=particles)

    def particles(self, config: LocalizerConfig, rng: np.random.Generator) -> Particles:
        assert self.given is not None
        return self.given


def plausible_integrity(thresholds: LikelihoodThresholds, search_precision: float = 0.95) -> IntegrityModel:
    """What a build would measure in the room, of scans by these thresholds and of landmarks.

    Args:
        search_precision: share of right poses among those that a scan finds.
    """
    return IntegrityModel(
        scan=Classes(edges=(thresholds.lost, thresholds.low), right=(0.01, 0.04, 0.95), wrong=(0.8, 0.15, 0.05)),
        landmarks=Classes(
            edges=LANDMARK_EDGES, right=(0.02, 0.02, 0.02, 0.02, 0.92), wrong=(0.9, 0.04, 0.02, 0.02, 0.02)
        ),
        unseen_share=0.2,
        scan_search_precision=search_precision,
        focal_mean=0.01,
        focal_sd=0.01,
    )


def make_localizer(
    mixture: GaussianMixture,
    thresholds: LikelihoodThresholds,
    start: Particles | None,
    reference_poses: FloatArray,
    seed: int | np.random.Generator = 0,
    settings: LocalizerConfig = SETTINGS,
    depth: DepthSource = NoNetwork(),
    down: FloatArray | None = None,
    bias: ArrayLike = 0.0,
    landmarks: Landmarks = Landmarks.none(),
    likelihood: ScanLikelihood | None = None,
    integrity: IntegrityModel | None = None,
    camera: Camera = CAMERA,
) -> Localizer:
    """A localizer for a camera in a room with this map.

    Args:
        start: particles before the first frame; None where the room is to be searched.
        depth: predicts the depth of frames that are given without.
        down: direction of gravity in the room; None where it is unknown.
        bias: known at the reference poses, in both directions of flight, a twist (V, 6) or (6,).
        likelihood: in place of the bundle's.
        integrity: :func:`plausible_integrity` where none is given.
        camera: the stated one.
    """
    both = np.broadcast_to(bias, (len(reference_poses), 6))
    bundle = Bundle(
        original=mixture,
        adapted=mixture,
        depth_model=depth_from_blue(),
        settings=settings,
        camera=CAMERA,
        provenance=Provenance(recording="room", frames={}, tune="none", map_transform=False, lambda_kl=0.1, seed=0),
        thresholds=thresholds,
        reference_poses=ReferencePoses(reference_poses, both, both),
        landmarks=landmarks,
        integrity=integrity or plausible_integrity(thresholds),
    )
    bundle.__dict__["down"] = down  # of a cached property

    def components(bundle: Bundle, camera: Camera, config: LocalizerConfig) -> Components:
        made = default_components(bundle, camera, config)
        return replace(made, depth=depth, likelihood=likelihood or made.likelihood)

    given = None if start is None else ParticleStart.of(start)
    return Localizer(bundle, camera, given, settings, components, seed)


def follow(localizer: Localizer, recording: RoomRecording, frames: range | None = None) -> list[Step]:
    """Steps over some frames of a recording, or all, with their exact depth."""
    frames = range(len(recording)) if frames is None else frames
    return [localizer.step(recording.color(index), FRAME_S, sparse_depth(recording, index)) for index in frames]


def poses_of(steps: list[Step]) -> FloatArray:
    """Estimated poses, (N, 4, 4)."""
    return np.stack([step.estimate.pose for step in steps])


def measured_thresholds(mixture: GaussianMixture, recording: RoomRecording) -> LikelihoodThresholds:
    """Measured on a recording's exact depth at its true poses, and lowered for estimated poses."""
    likelihood, rng = make_likelihood(mixture, SETTINGS.likelihood), np.random.default_rng(0)
    assert recording.poses is not None
    values = []
    for index, pose in enumerate(recording.poses):
        depth = sparse_depth(recording, index)
        scan = scan_from_depth(depth, SETTINGS.scan_points, rng)
        values.append(likelihood.mean_log_likelihood(pose[None], np.zeros(1), scan)[0])
    measured = LikelihoodThresholds.from_log_likelihoods(np.array(values))
    return LikelihoodThresholds(low=measured.low - 0.1, lost=measured.lost - 0.2)


def depth_from_blue() -> DepthModel:
    """An ONNX network with monoloc's inputs and outputs that reads log-depth out of the blue channel."""
    weight = np.array([0.0, 0.0, 0.5 * BLUE_SPAN], dtype=np.float32).reshape(1, 3, 1, 1)
    bias = np.array([np.log(NEAREST_M) + 0.5 * BLUE_SPAN], dtype=np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[4, 4], strides=[4, 4]),
            helper.make_node("Conv", ["pooled", "weight", "bias"], ["log_depth"], kernel_shape=[1, 1]),
        ],
        "depth_from_blue",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])],
        [helper.make_tensor_value_info("log_depth", TensorProto.FLOAT, [1, 1, "rows", "columns"])],
        [numpy_helper.from_array(weight, "weight"), numpy_helper.from_array(bias, "bias")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    model.metadata_props.add(key=FOCAL_KEY, value=repr(FOCAL_PX))
    onnx.checker.check_model(model)
    return DepthModel(model.SerializeToString(), monoloc_spec(FOCAL_PX), "blue")


def make_bundle(mixture: GaussianMixture, recording: RoomRecording, built_from: range = range(0)) -> Bundle:
    """A bundle of the room, as if built from some frames of a recording, with the blue network in it."""
    frames = {recording.frame_names[index]: fingerprint(recording.color(index)) for index in built_from}
    thresholds = measured_thresholds(mixture, recording)
    return Bundle(
        original=mixture,
        adapted=mixture,
        depth_model=depth_from_blue(),
        settings=SETTINGS,
        camera=recording.camera,
        provenance=Provenance(
            recording=recording.name, frames=frames, tune="none", map_transform=False, lambda_kl=0.1, seed=0
        ),
        thresholds=thresholds,
        reference_poses=ReferencePoses.without_bias(recording.poses[list(built_from)]),
        integrity=plausible_integrity(thresholds),
    )


def bundle_with_landmarks_ahead() -> Bundle:
    """A bundle of the room with 300 landmarks 2 m before the build's twelve cameras, which all of them found."""
    recording = RoomRecording(Room(), make_path(12, rate_hz=2.0), SMALL_CAMERA)
    bundle = make_bundle(room_mixture(Room(), 120), recording, range(12))
    poses = bundle.reference_poses.poses
    ahead = poses[:, :3, 3].mean(axis=0) + 2.0 * poses[:, :3, 2].mean(axis=0)
    points = (ahead + np.random.default_rng(0).uniform(-0.5, 0.5, (300, 3))).astype(np.float32)
    views = LandmarkViews(poses, np.ones((12, 300), np.bool_))
    return replace(bundle, landmarks=Landmarks(points, np.zeros((300, 32), np.uint8), views))


def room_bundle(components: int, frames: int = 2) -> Bundle:
    """A bundle of the room with a map of so many components, in which no frame is known."""
    return make_bundle(room_mixture(Room(), components), RoomRecording(Room(), make_path(frames), SMALL_CAMERA))


def write_recording(folder: Path, recording: RoomRecording) -> None:
    """The recording as a ``folder`` recording on disk: PNG colour, 16-bit millimetres, TUM poses."""
    camera = recording.camera
    for index, name in enumerate(recording.frame_names):
        synthetic.write_color(folder / "color" / f"{name}.png", recording.color(index))
        stored = np.round(1000.0 * recording.depth(index)).astype(np.uint16)
        synthetic.write_depth(folder / "depth" / f"{name}.png", stored)
    assert recording.poses is not None
    (folder / "poses.txt").write_text(synthetic.tum_lines(recording.timestamps_s, recording.poses))
    (folder / "dataset.toml").write_text(
        f"""\
kind = "sequence"
color = "color/{{index:06d}}.png"
depth = "depth/{{index:06d}}.png"
count = {len(recording)}
width = {camera.width}
height = {camera.height}
fx = {camera.fx}
fy = {camera.fy}
cx = {camera.cx}
cy = {camera.cy}
depth_scale = 1000
poses = "poses.txt"
"""
    )
