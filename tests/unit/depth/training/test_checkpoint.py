"""Networks as files: safetensors and ONNX in, every tensor back, and what is damaged refused."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from depth_helpers import TINY, UNCERTAIN, tiny_network
from monoloc.depth.models import shipped_file
from monoloc.depth.training.checkpoint import load_network, save_network
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.network import NetworkConfig
from monoloc.errors import DataError

pytestmark = pytest.mark.usefixtures("one_thread")


@cache
def exported() -> bytes:
    return export_onnx(tiny_network(config=UNCERTAIN))[0]


@pytest.mark.slow
def test_safetensors_round_trip(tmp_path: Path) -> None:
    network = tiny_network()
    save_network(network, tmp_path / "network.safetensors")
    again = load_network(tmp_path / "network.safetensors")
    assert again.config == network.config
    assert not again.training
    assert again.state_dict().keys() == network.state_dict().keys()
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], tensor, rtol=0.0, atol=0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["network.safetensors"]


def test_channels_last_network_round_trip(tmp_path: Path) -> None:
    network = tiny_network().to(memory_format=torch.channels_last)
    save_network(network, tmp_path / "network.safetensors")
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        torch.testing.assert_close(load_network(tmp_path / "network.safetensors")(image), network(image))


def test_onnx_round_trip(tmp_path: Path) -> None:
    network = tiny_network(config=UNCERTAIN)
    (tmp_path / "network.onnx").write_bytes(exported())
    again = load_network(tmp_path / "network.onnx")
    assert again.config == UNCERTAIN
    assert not again.training
    for name, tensor in network.state_dict().items():
        if not name.endswith("num_batches_tracked"):  # counts training steps, and has no effect
            torch.testing.assert_close(again.state_dict()[name], tensor, rtol=0.0, atol=0.0)


def test_settings_are_stored_as_metadata(tmp_path: Path) -> None:
    save_network(tiny_network(), tmp_path / "network.safetensors")
    with safe_open(tmp_path / "network.safetensors", framework="np") as archive:
        assert NetworkConfig.model_validate_json(archive.metadata()["monoloc_network"]) == TINY


@pytest.mark.parametrize(
    "damage", ["absent", "empty", "text", "cut short", "no settings", "unknown setting", "other width"]
)
def test_damaged_safetensors_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "network.safetensors"
    network = tiny_network()
    tensors = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    if damage == "empty":
        path.touch()
    elif damage == "text":
        path.write_text("not a network")
    elif damage == "cut short":
        save_network(network, path)
        path.write_bytes(path.read_bytes()[:-10])
    elif damage == "no settings":
        save_file(tensors, path)
    elif damage == "unknown setting":
        save_file(tensors, path, {"monoloc_network": '{"breadth": 1}'})
    elif damage == "other width":
        save_file(tensors, path, {"monoloc_network": NetworkConfig(width=0.5).model_dump_json()})
    with pytest.raises(DataError, match=r"network\.safetensors: is not a monoloc network \(.+\); give a") as caught:
        load_network(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("damage", ["absent", "empty", "text", "cut short", "no settings", "folder"])
def test_damaged_onnx_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "network.onnx"
    content = exported()
    if damage == "empty":
        path.touch()
    elif damage == "text":
        path.write_text("not a network")
    elif damage == "cut short":
        path.write_bytes(content[:-2000])
    elif damage == "no settings":
        model = onnx.load_from_string(content)
        del model.metadata_props[:]
        path.write_bytes(model.SerializeToString())
    elif damage == "folder":
        path.mkdir()
    with pytest.raises(DataError, match=r"network\.onnx: is not a monoloc network \(.+\); give a") as caught:
        load_network(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".safetensors", ".onnx"])
def test_missing_and_surplus_tensors_are_named(tmp_path: Path, suffix: str) -> None:
    """A file of an older version has surplus tensors."""
    path = tmp_path / f"network{suffix}"
    network = tiny_network(config=UNCERTAIN)
    for name, problem in (("head.bias", "lacks head.bias"), ("decoder.extra.weight", "has decoder.extra.weight")):
        if suffix == ".onnx":
            model = onnx.load_from_string(exported())
            tensors = {tensor.name: tensor for tensor in model.graph.initializer}
            if name in tensors:
                model.graph.initializer.remove(tensors[name])
            else:
                model.graph.initializer.append(onnx.numpy_helper.from_array(np.zeros(3, np.float32), name))
            path.write_bytes(model.SerializeToString())
        else:
            state = {key: tensor.clone() for key, tensor in network.state_dict().items()}
            if state.pop(name, None) is None:
                state[name] = torch.zeros(3)
            save_file(state, path, {"monoloc_network": UNCERTAIN.model_dump_json()})
        with pytest.raises(
            DataError, match=f"{re.escape(problem)}, which its settings do not agree with; "
        ) as caught:
            load_network(path)
        assert "\n" not in str(caught.value) and "train it with this version" in str(caught.value)


def test_quantised_network_cannot_be_tuned() -> None:
    with pytest.raises(DataError, match=r"int8\.onnx: lacks .*; give the network as it was before quantis") as caught:
        load_network(shipped_file("tiny-0.35-int8"))
    assert "\n" not in str(caught.value)
