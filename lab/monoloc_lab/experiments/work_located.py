"""How other methods locate a walk: PoseNet, filtered PoseNet, keypoints."""

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
from monoloc_lab.baselines.pose_run import Locate, locate_all
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import BUNDLE, POSENET, Settings, built_from, relighting, walked, write_way
from monoloc_lab.experiments.work_runs import start_of


def posenet_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_file import load_posenet
        from monoloc_lab.baselines.posenet_training import PosePredictor
    recording = walked(settings)
    pose_of = PosePredictor(load_posenet(needs[0].folder / POSENET), recording.camera)
    return _located(settings, recording, lambda color, _: pose_of(color), folder)


def filtered_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_file import load_posenet
        from monoloc_lab.baselines.posenet_training import PosePredictor
    network, bundle = load_posenet(needs[0].folder / POSENET), read_bundle(needs[1].folder / BUNDLE)
    recording = walked(settings)
    rng = np.random.default_rng(settings["seed"])
    config = bundle.settings
    particles = start_of(settings, recording, rng).particles(config, rng)
    depth, measure = DepthPredictor(bundle.depth_model, recording.camera), PosePredictor(network, recording.camera)
    follower = PoseFilter(
        measure, network.error, depth, recording.camera, particles, config, bundle.reference_poses, rng
    )
    return _located(settings, recording, lambda color, elapsed_s: follower.step(color, elapsed_s).pose, folder)


def keypoints_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    config = KeypointConfig.model_validate(settings["config"])
    recording = walked(settings)
    room = build_keypoint_map(built_from(settings), config, NoProgress())
    pose_at = KeypointLocalizer(room, recording.camera, config)
    figures = _located(settings, recording, lambda color, _: pose_at(color), folder)
    return {**figures, "map_bytes": room.bytes}


def _located(settings: Settings, recording: Recording, locate: Locate, folder: Path) -> dict[str, Any]:
    """Locate every frame; figures as those of ``monoloc localize``."""
    build = built_from(settings)
    known = {fingerprint(build.color(index)) for index in range(len(build))}
    unseen = np.array([fingerprint(recording.color(index)) not in known for index in range(len(recording))])
    run = locate_all(recording, locate, NoProgress(), relighting(settings["walk"]["light"], settings["seed"]))
    write_way(folder, recording, run.poses, unseen)
    assert recording.poses is not None
    figures = run.metrics(recording.poses, np.ones(len(recording), dtype=np.bool_))
    if unseen.any():
        figures |= {f"unseen_{name}": value for name, value in run.metrics(recording.poses, unseen).items()}
    return figures
