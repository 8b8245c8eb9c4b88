"""Localisation by the baselines: PoseNet, filtered PoseNet, keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.bundle import fingerprint, read_bundle
from monoloc.depth.predictor import DepthPredictor
from monoloc.extras import training_extra
from monoloc.io.recording import Recording
from monoloc.progress import NoProgress
from monoloc_lab.baselines.keypoints import KeypointConfig, KeypointLocalizer, build_keypoint_map
from monoloc_lab.baselines.pose_filter import PoseFilter
from monoloc_lab.baselines.pose_run import LocalizeFrame, localize_all
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import (
    BUNDLE,
    POSENET,
    Settings,
    build_frames,
    evaluation_frames,
    relighting,
    write_trajectory,
)
from monoloc_lab.experiments.work_runs import start_of


def posenet_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_file import load_posenet
        from monoloc_lab.baselines.posenet_training import PosePredictor
    recording = evaluation_frames(settings)
    pose_of = PosePredictor(load_posenet(needs[0].folder / POSENET), recording.camera)
    return _localize(settings, recording, lambda color, _: pose_of(color), folder)


def filtered_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_file import load_posenet
        from monoloc_lab.baselines.posenet_training import PosePredictor
    network, bundle = load_posenet(needs[0].folder / POSENET), read_bundle(needs[1].folder / BUNDLE)
    recording = evaluation_frames(settings)
    rng = np.random.default_rng(settings["seed"])
    config = bundle.settings
    particles = start_of(settings, recording, rng).particles(config, rng)
    depth, measure = DepthPredictor(bundle.depth_model, recording.camera), PosePredictor(network, recording.camera)
    pose_filter = PoseFilter(
        measure, network.error, depth, recording.camera, particles, config, bundle.reference_poses, rng
    )
    return _localize(settings, recording, lambda color, elapsed_s: pose_filter.step(color, elapsed_s).pose, folder)


def keypoints_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    config = KeypointConfig.model_validate(settings["config"])
    recording = evaluation_frames(settings)
    room = build_keypoint_map(build_frames(settings), config, NoProgress())
    pose_of = KeypointLocalizer(room, recording.camera, config)
    figures = _localize(settings, recording, lambda color, _: pose_of(color), folder)
    return {**figures, "map_bytes": room.bytes}


def _localize(settings: Settings, recording: Recording, method: LocalizeFrame, folder: Path) -> dict[str, Any]:
    """Localise every frame; figures are those of ``monoloc localize``."""
    build = build_frames(settings)
    known = {fingerprint(build.color(index)) for index in range(len(build))}
    unseen = np.array([fingerprint(recording.color(index)) not in known for index in range(len(recording))])
    relight = relighting(settings["evaluation"]["light"], settings["seed"])
    run = localize_all(recording, method, NoProgress(), relight)
    write_trajectory(folder, recording, run.poses, unseen)
    assert recording.poses is not None
    figures = run.metrics(recording.poses, np.ones(len(recording), dtype=np.bool_))
    if unseen.any():
        figures |= {f"unseen_{name}": value for name, value in run.metrics(recording.poses, unseen).items()}
    return figures
