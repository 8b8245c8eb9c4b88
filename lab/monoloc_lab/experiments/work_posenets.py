"""Training of PoseNets, apart from localisation: a change of the filter does not repeat the training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from monoloc.depth.models import shipped_models
from monoloc.extras import training_extra
from monoloc.progress import NoProgress
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.experiments.task import Result
from monoloc_lab.experiments.task_inputs import POSENET, Settings, build_frames, network_file


def posenet_search(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_training import search_rate
    search = search_rate(
        build_frames(settings), _training(settings), settings["seed"], NoProgress(), network_file(settings["encoder"])
    )
    return {
        "learning_rate": search.best.learning_rate,
        "trials": [asdict(trial) for trial in search.trials],
        "error": asdict(search.error),
    }


def posenet(settings: Settings, needs: Sequence[Result], folder: Path) -> dict[str, Any]:
    with training_extra():
        from monoloc_lab.baselines.posenet_file import save_posenet
        from monoloc_lab.baselines.posenet_training import Search, Trial, train_posenet
    found = needs[0].figures
    search = Search([Trial(**trial) for trial in found["trials"]], PoseError(**found["error"]))
    trained = train_posenet(
        build_frames(settings),
        _training(settings),
        settings["seed"],
        NoProgress(),
        network_file(settings["encoder"]),
        search,
    )
    save_posenet(trained, folder / POSENET)
    equal = next(model for model in shipped_models() if model.name == f"{settings['size']}-{settings['width']}")
    return {
        "parameters": trained.network.parameter_count(),
        "bytes": (folder / POSENET).stat().st_size,
        "multiply_adds": trained.network.multiply_adds(equal.input_width, equal.input_height),
        "learning_rate": found["learning_rate"],
        "trials": found["trials"],
    }


def _training(settings: Settings) -> Any:
    """The training settings of a PoseNet."""
    from monoloc_lab.baselines.posenet_training import PoseNetTraining

    return PoseNetTraining.model_validate(settings["training"])
