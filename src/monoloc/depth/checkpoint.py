"""Networks on disk: safetensors with the settings inside, never pickled."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from monoloc.depth.network import DepthNetwork, NetworkConfig
from monoloc.errors import DataError
from monoloc.files import write_whole


def save_network(network: DepthNetwork, path: Path) -> None:
    """Write weights and settings, whole or not at all."""
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    write_whole(path, save(tensors, metadata={"monoloc_network": network.config.model_dump_json()}))


def load_network(path: Path) -> DepthNetwork:
    """Read a network written by :func:`save_network`, in evaluation mode.

    Raises:
        DataError: not such a file, cut short, or of tensors that its settings do not call for.
    """
    try:
        with safe_open(path, framework="pt") as archive:
            metadata = archive.metadata() or {}
            config = NetworkConfig.model_validate_json(metadata["monoloc_network"])
            network = DepthNetwork(config)
            network.load_state_dict({name: archive.get_tensor(name) for name in archive.keys()})  # noqa: SIM118
    except (OSError, SafetensorError, KeyError, ValidationError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(path, f"is not a monoloc network ({reason})", "give a network.safetensors") from error
    return network.eval()
