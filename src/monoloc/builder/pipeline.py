"""A build: recording -> check -> cloud -> mixture -> adapt -> calibrate -> landmarks -> bundle.

Each stage is a function that returns its result; :func:`build_bundle` calls them in order.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.adapt.result import AdaptResult
from monoloc.builder.adapted_room import adapt_room
from monoloc.builder.bias import KnownBiasCheck, localizer_factory, measure_bias
from monoloc.builder.build_config import BuildConfig
from monoloc.builder.build_report import BuildReport, make_report
from monoloc.builder.calibrate import calibrate_likelihood
from monoloc.builder.frame_choice import choose_frames
from monoloc.builder.kept_depth import KeptDepth
from monoloc.builder.landmark_mapping import build_landmarks
from monoloc.builder.mapped_room import MappedRoom, map_room
from monoloc.builder.relocalization_error import measure_relocalization_error
from monoloc.builder.samples import depth_samples
from monoloc.builder.scan_evidence import measure_scan_evidence, measure_sensor
from monoloc.builder.start_network import checked_network
from monoloc.bundle import Bundle, CloudSize, Provenance
from monoloc.depth.models import DEFAULT
from monoloc.depth.predictor import DepthPredictor
from monoloc.fusion.reference_poses import ReferencePoses
from monoloc.geometry import FloatArray
from monoloc.io.recording import Recording, recorded_down, require_recording, scale_sd_of
from monoloc.io.upright import walk_lies_on_side
from monoloc.likelihood import make_likelihood
from monoloc.map.depth_rendering import supervision
from monoloc.progress import NoProgress, Progress
from monoloc.recording_check.image_quality import measure_images
from monoloc.supervision.integrity import IntegrityModel


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
        progress: shows the stages, which take minutes, such as :class:`monoloc.progress.ConsoleProgress`.
        network: as :func:`monoloc.bundle.read_network` takes it; one of another origin, or a bundle's, cannot be
            tuned.

    Raises:
        DataError: no poses, too few frames, neither depth nor a cloud, a recording that contradicts itself or frames
            that cannot give a pose (see :mod:`monoloc.builder.checks`), or an unusable network.
        SettingError: something is to be tuned of a network that cannot be.
        MissingExtraError: something is to be tuned and PyTorch is not installed.
        ValueError: as :func:`monoloc.io.recording.check_arrays`, or the cloud is not (N, 3) and finite.
        TypeError: the recording is a path or none, or the settings are a dict.
    """
    require_recording(recording)
    if not isinstance(config, BuildConfig):
        raise TypeError(f"config must be a BuildConfig, got {type(config).__name__}; write BuildConfig(NAME=VALUE)")
    started = time.perf_counter()
    start_network = checked_network(recording, config, network)
    chosen = KeptDepth(choose_frames(recording, config.most_frames, progress))
    # Neighbouring frames tell whether poses are right, and chosen ones may have none.
    whole = chosen if len(chosen) == len(recording) else recording
    rng = np.random.default_rng(seed)
    room = map_room(chosen, whole, cloud, config, start_network.model, seed, rng, progress)
    adapted = adapt_room(room, start_network, config, seed, progress)
    bundle, known_bias = _calibrate(room, adapted, config, seed, rng, progress)
    bundle = _add_landmarks(bundle, room, config, progress)
    seconds = time.perf_counter() - started
    report = make_report(bundle, room, adapted, start_network, known_bias, config, len(recording), seconds)
    return bundle, report


def _calibrate(
    room: MappedRoom,
    adapted: AdaptResult,
    config: BuildConfig,
    seed: int,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[Bundle, KnownBiasCheck | None]:
    """The bundle without landmarks; its likelihood, thresholds and biases are measured on held-out frames."""
    predictor = DepthPredictor(adapted.hold_out_model, room.recording.camera)
    samples = depth_samples(room.recording, adapted.evaluation_frames(len(room.recording)), predictor, progress)
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
    bundle, known_bias = _with_bias(bundle, hold_out, room, adapted.held_out, seed, progress)
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
    room: MappedRoom,
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


def _add_landmarks(bundle: Bundle, room: MappedRoom, config: BuildConfig, progress: Progress) -> Bundle:
    if not config.landmarks:
        return bundle
    # A landmark needs depth to begin with, and other frames then tell whether it was right.
    depth_of = supervision(room.recording, room.cloud, is_dense=room.recording.has_depth)
    landmarks, bias, evidence = build_landmarks(room.recording, depth_of, progress)
    settings = bundle.settings.model_copy(update={"landmark_bias": bias})
    integrity = bundle.integrity.model_copy(update=vars(evidence))
    return replace(bundle, settings=settings, landmarks=landmarks, integrity=integrity)


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
