"""A trained PoseNet on disk: safetensors with the description as JSON metadata, never pickled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from monoloc.errors import DataError
from monoloc.files import write_whole
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.baselines.posenet import PoseCode, PoseNet, PoseNetConfig
from monoloc_lab.baselines.posenet_training import TrainedPoseNet, Trial

_KEY = "monoloc_posenet"


class _Description(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    network: PoseNetConfig
    T_world_middle: list[list[float]]
    scale_m: float
    error: PoseError
    trials: list[Trial]


def save_posenet(trained: TrainedPoseNet, path: Path) -> None:
    """Write weights and description atomically.

    Raises:
        DataError: the file cannot be written.
    """
    description = _Description(
        network=trained.network.config,
        T_world_middle=trained.code.T_world_middle.tolist(),
        scale_m=trained.code.scale_m,
        error=trained.error,
        trials=trained.trials,
    )
    tensors = {name: tensor.contiguous() for name, tensor in trained.network.state_dict().items()}
    write_whole(path, save(tensors, metadata={_KEY: description.model_dump_json()}))


def load_posenet(path: Path) -> TrainedPoseNet:
    """Read what :func:`save_posenet` wrote.

    Raises:
        DataError: not such a file, truncated, or with tensors that do not fit its settings.
    """
    try:
        with safe_open(path, framework="pt") as archive:
            description = _Description.model_validate_json((archive.metadata() or {})[_KEY])
            network = PoseNet(description.network)
            network.load_state_dict({name: archive.get_tensor(name) for name in archive.keys()})  # noqa: SIM118
    except (OSError, SafetensorError, KeyError, ValidationError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(path, f"is not a PoseNet of monoloc ({reason})", "train it again") from error
    code = PoseCode(np.array(description.T_world_middle), description.scale_m)
    return TrainedPoseNet(network.eval(), code, description.error, description.trials)
