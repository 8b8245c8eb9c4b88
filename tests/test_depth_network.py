"""The depth network: its parts, the weights it starts from, and its files."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.flop_counter import FlopCounterMode

from depth_helpers import TINY, tiny_network
from monoloc.camera import Camera
from monoloc.config import describe
from monoloc.depth.spec import image_tensor
from monoloc.depth.training.checkpoint import load_network, save_network
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.mobilenet import Encoder, _conv_bn, _Layers, _SamePadConv, load_encoder_weights
from monoloc.depth.training.network import DepthNetwork, NetworkConfig, _LastLayer
from monoloc.depth.training.quantise import quantise
from monoloc.errors import DataError

pytestmark = pytest.mark.usefixtures("one_thread")

FULL = NetworkConfig()
UNCERTAIN = TINY.model_copy(update={"uncertainty": True})


def random_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def random_input(count: int = 1, height: int = 64, width: int = 64) -> Tensor:
    return torch.rand(count, 3, height, width, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0


@st.composite
def kept_blocks(draw: st.DrawFn) -> tuple[int, ...]:
    """Blocks of every stage, of which the last few stages may have none."""
    stages = draw(st.integers(3, 7))
    return tuple(
        draw(st.integers(1, most)) if stage < stages else 0 for stage, most in enumerate(FULL.encoder_blocks)
    )


# --- Architecture ---


def parameter_names(network: torch.nn.Module) -> set[str]:
    return {name for name in network.state_dict() if not name.endswith("num_batches_tracked")}


def test_encoder_tensors_carry_torchvisions_names_and_shapes() -> None:
    """As ``torchvision.models.mobilenet_v2().state_dict()`` has them at width 1."""
    state = Encoder(1.0, FULL.encoder_blocks).state_dict()
    for name, shape in {
        "features.0.0.weight": (32, 3, 3, 3),
        "features.0.1.running_var": (32,),
        "features.1.conv.0.0.weight": (32, 1, 3, 3),  # no expansion in the first block
        "features.1.conv.1.weight": (16, 32, 1, 1),
        "features.1.conv.2.bias": (16,),
        "features.2.conv.0.0.weight": (96, 16, 1, 1),
        "features.2.conv.1.0.weight": (96, 1, 3, 3),
        "features.2.conv.2.weight": (24, 96, 1, 1),
        "features.2.conv.3.running_mean": (24,),
        "features.7.conv.1.0.weight": (192, 1, 3, 3),
        "features.14.conv.2.weight": (160, 576, 1, 1),
        "features.17.conv.2.weight": (320, 960, 1, 1),
    }.items():
        assert tuple(state[name].shape) == shape, name
    assert "features.18.0.weight" not in state  # the classifier's last layer is not read by the decoder


@pytest.mark.data
def test_encoder_tensors_are_those_of_the_imagenet_weights(weights_file: Path) -> None:
    with np.load(weights_file) as archive:
        given = {name: archive[name] for name in archive.files if not name.startswith("features.18.")}
    network = DepthNetwork(NetworkConfig())
    assert parameter_names(network.encoder) == set(given)
    load_encoder_weights(network, weights_file)
    for name, tensor in network.encoder.state_dict().items():
        if name in given:
            np.testing.assert_array_equal(tensor.numpy(), given[name], err_msg=name)


def same_padded_conv(x: Tensor, weight: Tensor, stride: int, groups: int) -> Tensor:
    """Convolution with TensorFlow's 'same' padding, by its definition: what is odd goes to the far side."""
    padding = []
    for size, kernel in ((x.shape[3], weight.shape[3]), (x.shape[2], weight.shape[2])):
        total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        padding += [total // 2, total - total // 2]
    return F.conv2d(F.pad(x, padding), weight, stride=stride, groups=groups)


def reference_encoder(arrays: dict[str, Tensor], image: Tensor) -> list[Tensor]:
    """MobileNetV2 by its table, from named tensors only; the outputs of blocks 3, 6, 10, 13, 16 and 17."""

    def conv_bn(x: Tensor, conv: str, norm: str, stride: int = 1, relu: bool = True) -> Tensor:
        weight = arrays[f"{conv}.weight"]
        y = same_padded_conv(x, weight, stride, groups=x.shape[1] // weight.shape[1])
        scale = arrays[f"{norm}.weight"] / (arrays[f"{norm}.running_var"] + 1e-3).sqrt()
        shift = arrays[f"{norm}.bias"] - arrays[f"{norm}.running_mean"] * scale
        y = y * scale[:, None, None] + shift[:, None, None]
        return y.clamp(0.0, 6.0) if relu else y

    x = conv_bn(image, "features.0.0", "features.0.1", stride=2)
    taps = []
    for block in range(1, 18):
        stride = 2 if block in (2, 4, 7, 14) else 1
        name, y = f"features.{block}.conv", x
        if block == 1:
            y = conv_bn(y, f"{name}.0.0", f"{name}.0.1")
            y = conv_bn(y, f"{name}.1", f"{name}.2", relu=False)
        else:
            y = conv_bn(y, f"{name}.0.0", f"{name}.0.1")
            y = conv_bn(y, f"{name}.1.0", f"{name}.1.1", stride=stride)
            y = conv_bn(y, f"{name}.2", f"{name}.3", relu=False)
        x = x + y if stride == 1 and x.shape[1] == y.shape[1] else y
        if block in (3, 6, 10, 13, 16, 17):
            taps.append(x)
    return taps


@torch.no_grad()
def assert_encoder_equals_reference(encoder: Encoder, image: Tensor) -> None:
    encoder = encoder.double().eval()
    expected = reference_encoder(dict(encoder.state_dict()), image)
    for ours, theirs, stride in zip(encoder(image), expected, (4, 8, 16, 16, 32, 32), strict=True):
        assert ours.shape[2:] == (image.shape[2] // stride, image.shape[3] // stride)
        torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)


def test_encoder_computes_mobilenet_v2() -> None:
    image = torch.rand(1, 3, 64, 96, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 2.0 - 1.0
    assert_encoder_equals_reference(tiny_network().encoder, image)


@pytest.mark.data
def test_encoder_computes_mobilenet_v2_with_imagenet_weights(weights_file: Path) -> None:
    network = DepthNetwork(NetworkConfig())
    load_encoder_weights(network, weights_file)
    image = torch.from_numpy(image_tensor(random_image(60, 90), Camera(96, 64, 80.0, 80.0, 47.5, 31.5))).double()
    assert_encoder_equals_reference(network.encoder, image)
    # The statistics stored with the weights are those of this input range: activations are neither dead nor cut.
    with torch.no_grad():
        first = network.encoder.features[0](image)
    assert 0.05 < float((first > 0.0).double().mean()) < 0.95
    assert float((first >= 6.0).double().mean()) < 0.2


@pytest.mark.parametrize("size", [(32, 32), (64, 96), (128, 160), (96, 224)])
def test_output_is_a_quarter_of_the_input(size: tuple[int, int]) -> None:
    with torch.no_grad():
        assert tiny_network()(torch.zeros(2, 3, *size)).shape == (2, 1, size[0] // 4, size[1] // 4)


def test_shipped_configuration_has_under_half_a_million_parameters() -> None:
    assert DepthNetwork(NetworkConfig()).parameter_count() == pytest.approx(0.45e6, rel=0.05)


def test_an_untrained_network_sees_two_metres() -> None:
    network = tiny_network()
    network.head.weight.data.zero_()
    with torch.no_grad():
        depth = network(torch.rand(1, 3, 64, 64)).exp()
    torch.testing.assert_close(depth, torch.full_like(depth, 2.0))


def test_every_parameter_gets_a_gradient() -> None:
    network = tiny_network().train()
    network(random_input(2)).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.abs().max() > 0.0), name


# --- The second output ---


@torch.no_grad()
def test_depth_is_the_same_with_and_without_a_stated_error() -> None:
    """The same draws of the same seed, but for the head that is drawn last."""
    plain, uncertain = tiny_network(), tiny_network(config=UNCERTAIN)
    assert set(uncertain.state_dict()) - set(plain.state_dict()) == {"error_head.weight", "error_head.bias"}
    uncertain.load_state_dict(plain.state_dict(), strict=False)
    images = random_input()
    log_depth, log_scale = uncertain.with_error(images)
    torch.testing.assert_close(log_depth, plain(images), rtol=0.0, atol=0.0)
    torch.testing.assert_close(uncertain(images), plain(images), rtol=0.0, atol=0.0)
    assert plain.with_error(images)[1] is None
    # Before it has learnt anything, the error of a fifth is the same everywhere.
    assert log_scale is not None and log_scale.shape == log_depth.shape
    torch.testing.assert_close(log_scale.exp(), torch.full_like(log_scale, 0.2))


def test_the_stated_error_shapes_nothing_but_itself() -> None:
    network = tiny_network(config=UNCERTAIN).train()
    _, log_scale = network.with_error(random_input(2))
    assert log_scale is not None
    log_scale.square().sum().backward()
    moved = {name for name, parameter in network.named_parameters() if parameter.grad is not None}
    assert moved == {"error_head.weight", "error_head.bias"}


# --- Settings ---


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ({"encoder_blocks": (1, 2, 3, 4, 3, 3, 2)}, r"encoder_blocks must lie between 0 and \(1, 2, 3, 4, 3, 3, 1\)"),
        ({"encoder_blocks": (1, 2, 3, 4, 3, -1, 0)}, "encoder_blocks must lie between 0 and"),
        ({"encoder_blocks": (1, 2, 3, 0, 3, 3, 1)}, "may remove whole stages only from the end, and not the first"),
        ({"encoder_blocks": (1, 2, 0, 0, 0, 0, 0)}, "may remove whole stages only from the end, and not the first"),
        ({"pooling_stages": (4, 4, 4, 5)}, "pooling_stages must lie between 0 and 4"),
        ({"pooling_stages": (4, -1, 4, 4)}, "pooling_stages must lie between 0 and 4"),
    ],
)
def test_settings_of_no_network_are_named_in_one_line(setting: dict[str, object], problem: str) -> None:
    with pytest.raises(ValidationError) as caught:
        NetworkConfig.model_validate(setting)
    assert re.search(problem, describe(caught.value)) and "\n" not in describe(caught.value)


@given(kept_blocks(), st.tuples(*[st.integers(0, 4)] * 4))
@settings(max_examples=15)
def test_any_allowed_layers_make_a_network(blocks: tuple[int, ...], pooling: tuple[int, ...]) -> None:
    config = NetworkConfig.model_validate(
        {"width": 0.1, "decoder_channels": 8, "encoder_blocks": blocks, "pooling_stages": pooling}
    )
    network = DepthNetwork(config).eval()
    with torch.no_grad():
        output = network(random_input(1, 32, 64))
    assert output.shape == (1, 1, 8, 16) and bool(torch.isfinite(output).all())
    # What is kept bears the names that it has in the whole of MobileNetV2.
    assert parameter_names(network.encoder) <= parameter_names(Encoder(0.1, FULL.encoder_blocks))


def test_multiply_adds_are_counted_as_torch_counts_them() -> None:
    """Its counter says two operations for each."""
    for config in (TINY, UNCERTAIN):
        network = tiny_network(config=config)
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            network.with_error(torch.zeros(1, 3, 64, 96))
        assert 2 * network.multiply_adds(96, 64) == counter.get_total_flops()


# --- ImageNet weights ---


def encoder_arrays() -> dict[str, NDArray[np.float32]]:
    state = tiny_network().encoder.state_dict()
    return {name: state[name].numpy() for name in state if not name.endswith("num_batches_tracked")}


def test_weights_round_trip_through_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", **encoder_arrays())
    network = DepthNetwork(TINY)
    load_encoder_weights(network, tmp_path / "w.npz")
    for name, array in encoder_arrays().items():
        np.testing.assert_array_equal(network.encoder.state_dict()[name].numpy(), array)


def test_weights_of_another_width_name_the_tensor_and_both_shapes(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", **encoder_arrays())
    with pytest.raises(DataError, match=r"w\.npz: features\.0\.0\.weight has shape \(8, 3, 3, 3\).*\(16, 3, 3, 3\)"):
        load_encoder_weights(DepthNetwork(NetworkConfig(width=0.5)), tmp_path / "w.npz")


def test_weights_that_lack_a_tensor_name_it(tmp_path: Path) -> None:
    arrays = encoder_arrays()
    del arrays["features.5.conv.1.1.running_var"]
    np.savez(tmp_path / "w.npz", **arrays)
    with pytest.raises(DataError, match=r"has no tensor features\.5\.conv\.1\.1\.running_var"):
        load_encoder_weights(DepthNetwork(TINY), tmp_path / "w.npz")


@pytest.mark.parametrize("damage", ["absent", "empty", "text", "cut short", "npy"])
def test_weights_that_are_no_archive(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "w.npz"
    if damage == "empty":
        path.touch()
    elif damage == "text":
        path.write_text("not an archive")
    elif damage == "cut short":
        np.savez(path, **encoder_arrays())
        path.write_bytes(path.read_bytes()[:-500])
    elif damage == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    with pytest.raises(DataError, match=r"w\.npz: is not a readable \.npz archive; give MobileNetV2 weights"):
        load_encoder_weights(DepthNetwork(TINY), path)


# --- Checkpoints ---


@cache
def exported(config: NetworkConfig = TINY) -> bytes:
    return export_onnx(tiny_network(config=config))[0]


def test_checkpoint_round_trip(tmp_path: Path) -> None:
    network = tiny_network()
    save_network(network, tmp_path / "network.safetensors")
    again = load_network(tmp_path / "network.safetensors")
    assert again.config == network.config
    assert not again.training
    assert again.state_dict().keys() == network.state_dict().keys()
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], tensor, rtol=0.0, atol=0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["network.safetensors"]


def test_checkpoint_of_a_channels_last_network_loads(tmp_path: Path) -> None:
    network = tiny_network().to(memory_format=torch.channels_last)
    save_network(network, tmp_path / "network.safetensors")
    image = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        torch.testing.assert_close(load_network(tmp_path / "network.safetensors")(image), network(image))


@pytest.mark.parametrize(
    "damage", ["absent", "empty", "text", "cut short", "no settings", "unknown setting", "other width"]
)
def test_damaged_checkpoint(tmp_path: Path, damage: str) -> None:
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


def test_checkpoint_carries_its_settings_in_the_open(tmp_path: Path) -> None:
    save_network(tiny_network(), tmp_path / "network.safetensors")
    with safe_open(tmp_path / "network.safetensors", framework="np") as archive:
        assert NetworkConfig.model_validate_json(archive.metadata()["monoloc_network"]) == TINY


@pytest.mark.parametrize("suffix", [".safetensors", ".onnx"])
@pytest.mark.parametrize("config", [TINY, UNCERTAIN])
def test_tensors_that_the_settings_do_not_call_for(tmp_path: Path, suffix: str, config: NetworkConfig) -> None:
    """One less, and one more; a file of an older version has the latter."""
    path = tmp_path / f"network{suffix}"
    network = tiny_network(config=config)
    for name, says in (("head.bias", "lacks head.bias"), ("decoder.extra.weight", "has decoder.extra.weight")):
        if suffix == ".onnx":
            model = onnx.load_from_string(exported(config))
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
            save_file(state, path, {"monoloc_network": config.model_dump_json()})
        with pytest.raises(DataError, match=f"{re.escape(says)}, which its settings do not agree with; ") as caught:
            load_network(path)
        assert "\n" not in str(caught.value) and "train it with this version" in str(caught.value)


@pytest.mark.parametrize("config", [TINY, UNCERTAIN])
def test_an_exported_network_loads_with_every_tensor_as_it_was(tmp_path: Path, config: NetworkConfig) -> None:
    network = tiny_network(config=config)
    (tmp_path / "network.onnx").write_bytes(exported(config))
    again = load_network(tmp_path / "network.onnx")
    assert again.config == config
    assert not again.training
    for name, tensor in network.state_dict().items():
        if not name.endswith("num_batches_tracked"):  # says how often it was trained, and changes nothing
            torch.testing.assert_close(again.state_dict()[name], tensor, rtol=0.0, atol=0.0)
    assert export_onnx(again)[0] == exported(config)


@pytest.mark.parametrize("damage", ["absent", "empty", "text", "cut short", "no settings", "folder"])
def test_damaged_export(tmp_path: Path, damage: str) -> None:
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


def test_a_quantised_network_cannot_be_tuned_and_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    images = [rng.uniform(-1.0, 1.0, (1, 3, 32, 32)).astype(np.float32) for _ in range(10)]
    path = tmp_path / "small.onnx"
    path.write_bytes(quantise(exported(), images)[0])
    with pytest.raises(
        DataError, match=r"small\.onnx: lacks .*; give the network as it was before quantis"
    ) as caught:
        load_network(path)
    assert "\n" not in str(caught.value)


def test_strided_convolution_is_the_same_with_and_without_gradients() -> None:
    torch.manual_seed(0)
    conv = _SamePadConv(6, 6, 3, 2, groups=6, bias=False)
    x = torch.randn(2, 6, 8, 12)
    with_gradient = conv(x.requires_grad_(True))
    without = conv(x.detach())
    torch.testing.assert_close(with_gradient, without)
    weight = torch.randn_like(without)
    (with_gradient * weight).sum().backward()
    ours = x.grad
    x.grad = None
    (F.conv2d(F.pad(x, (0, 1, 0, 1)), conv.weight, stride=2, groups=6) * weight).sum().backward()
    torch.testing.assert_close(ours, x.grad)


def test_the_last_layer_is_a_convolution_with_and_without_gradient() -> None:
    torch.manual_seed(0)
    layer = _LastLayer(5).double()
    x = torch.randn(2, 5, 7, 9, dtype=torch.float64, requires_grad=True)
    plain = F.conv2d(x, layer.weight, layer.bias, padding=1)
    with torch.no_grad():
        torch.testing.assert_close(layer(x), plain)
    summed = layer(x)
    torch.testing.assert_close(summed, plain)
    weight = torch.randn_like(plain)
    ours, expected = (torch.autograd.grad((y * weight).sum(), [x, *layer.parameters()]) for y in (summed, plain))
    torch.testing.assert_close(ours, expected)


def test_batch_normalisation_with_kept_statistics_is_folded_without_a_difference() -> None:
    torch.manual_seed(0)
    layers = _Layers(*_conv_bn(4, 6, 3), nn.ReLU6(), *_conv_bn(6, 6, 3, 2, groups=6)).double().eval()
    for norm in layers:
        if isinstance(norm, nn.BatchNorm2d):
            assert norm.running_mean is not None and norm.running_var is not None
            norm.running_mean.uniform_(-1.0, 1.0)
            norm.running_var.uniform_(0.5, 2.0)
            nn.init.uniform_(norm.weight, 0.5, 2.0)
            nn.init.uniform_(norm.bias, -1.0, 1.0)
    x = torch.randn(2, 4, 8, 12, dtype=torch.float64)
    weight = torch.randn(2, 6, 4, 6, dtype=torch.float64)

    def gradients(forward: Callable[[Tensor], Tensor]) -> list[Tensor]:
        layers.zero_grad()
        (forward(x.requires_grad_(True)) * weight).sum().backward()
        return [parameter.grad.clone() for parameter in layers.parameters() if parameter.grad is not None]

    folded, apart = gradients(layers), gradients(lambda given: nn.Sequential.forward(layers, given))
    assert len(folded) == len(list(layers.parameters()))
    for ours, theirs in zip(folded, apart, strict=True):
        torch.testing.assert_close(ours, theirs)
    with torch.no_grad():
        torch.testing.assert_close(layers(x), nn.Sequential.forward(layers, x))
    torch.testing.assert_close(layers(x), nn.Sequential.forward(layers, x))
