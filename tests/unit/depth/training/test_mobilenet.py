"""The encoder: torchvision's names, MobileNetV2's function, folded batch normalisation, and the weights it reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from depth_helpers import TINY, encoder_arrays, parameter_names, random_image, tiny_network
from monoloc.camera import Camera
from monoloc.depth.spec import image_tensor
from monoloc.depth.training.mobilenet import Encoder, _conv_bn, _Layers, _SamePadConv, load_encoder_weights
from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.errors import DataError

pytestmark = pytest.mark.usefixtures("one_thread")

FULL = NetworkConfig()


def test_tensors_have_torchvision_s_names_and_shapes() -> None:
    """As in ``torchvision.models.mobilenet_v2().state_dict()`` at width 1."""
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
    assert "features.18.0.weight" not in state  # the decoder does not read the classifier's last layer


@pytest.mark.data
def test_tensors_are_those_of_the_imagenet_weights(weights_file: Path) -> None:
    with np.load(weights_file) as archive:
        given = {name: archive[name] for name in archive.files if not name.startswith("features.18.")}
    network = DepthNetwork(NetworkConfig())
    assert parameter_names(network.encoder) == set(given)
    load_encoder_weights(network, weights_file)
    for name, tensor in network.encoder.state_dict().items():
        if name in given:
            np.testing.assert_array_equal(tensor.numpy(), given[name], err_msg=name)


def same_padded_conv(x: Tensor, weight: Tensor, stride: int, groups: int) -> Tensor:
    """Convolution with TensorFlow's 'same' padding by its definition: an odd pixel goes to the far side."""
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
    # The stored statistics belong to this input range: activations are neither dead nor clipped.
    with torch.no_grad():
        first = network.encoder.features[0](image)
    assert 0.05 < float((first > 0.0).double().mean()) < 0.95
    assert float((first >= 6.0).double().mean()) < 0.2


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


def test_folded_batch_normalisation_makes_no_difference() -> None:
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

    folded, separate = gradients(layers), gradients(lambda given: nn.Sequential.forward(layers, given))
    assert len(folded) == len(list(layers.parameters()))
    for ours, theirs in zip(folded, separate, strict=True):
        torch.testing.assert_close(ours, theirs)
    with torch.no_grad():
        torch.testing.assert_close(layers(x), nn.Sequential.forward(layers, x))
    torch.testing.assert_close(layers(x), nn.Sequential.forward(layers, x))


def test_weights_round_trip_through_npz(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", **encoder_arrays(tiny_network()))
    network = DepthNetwork(TINY)
    load_encoder_weights(network, tmp_path / "w.npz")
    for name, array in encoder_arrays(tiny_network()).items():
        np.testing.assert_array_equal(network.encoder.state_dict()[name].numpy(), array)


def test_weights_of_another_width_name_the_tensor_and_both_shapes(tmp_path: Path) -> None:
    np.savez(tmp_path / "w.npz", **encoder_arrays(tiny_network()))
    with pytest.raises(DataError, match=r"w\.npz: features\.0\.0\.weight has shape \(8, 3, 3, 3\).*\(16, 3, 3, 3\)"):
        load_encoder_weights(DepthNetwork(NetworkConfig(width=0.5)), tmp_path / "w.npz")


def test_weights_that_lack_a_tensor_name_it(tmp_path: Path) -> None:
    arrays = encoder_arrays(tiny_network())
    del arrays["features.5.conv.1.1.running_var"]
    np.savez(tmp_path / "w.npz", **arrays)
    with pytest.raises(DataError, match=r"has no tensor features\.5\.conv\.1\.1\.running_var"):
        load_encoder_weights(DepthNetwork(TINY), tmp_path / "w.npz")


@pytest.mark.parametrize("damage", ["absent", "empty", "text", "cut short", "npy"])
def test_file_that_is_no_archive_is_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "w.npz"
    if damage == "empty":
        path.touch()
    elif damage == "text":
        path.write_text("not an archive")
    elif damage == "cut short":
        np.savez(path, **encoder_arrays(tiny_network()))
        path.write_bytes(path.read_bytes()[:-500])
    elif damage == "npy":
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
    with pytest.raises(DataError, match=r"w\.npz: is not a readable \.npz archive; give MobileNetV2 weights"):
        load_encoder_weights(DepthNetwork(TINY), path)
