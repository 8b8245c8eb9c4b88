"""The offline way, one page: recording -> cloud -> map -> adapt (or fit) -> calibrate -> landmarks -> bundle."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from monoloc.adapt.settings import AdaptConfig
from monoloc.build.bias import StartsAt, measure_lasting
from monoloc.build.calibrate import Sample, calibrate
from monoloc.build.checks import check_frames
from monoloc.build.landmark_mapping import build_landmarks
from monoloc.build.pose_refinement import PosePrior, check_refinable, refine_poses, rounds
from monoloc.build.relocalization_error import measure_found
from monoloc.bundle import Bundle, Provenance, fingerprint, read_network
from monoloc.depth.model_files import trainable_file
from monoloc.depth.models import DEFAULT
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth
from monoloc.depth.spec import DepthModel, network_images
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.trajectory import PoseErrors, pose_errors
from monoloc.extras import training_extra
from monoloc.fusion.bias_model import LastingErrors
from monoloc.fusion.reference_poses import Viewpoints
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording
from monoloc.landmarks.features import Landmarks
from monoloc.localizer import LocalizerConfig
from monoloc.map.cloud import cloud_from_recording, remove_outliers, voxel_thin
from monoloc.map.compare import compare_maps
from monoloc.map.depth_rendering import supervision
from monoloc.map.em import choose_components, fit_mixture
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress, Progress
from monoloc.run import Start, start_localizer

_COMPONENT_LADDER = (50, 100, 200, 400, 800)
_MIN_FRAMES = 5


class BuildConfig(BaseModel):
    """Settings of a build.

    Attributes:
        components: of the map, or "bic" to choose.
        voxel_m: the cloud is thinned to one point a voxel.
        max_depth_m: farther sensor depth is not used for the map.
        adapt: what is tuned and how.
        refine_poses: whether the frames' poses are aligned with the map first, for poses that another system gave.
        pose_sd_m, pose_sd_deg: how far those are off, per axis.
        landmarks: whether the bundle keeps corners that the frames saw, for what depth alone does not tell.
        int8: whether the network goes into the bundle in 8 bits, calibrated on the frames.
        localizer: settings written into the bundle, before calibration.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    components: Annotated[int, Field(ge=1)] | Literal["bic"] = 200
    voxel_m: float = Field(0.03, gt=0.0)
    max_depth_m: float = Field(4.5, gt=0.0)
    adapt: AdaptConfig = AdaptConfig()
    refine_poses: bool = False
    pose_sd_m: float = Field(0.02, gt=0.0)
    pose_sd_deg: float = Field(1.0, gt=0.0)
    landmarks: bool = True
    int8: bool = False
    localizer: LocalizerConfig = LocalizerConfig()


@dataclass(frozen=True)
class BuildReport:
    """What a build measured; JSON keys of ``monoloc build``.

    nll and AbsRel are of frames held out from tuning, taken away from the others; what the map's components did is
    as in :class:`monoloc.map.compare.MapChange`. Scale and shift of the network's output are None where they were
    not fitted: see :class:`monoloc.depth.spec.ModelSpec`.
    """

    frames: int
    cloud_points: int
    components: int
    nll_start: float | None
    nll_end: float | None
    kl: float
    shift_median_m: float
    shift_p95_m: float
    correspondence_kept: float
    size_ratio_median: float
    landmarks: int
    depth_absrel_before: float | None
    depth_absrel_after: float | None
    depth_scale: float | None
    depth_shift: float | None
    steps: int
    pose_shift_median_m: float | None
    pose_turn_median_deg: float | None
    seconds: float
    warnings: list[str]


def build_bundle(
    recording: Recording,
    config: BuildConfig,
    seed: int,
    progress: Progress,
    cloud: FloatArray | None = None,
    network: str | Path = DEFAULT,
) -> tuple[Bundle, BuildReport]:
    """Map a room, adapt network and map to each other, and measure how far the result can be trusted.

    Args:
        recording: posed frames; with depth, unless ``cloud`` is given.
        cloud: (N, 3) world frame, metres; None makes it from the recording.
        network: as :func:`monoloc.bundle.read_network` takes it; another's, or a bundle's, cannot be tuned.

    Raises:
        DataError: no poses, too few frames, neither depth nor a cloud, frames that cannot give a pose (see
            :func:`monoloc.build.checks.check_frames`), or an unusable network.
        SettingError: something is to be tuned of a network that cannot be.
        MissingExtraError: something is to be tuned and PyTorch is not installed.
    """
    started = time.perf_counter()
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "build from a recording with camera poses")
    if len(recording) < _MIN_FRAMES:
        raise DataError(recording.name, f"gives {len(recording)} frames", f"build from at least {_MIN_FRAMES}")
    if config.refine_poses:
        check_refinable(recording)
    adapts = config.adapt.tune != "none" or config.adapt.map_transform
    if adapts:
        network_file = _tunable(network, config.adapt)
        with training_extra():
            from monoloc.adapt.adaptation import adapt  # the only door to PyTorch
    given = read_network(network)
    if config.int8:
        _check_8_bits(network, recording)
    DepthPredictor(given, recording.camera)  # what does not fit is said before the work
    rng = np.random.default_rng(seed)
    frames = {name: fingerprint(recording.color(index)) for index, name in enumerate(recording.frame_names)}
    if len(frames) < len(recording):
        raise DataError(recording.name, "has frames of the same name", "give every frame a name of its own")
    cloud_is_given = cloud is not None
    cloud, mixture = fit_map(recording, cloud, config, rng, progress)
    warnings = check_frames(recording, cloud, mixture, cloud_is_given, given, np.random.default_rng(seed))
    moved = None
    if config.refine_poses:
        recording, moved = _refined(recording, mixture, cloud_is_given, config, rng, progress)
        if not cloud_is_given:
            cloud, mixture = fit_map(recording, None, config, rng, progress)
    poses = recording.poses
    assert poses is not None
    fitted = None
    if adapts:
        result = adapt(recording, cloud, mixture, network_file, config.adapt, seed, progress)
        original, adapted = result.original, result.adapted
        depth_model, regions = result.depth_model, result.held_out
        held_out_model, held_out_map = result.held_out_model, result.held_out_map
        held_out = np.sort(np.concatenate(regions))
        scores = result.scores
        kl, steps = result.kl, result.steps
    else:
        original = adapted = held_out_map = mixture
        depth_model = given
        if given.spec.scale is None:
            with progress.task("depth scale", len(recording)) as step:
                depth_model = fit_to_depth(given, recording, supervision(recording, cloud), step)
            fitted = depth_model.spec
        held_out_model = depth_model  # one or two numbers for all frames: each is as good as held out
        held_out, regions, scores, kl, steps = np.arange(len(recording)), [], [], 0.0, 0
    if config.int8:
        with progress.task("8 bits", None):
            images = network_images(recording, depth_model.spec)
            depth_model, held_out_model = (_in_8_bits(model, images) for model in (depth_model, held_out_model))
    predictor = DepthPredictor(held_out_model, recording.camera)
    with progress.task("calibrate", len(held_out)) as step:
        samples = []
        for done, index in enumerate(held_out):
            samples.append(Sample(int(index), predictor(recording.color(int(index))), poses[index]))
            step(done + 1)
        settings, healthy = calibrate(held_out_map, samples, config.localizer, rng)
    bundle = Bundle(
        original=original,
        adapted=adapted,
        depth_model=depth_model,
        settings=settings,
        camera=recording.camera,
        provenance=Provenance(
            recording=recording.name,
            frames=frames,
            tune=config.adapt.tune,
            map_transform=config.adapt.map_transform,
            lambda_kl=config.adapt.lambda_kl,
            seed=seed,
            down_world=_down(poses),
        ),
        healthy=healthy,
        viewpoints=Viewpoints.none(),
    )

    rehearsed = replace(bundle, depth_model=held_out_model, adapted=held_out_map)
    is_tuned = steps > 0 and config.adapt.tune != "none"
    lasting, viewpoints = measure_lasting(
        starts_in(bundle, seed), starts_in(rehearsed, seed), recording, regions, is_tuned, progress
    )
    found_m, found_rad = measure_found(held_out_map, samples, poses, settings, rng, progress)
    lasting = lasting.model_copy(update={"found_sd_m": found_m, "found_sd_rad": found_rad})
    landmarks, sighted = Landmarks.none(), LastingErrors()
    if config.landmarks:
        landmarks, sighted = build_landmarks(recording, supervision(recording, cloud), progress)
        if len(landmarks) == 0:
            warnings = [*warnings, "too few corners are seen by several frames: there are no landmarks"]
    settings = settings.model_copy(update={"lasting": lasting, "sighted": sighted})
    bundle = replace(bundle, settings=settings, viewpoints=viewpoints, landmarks=landmarks)
    if not settings.can_find:
        warnings = [*warnings, f"one image tells where a camera is to {found_m:.1f} m only: flights need a start"]
    report = BuildReport(
        frames=len(recording),
        cloud_points=len(cloud),
        components=len(mixture),
        nll_start=scores[0].nll if scores else None,
        nll_end=scores[-1].nll if scores else None,
        kl=kl,
        **asdict(compare_maps(original, adapted)),
        landmarks=len(landmarks),
        depth_absrel_before=scores[0].absrel if scores else None,
        depth_absrel_after=scores[-1].absrel if scores else None,
        depth_scale=fitted.scale if fitted else None,
        depth_shift=fitted.shift if fitted and fitted.has_shift else None,
        steps=steps,
        pose_shift_median_m=None if moved is None else float(np.median(moved.position_m)),
        pose_turn_median_deg=None if moved is None else float(np.rad2deg(np.median(moved.rotation_rad))),
        seconds=time.perf_counter() - started,
        warnings=warnings,
    )
    return bundle, report


def starts_in(bundle: Bundle, seed: int) -> StartsAt:
    """Makes localizers of a bundle, for the camera that built it, to see what they err by.

    None looks for a camera that goes astray, as if there were no viewpoints: how far it goes is to be measured. And
    none sees landmarks, which say nothing of what particles err by.
    """
    room = replace(bundle, viewpoints=Viewpoints.none(), landmarks=Landmarks.none())
    return lambda pose: start_localizer(room, room.camera, Start(pose), np.random.default_rng(seed))


def _refined(
    recording: Recording,
    mixture: GaussianMixture,
    map_is_given: bool,
    config: BuildConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[Recording, PoseErrors]:
    """The recording with poses aligned with the map, and how far they moved."""

    def remap(moved: Recording) -> GaussianMixture:
        return fit_map(moved, None, config, rng, NoProgress())[1]

    prior = PosePrior(config.pose_sd_m, float(np.deg2rad(config.pose_sd_deg)))
    again = None if map_is_given else remap
    with progress.task("refine poses", rounds(again) * len(recording)) as step:
        refined = refine_poses(recording, mixture, again, prior, rng, step)
    assert refined.poses is not None and recording.poses is not None
    return refined, pose_errors(refined.poses, recording.poses)


def _down(poses: FloatArray) -> tuple[float, float, float]:
    """Mean direction of the cameras' y axes, (N, 4, 4) -> a unit vector, or zero where they cancel."""
    x, y, z = poses[:, :3, 1].mean(axis=0)
    length = float(np.hypot(np.hypot(x, y), z)) or 1.0
    return float(x / length), float(y / length), float(z / length)


def _tunable(network: str | Path, config: AdaptConfig) -> Path:
    """The file to tune a network from.

    Raises:
        SettingError: it has none; naming the setting that calls for tuning.
    """
    file = trainable_file(network)
    if file is None:
        setting = "tune" if config.tune != "none" else "map_transform"
        value = config.tune if config.tune != "none" else "on"
        problem = f"is {value}, but {network} can only be run, not tuned"
        fix = "give --tune none --no-map-transform, or a network that came from: monoloc depth train"
        raise SettingError(f"adapt.{setting}", problem, fix)
    return file


def _check_8_bits(network: str | Path, recording: Recording) -> None:
    """Refuse what could not be quantised, before the work is done.

    Raises:
        SettingError, DataError, MissingExtraError: it is not one of ours in 32 bits; too few frames; no ONNX.
    """
    if trainable_file(network) is None:
        raise SettingError("int8", f"is on, but {network} cannot be quantised", "choose one of ours in 32 bits")
    with training_extra():
        from monoloc.depth.training.quantise import LEAST_IMAGES
    if len(recording) < LEAST_IMAGES:
        fix = f"build in 8 bits from at least {LEAST_IMAGES}"
        raise DataError(recording.name, f"gives {len(recording)} frames", fix)


def _in_8_bits(model: DepthModel, images: list[NDArray[np.float32]]) -> DepthModel:
    with training_extra():
        from monoloc.depth.training.quantise import quantise
    return replace(model, content=quantise(model.content, images)[0], name=f"{model.name} in 8 bits")


def fit_map(
    recording: Recording | None,
    cloud: FloatArray | None,
    config: BuildConfig,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[FloatArray, GaussianMixture]:
    """Cloud (N, 3) and mixture of a room, from a cloud where there is one, else from a recording with depth.

    Raises:
        DataError: as :func:`room_cloud`.
        SettingError: more components than points.
    """
    cloud = room_cloud(recording, cloud, config, progress)
    if config.components == "bic":
        with progress.task("map (choosing K)", None):
            return cloud, choose_components(cloud, _COMPONENT_LADDER, rng)[0].mixture
    with progress.task("map", 100) as step:
        return cloud, fit_mixture(cloud, config.components, rng, progress=lambda done, _: step(done)).mixture


def room_cloud(
    recording: Recording | None, cloud: FloatArray | None, config: BuildConfig, progress: Progress
) -> FloatArray:
    """The cloud (N, 3) that a map is fitted to: thinned and without stray points.

    Raises:
        DataError: nothing of the cloud is left when stray points are removed, or as :func:`cloud_from_recording`.
    """
    if cloud is None:
        assert recording is not None
        with progress.task("cloud", len(recording)) as step:
            cloud = cloud_from_recording(
                recording, config.voxel_m, config.max_depth_m, progress=lambda done, _: step(done)
            )
    count = len(cloud)
    cloud = remove_outliers(voxel_thin(cloud, config.voxel_m), config.voxel_m)
    if len(cloud) == 0:
        problem = f"none of {count} points has neighbours within a few voxels"
        raise DataError("cloud", problem, "give a denser one, in metres")
    return cloud
