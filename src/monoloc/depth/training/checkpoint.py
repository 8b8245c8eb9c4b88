"""Networks on disk, never pickled: safetensors with their settings, or the ONNX file that runs on the drone.

An exported network stores every tensor under its name; batch normalisation is folded only when the runtime loads it.
So one file can be both run and tuned.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import onnx
import torch
from google.protobuf.message import DecodeError
from pydantic import ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.errors import DataError
from monoloc.files import write_whole

NETWORK_KEY = "monoloc_network"


def save_network(network: DepthNetwork, path: Path) -> None:
    """Write weights and settings as safetensors, atomically."""
    tensors = {name: tensor.contiguous() for name, tensor in network.state_dict().items()}
    write_whole(path, save(tensors, metadata={NETWORK_KEY: network.config.model_dump_json()}))


def load_network(path: Path) -> DepthNetwork:
    """Read a network from safetensors (:func:`save_network`) or from an exported ONNX file, in evaluation mode.

    Raises:
        DataError: the file is of another kind, truncated or quantised, or its tensors do not match its settings.
    """
    read = _read_onnx if path.suffix == ".onnx" else _read_safetensors
    try:
        settings, tensors = read(path)
        network = DepthNetwork(NetworkConfig.model_validate_json(settings))
        missing, unexpected = network.load_state_dict(dict(tensors), strict=False)
    except (OSError, SafetensorError, DecodeError, KeyError, ValidationError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise DataError(path, f"is not a monoloc network ({reason})", "give a network.safetensors") from error
    lacking = [name for name in missing if not name.endswith("num_batches_tracked")]  # not used in tuning
    if lacking or unexpected:
        odd = f"lacks {lacking[0]}" if lacking else f"has {unexpected[0]}"
        fix = "give the network as it was before quantisation, or train it with this version"
        raise DataError(path, f"{odd}, which its settings do not agree with", fix)
    return network.eval()


def _read_safetensors(path: Path) -> tuple[str, Mapping[str, torch.Tensor]]:
    with safe_open(path, framework="pt") as archive:
        settings = (archive.metadata() or {})[NETWORK_KEY]
        return settings, {name: archive.get_tensor(name) for name in archive.keys()}  # noqa: SIM118


def _read_onnx(path: Path) -> tuple[str, Mapping[str, torch.Tensor]]:
    model = onnx.load(path)
    settings = {entry.key: entry.value for entry in model.metadata_props}[NETWORK_KEY]
    tensors = {t.name: torch.from_numpy(onnx.numpy_helper.to_array(t).copy()) for t in model.graph.initializer}
    # The graph's constants have other names; the network's tensors start with the name of a submodule.
    parts = ("encoder.", "decoder.", "head.", "error_head.")
    return settings, {name: tensor for name, tensor in tensors.items() if name.startswith(parts)}
