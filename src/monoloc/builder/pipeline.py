"""A build: recording -> check -> cloud -> mixture -> adapt -> calibrate -> landmarks -> bundle.

Each stage is a function that returns its result; :func:`build_bundle` calls them in order.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.bias import KnownBiasCheck, localizer_factory, measure_bias
from monoloc.builder.build_config import BuildConfig, BuildReport
from monoloc.builder.calibrate import calibrate_likelihood
from monoloc.builder.checks import check_frames, check_recording
from monoloc.builder.frame_choice import choose_frames
from monoloc.builder.kept_depth import KeptDepth
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.builder.pose_refinement import PosePrior, refine_poses, rounds
from monoloc.builder.relocalization_error import measure_relocalization_error
from monoloc.builder.room_map import fit_map
from monoloc.builder.samples import depth_samples
from monoloc.builder.scan_evidence import measure_scan_evidence, measure_sensor
from monoloc.builder.start_network import StartNetwork, checked_network, in_8_bits
from monoloc.bundle import Bundle, CloudSize, Provenance, fingerprint
from monoloc.depth.models import DEFAULT
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth
from monoloc.depth.spec import DepthModel, ModelSpec, network_images
from monoloc.errors import DataError
from monoloc.evaluation.trajectory import PoseErrors, pose_errors
from monoloc.extras import training_extra
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, recorded_down, scale_sd_of
from monoloc.io.upright import walk_lies_on_side
from monoloc.likelihood import make_likelihood
from monoloc.map.compare import compare_maps
from monoloc.map.depth_rendering import supervision
from monoloc.map.learnt_transform import LearntTransform
from monoloc.map.mixture import GaussianMixture
from monoloc.progress import NoProgress, Progress
from monoloc.recording_check.image_quality import measure_images
from monoloc.supervision.integrity import IntegrityModel

_USUAL_ABSREL = 0.15  # of depth on held-out frames; the default had 0.09 and 0.11 in two rooms


@dataclass(frozen=True)
class _Room:
    """The mapped room, before adaptation.

    Attributes:
        recording: with refined poses, if they were refined.
        poses: of its frames, (N, 4, 4).
        frames: name and fingerprint of each.
        cloud: (N, 3) world frame, metres.
        refinement: how far refinement moved the poses; None without it.
    """

    recording: Recording
    poses: FloatArray
    frames: dict[str, int]
    cloud: FloatArray
    mixture: GaussianMixture
    refinement: PoseErrors | None
    warnings: list[str]


@dataclass(frozen=True)
class _Adapted:
    """Map and network after adaptation, and what of them was held out.

    Attributes:
        hold_out_model, hold_out_map: of the hold-out run, tuned without the held-out frames, to measure with.
        held_out: those frames, in order; ``regions``: the same, a region each; none where nothing was tuned.
        fitted: the network's specification where its scale was fitted.
        nll, absrel: on held-out frames, before and after; None where nothing was tuned.
        transform: that adapted the map; None if it was not tuned.
    """

    original: GaussianMixture
    adapted: GaussianMixture
    depth_model: DepthModel
    hold_out_model: DepthModel
    hold_out_map: GaussianMixture
    held_out: NDArray[np.int64]
    regions: list[NDArray[np.int64]]
    fitted: ModelSpec | None = None
    nll: tuple[float | None, float | None] = (None, None)
    absrel: tuple[float | None, float | None] = (None, None)
    kl: float = 0.0
    steps: int = 0
    transform: LearntTransform | None = None


def build_bundle(
    recording: Recording,
    config: BuildConfig = BuildConfig(),
    seed: int = 0,
    progress: Progress = NoProgress(),
    cloud: FloatArray | None = None,
    network: str | Path = DEFAULT,
) -> tuple[Bundle, BuildReport]:
    """Map a room, adapt network and map to each other, and measure how far the result can be trusted.

    Args:
        recording: posed frames; with depth, unless ``cloud`` is given.
        cloud: (N, 3) world frame, metres; None makes it from the recording.
        network: as :func:`monoloc.bundle.read_network` takes it; one of another origin, or a bundle's, cannot be
            tuned.

    Raises:
        DataError: no poses, too few frames, neither depth nor a cloud, a recording that contradicts itself or frames
            that cannot give a pose (see :mod:`monoloc.builder.checks`), or an unusable network.
        SettingError: something is to be tuned of a network that cannot be.
        MissingExtraError: something is to be tuned and PyTorch is not installed.
        ValueError: as :func:`monoloc.io.recording.check_arrays`, or the cloud is not (N, 3) and finite.
    """
    started = time.perf_counter()
    start_network = checked_network(recording, config, network)
    chosen = KeptDepth(choose_frames(recording, config.most_frames, progress))
    # Neighbouring frames tell whether poses are right, and chosen ones may have none.
    whole = chosen if len(chosen) == len(recording) else recording
    rng = np.random.default_rng(seed)
    room = _map(chosen, whole, cloud, config, start_network.model, seed, rng, progress)
    adapted = _quantised(_adapt(room, start_network, config, seed, progress), room, config, progress)
    bundle, known_bias = _calibrate(room, adapted, config, seed, rng, progress)
    bundle = _add_landmarks(bundle, room, config, progress)
    seconds = time.perf_counter() - started
    return bundle, _report(bundle, room, adapted, known_bias, config, len(recording), seconds)


def _map(
    recording: Recording,
    whole: Recording,
    cloud: FloatArray | None,
    config: BuildConfig,
    model: DepthModel,
    seed: int,
    rng: np.random.Generator,
    progress: Progress,
) -> _Room:
    """Cloud and mixture, of poses that are refined if that is asked for.

    Args:
        whole: recording that the frames were chosen from.
    """
    frames = {name: fingerprint(recording.color(index)) for index, name in enumerate(recording.frame_names)}
    if len(frames) < len(recording):
        raise DataError(recording.name, "has frames of the same name", "give every frame a name of its own")
    cloud_is_given = cloud is not None
    warnings = check_recording(whole, cloud, config, progress)
    cloud, mixture = fit_map(recording, cloud, config, rng, progress)
    warnings += check_frames(recording, cloud, mixture, cloud_is_given, model, np.random.default_rng(seed))
    refinement = None
    if config.refine_poses:
        recording, refinement = _refined(recording, mixture, cloud_is_given, config, rng, progress)
        if not cloud_is_given:
            cloud, mixture = fit_map(recording, None, config, rng, progress)
    assert recording.poses is not None
    return _Room(recording, recording.poses, frames, cloud, mixture, refinement, warnings)


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


def _adapt(room: _Room, network: StartNetwork, config: BuildConfig, seed: int, progress: Progress) -> _Adapted:
    """Network and map tuned to each other, or the network's scale fitted, as far as it is unknown."""
    if network.file is None:
        return _fitted_to_depth(room, network.model, progress)
    with training_extra():
        from monoloc.adapt.adaptation import adapt  # the only import that needs PyTorch
    result = adapt(room.recording, room.cloud, room.mixture, network.file, config.adapt, seed, progress)
    first, last = result.scores[0], result.scores[-1]
    return _Adapted(
        original=result.original,
        adapted=result.adapted,
        depth_model=result.depth_model,
        hold_out_model=result.hold_out_model,
        hold_out_map=result.hold_out_map,
        held_out=np.sort(np.concatenate(result.held_out)),
        regions=result.held_out,
        nll=(first.nll, last.nll),
        absrel=(first.absrel, last.absrel),
        kl=result.kl,
        steps=result.steps,
        transform=result.transform,
    )


def _fitted_to_depth(room: _Room, model: DepthModel, progress: Progress) -> _Adapted:
    """Nothing tuned: one or two numbers fitted to all frames, of which each frame is as good as held out."""
    fitted = None
    if model.spec.scale is None:
        with progress.task("depth scale", len(room.recording)) as step:
            model = fit_to_depth(model, room.recording, supervision(room.recording, room.cloud), step)
        fitted = model.spec
    everything = np.arange(len(room.recording))
    return _Adapted(room.mixture, room.mixture, model, model, room.mixture, everything, [], fitted)


def _quantised(adapted: _Adapted, room: _Room, config: BuildConfig, progress: Progress) -> _Adapted:
    if not config.int8:
        return adapted
    with progress.task("8 bits", None):
        images = network_images(room.recording, adapted.depth_model.spec)
        model, hold_out = (in_8_bits(each, images) for each in (adapted.depth_model, adapted.hold_out_model))
    return replace(adapted, depth_model=model, hold_out_model=hold_out)


def _calibrate(
    room: _Room, adapted: _Adapted, config: BuildConfig, seed: int, rng: np.random.Generator, progress: Progress
) -> tuple[Bundle, KnownBiasCheck | None]:
    """The bundle without landmarks; its likelihood, thresholds and biases are measured on held-out frames."""
    predictor = DepthPredictor(adapted.hold_out_model, room.recording.camera)
    samples = depth_samples(room.recording, adapted.held_out, predictor, progress)
    settings, thresholds = calibrate_likelihood(
        lambda likelihood: make_likelihood(adapted.hold_out_map, likelihood),
        samples,
        config.uncalibrated,
        rng,
        fits_width=config.adapt.likelihood == "ray",  # a map has one width, in tuning and in flight
    )
    bundle = Bundle(
        original=adapted.original,
        adapted=adapted.adapted,
        depth_model=adapted.depth_model,
        settings=settings,
        camera=room.recording.camera,
        provenance=Provenance(
            recording=room.recording.name,
            frames=room.frames,
            tune=config.adapt.tune,
            map_transform=config.adapt.map_transform,
            lambda_kl=config.adapt.lambda_kl,
            seed=seed,
            down_world=_down_world(room.recording),
            knows_down=recorded_down(room.recording) is not None,
            scale_sd=scale_sd_of(room.recording),
            brightness=measure_images(room.recording).grey_level,
        ),
        thresholds=thresholds,
        reference_poses=ReferencePoses.none(),
        transform=adapted.transform,
        cloud=CloudSize(points=len(room.cloud), voxel_m=config.voxel_m),
    )
    hold_out = replace(bundle, depth_model=adapted.hold_out_model, adapted=adapted.hold_out_map)
    bundle, known_bias = _with_bias(bundle, hold_out, room, adapted.regions, seed, progress)
    settings = bundle.settings
    likelihood = make_likelihood(adapted.hold_out_map, settings.likelihood)
    error_m, error_rad, precision = measure_relocalization_error(
        likelihood, samples, room.poses, settings, rng, progress
    )
    bias = settings.particle_bias.model_copy(
        update={"relocalization_sd_m": error_m, "relocalization_sd_rad": error_rad}
    )
    settings = settings.model_copy(update={"particle_bias": bias})
    scan = measure_scan_evidence(likelihood, samples, room.poses, settings, rng)
    integrity = IntegrityModel(scan=scan, scan_search_precision=precision)
    bundle = replace(bundle, settings=settings, integrity=integrity)
    with progress.task("sensor", None):
        sensor = measure_sensor(bundle, room.recording, rng)
    return replace(bundle, sensor=sensor), known_bias


def _with_bias(
    bundle: Bundle,
    hold_out: Bundle,
    room: _Room,
    regions: list[NDArray[np.int64]],
    seed: int,
    progress: Progress,
) -> tuple[Bundle, KnownBiasCheck | None]:
    """The bundle with its bias model, and with the known bias if that was measured to help."""
    settings = bundle.settings
    if "bias" in settings.without:
        return replace(bundle, reference_poses=ReferencePoses.without_bias(room.poses)), None
    of_final, of_hold_out = localizer_factory(bundle, seed), localizer_factory(hold_out, seed)
    bias, reference_poses, check = measure_bias(of_final, of_hold_out, room.recording, regions, progress)
    without = settings.without
    if "known-bias" not in without and (check is None or not check.helps):
        without = (*without, "known-bias")
    settings = settings.model_copy(update={"particle_bias": bias, "without": without})
    return replace(bundle, settings=settings, reference_poses=reference_poses), check


def _add_landmarks(bundle: Bundle, room: _Room, config: BuildConfig, progress: Progress) -> Bundle:
    if not config.landmarks:
        return bundle
    # A landmark needs depth to begin with, and other frames then tell whether it was right.
    depth_of = supervision(room.recording, room.cloud, is_dense=room.recording.has_depth)
    landmarks, bias, evidence = build_landmarks(room.recording, depth_of, progress)
    settings = bundle.settings.model_copy(update={"landmark_bias": bias})
    integrity = bundle.integrity.model_copy(update=vars(evidence))
    return replace(bundle, settings=settings, landmarks=landmarks, integrity=integrity)


def _report(
    bundle: Bundle,
    room: _Room,
    adapted: _Adapted,
    known_bias: KnownBiasCheck | None,
    config: BuildConfig,
    recorded_frames: int,
    seconds: float,
) -> BuildReport:
    fitted, refinement = adapted.fitted, room.refinement
    return BuildReport(
        frames=len(room.recording),
        recorded_frames=recorded_frames,
        cloud_points=len(room.cloud),
        components=len(room.mixture),
        nll_start=adapted.nll[0],
        nll_end=adapted.nll[1],
        kl=adapted.kl,
        **asdict(compare_maps(adapted.original, adapted.adapted)),
        landmarks=len(bundle.landmarks),
        held_out_frames=len(adapted.held_out),
        depth_absrel_before=adapted.absrel[0],
        depth_absrel_after=adapted.absrel[1],
        depth_scale=fitted.scale if fitted else None,
        depth_shift=fitted.shift if fitted and fitted.has_shift else None,
        steps=adapted.steps,
        known_bias_used="known-bias" not in bundle.settings.without,
        known_bias_check=known_bias,
        pose_shift_median_m=None if refinement is None else float(np.median(refinement.position_m)),
        scale_sd=bundle.provenance.scale_sd,
        pose_turn_median_deg=None if refinement is None else float(np.rad2deg(np.median(refinement.rotation_rad))),
        seconds=seconds,
        warnings=[*room.warnings, *_bundle_warnings(bundle, config, adapted.absrel[1])],
    )


def _cure(config: BuildConfig) -> str:
    """What makes the network's depth better than this build did."""
    if config.adapt.tune == "none":
        return "Tune its network, or build from more of the room"
    return "Record more of the room" if config.adapt.steps is None else "Build without --quick"


def _bundle_warnings(bundle: Bundle, config: BuildConfig, depth_absrel: float | None) -> list[str]:
    warnings = []
    if depth_absrel is not None and depth_absrel > _USUAL_ABSREL:
        problem = f"depth is wrong by {depth_absrel:.0%} on held-out frames; above {_USUAL_ABSREL:.0%},"
        warnings.append(f"{problem} a flight depends on landmarks. {_cure(config)}")
    if bundle.down is None:
        problem = "floor and walls do not show the direction of gravity"
        warnings.append(f"{problem}: poses for an autopilot need down = [x, y, z] in flight.toml")
    if config.landmarks and len(bundle.landmarks) == 0:
        warnings.append("too few corners are seen by several frames: there are no landmarks")
    if not bundle.supports_relocalization:
        share = bundle.integrity.scan_search_precision
        warnings.append(f"a search by one scan is right {share:.0%} of the time, too rarely: flights need a start")
    return warnings


def _down_world(recording: Recording) -> tuple[float, float, float]:
    """Direction of gravity that the recording tells, or the mean direction of the cameras' y axes, a unit vector.

    Zero where these cancel, or where images lie on their side: what they call down would be a wall.
    """
    down = recorded_down(recording)
    if down is None:
        assert recording.poses is not None
        down = np.zeros(3) if walk_lies_on_side(recording) else recording.poses[:, :3, 1].mean(axis=0)
        down = down / (float(np.hypot(np.hypot(down[0], down[1]), down[2])) or 1.0)
    return float(down[0]), float(down[1]), float(down[2])
