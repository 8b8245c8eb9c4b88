"""How the tasks of other methods are done: PoseNet, filtered PoseNet, keypoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.baselines.keypoints import KeypointConfig, KeypointLocalizer, build_keypoint_map
from monoloc.baselines.pose_filter import PoseError, PoseFilter
from monoloc.baselines.run import Locate, locate_all
from monoloc.bundle import fingerprint, read_bundle
from monoloc.datasets.base import Recording
from monoloc.depth.model import trainable_file
from monoloc.depth.runtime import DepthPredictor
from monoloc.errors import SettingError
from monoloc.experiments.common import BUNDLE, Settings, built_from, relighting, start_of, walked, write_way
from monoloc.experiments.task import Result
from monoloc.extras import training_extra
from monoloc.models import is_shipped, shipped_models
from monoloc.progress import NoProgress

_NETWORK = "posenet.safetensors"


def posenet_search(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc.baselines.posenet_training import search_rate
    search = search_rate(
        built_from(settings), _training(settings), settings["seed"], NoProgress(), _encoder(settings)
    )
    return {
        "learning_rate": search.best.learning_rate,
        "trials": [asdict(trial) for trial in search.trials],
        "error": asdict(search.error),
    }


def posenet(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc.baselines.posenet_file import save_posenet
        from monoloc.baselines.posenet_training import Search, Trial, train_posenet
    found = needs[0].figures
    search = Search([Trial(**trial) for trial in found["trials"]], PoseError(**found["error"]))
    trained = train_posenet(
        built_from(settings), _training(settings), settings["seed"], NoProgress(), _encoder(settings), search
    )
    save_posenet(trained, folder / _NETWORK)
    equal = next(model for model in shipped_models() if model.name == f"{settings['size']}-{settings['width']}")
    return {
        "parameters": trained.network.parameter_count(),
        "bytes": (folder / _NETWORK).stat().st_size,
        "multiply_adds": trained.network.multiply_adds(equal.input_width, equal.input_height),
        "learning_rate": found["learning_rate"],
        "trials": found["trials"],
    }


def posenet_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc.baselines.posenet_file import load_posenet
        from monoloc.baselines.posenet_training import PosePredictor
    recording = walked(settings)
    pose_of = PosePredictor(load_posenet(needs[0].folder / _NETWORK), recording.camera)
    return _located(settings, recording, lambda color, _: pose_of(color), folder)


def filtered_run(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc.baselines.posenet_file import load_posenet
        from monoloc.baselines.posenet_training import PosePredictor
    network, bundle = load_posenet(needs[0].folder / _NETWORK), read_bundle(needs[1].folder / BUNDLE)
    recording = walked(settings)
    rng = np.random.default_rng(settings["seed"])
    config = bundle.settings
    particles = start_of(settings, recording, rng).particles(config, rng)
    depth, measure = DepthPredictor(bundle.depth_model, recording.camera), PosePredictor(network, recording.camera)
    follower = PoseFilter(measure, network.error, depth, recording.camera, particles, config, bundle.viewpoints, rng)
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


def _training(settings: Settings) -> Any:
    """The settings of a PoseNet's training."""
    from monoloc.baselines.posenet_training import PoseNetTraining

    return PoseNetTraining.model_validate(settings["training"])


def _encoder(settings: Settings) -> Path:
    """What the encoder starts from: a file of weights, or the file of a depth network that comes with monoloc."""
    encoder = settings["encoder"]
    file = trainable_file(encoder) if is_shipped(encoder) else Path(encoder)
    if file is None:
        raise SettingError("encoder", f"is {encoder}, which cannot be tuned", "give one in 32 bits")
    return file
