"""The depth network: its parts, its files, and the runtime that needs no PyTorch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.nn import functional as F

from depth_helpers import TINY, tiny_network
from monoloc.camera import Camera
from monoloc.depth.checkpoint import load_network, save_network
from monoloc.depth.export import export_onnx
from monoloc.depth.network import DepthNetwork, Encoder, NetworkConfig, load_encoder_weights
from monoloc.depth.runtime import FOCAL_KEY, DepthPredictor, image_tensor, network_size
from monoloc.depth.train import network_input
from monoloc.errors import DataError

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def weights_file(data_root: Path) -> Path:
    path = data_root.parent / "weights" / "mobilenet_v2_0.35_imagenet.npz"
    if not path.is_file():
        pytest.skip(f"no ImageNet weights at {path}")
    return path


def random_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


# --- Architecture ---


def parameter_names(network: torch.nn.Module) -> set[str]:
    return {name for name in network.state_dict() if not name.endswith("num_batches_tracked")}


def test_encoder_tensors_carry_torchvisions_names_and_shapes() -> None:
    """As ``torchvision.models.mobilenet_v2().state_dict()`` has them at width 1."""
    state = Encoder(1.0).state_dict()
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
    image = torch.rand(2, 3, 64, 64, generator=torch.Generator().manual_seed(1)) * 2.0 - 1.0
    network(image).square().sum().backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.abs().max() > 0.0), name


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
    "damage", ["absent", "empty", "text", "cut short", "no settings", "unknown setting", "other width", "one less"]
)
def test_damaged_checkpoint(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "network.safetensors"
    network = tiny_network()
    tensors = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    settings = {"monoloc_network": network.config.model_dump_json()}
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
    elif damage == "one less":
        del tensors["head.bias"]
        save_file(tensors, path, settings)
    with pytest.raises(DataError, match=r"network\.safetensors: is not a monoloc network \(.+\); give a") as caught:
        load_network(path)
    assert "\n" not in str(caught.value)


def test_checkpoint_carries_its_settings_in_the_open(tmp_path: Path) -> None:
    save_network(tiny_network(), tmp_path / "network.safetensors")
    with safe_open(tmp_path / "network.safetensors", framework="np") as archive:
        assert NetworkConfig.model_validate_json(archive.metadata()["monoloc_network"]) == TINY


# --- Export and runtime ---


@pytest.fixture(scope="module")
def exported() -> tuple[DepthNetwork, bytes]:
    network = tiny_network(1)
    return network, export_onnx(network)[0]


def test_export_reports_size_and_parity() -> None:
    content, report = export_onnx(tiny_network())
    assert report.bytes == len(content)
    assert 0.0 <= report.parity_mean <= report.parity_max < 1e-4
    model = onnx.load_from_string(content)
    assert {entry.key: float(entry.value) for entry in model.metadata_props} == {FOCAL_KEY: TINY.focal_px}
    assert [entry.name for entry in model.graph.input] == ["image"]
    assert [entry.name for entry in model.graph.output] == ["log_depth"]


def test_export_leaves_the_network_as_it_was() -> None:
    network = tiny_network()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    export_onnx(network)
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(tensor, before[name], rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(640, 360, 250.0, 250.0, 320.0, 180.0),
        Camera(640, 360, 250.0, 250.0, 320.0, 180.0, (0.05, -0.02, 0.001, 0.0, 0.0)),
        Camera(320, 240, 150.0, 160.0, 150.0, 121.0),
        Camera(33, 47, 60.0, 55.0, 16.0, 23.0),
    ],
)
def test_runtime_equals_the_network(exported: tuple[DepthNetwork, bytes], camera: Camera) -> None:
    """The same image through onnxruntime and PyTorch, at any size: one graph serves all."""
    network, content = exported
    predictor = DepthPredictor(content, camera)
    image = random_image(camera.height, camera.width)
    prediction = predictor(image)
    width, height = network_size(camera, TINY.focal_px)
    small = image_tensor(image, camera.resized(width, height))
    with torch.no_grad():
        log_depth = network(torch.from_numpy(small))[0, 0].double().numpy()
    focal_px = camera.focal_px * np.sqrt(width / camera.width * height / camera.height)
    assert prediction.depth_m.dtype == np.float32
    assert prediction.depth_m.shape == (height // 4, width // 4)
    np.testing.assert_allclose(prediction.depth_m, np.exp(log_depth) * focal_px / TINY.focal_px, rtol=1e-4)
    assert prediction.camera == camera.resized(width, height).resized(width // 4, height // 4)


def test_runtime_and_training_see_the_same_pixels() -> None:
    image = random_image(64, 96)
    ours = image_tensor(image, Camera(96, 64, 80.0, 80.0, 47.5, 31.5))
    np.testing.assert_allclose(ours, network_input([image]).numpy(), atol=1e-6)
    assert ours.min() >= -1.0 and ours.max() <= 1.0
    white = np.zeros((64, 96, 3), dtype=np.uint8)
    white[..., 2] = 255
    channels = image_tensor(white, Camera(96, 64, 80.0, 80.0, 47.5, 31.5))[0, :, 5, 5]
    np.testing.assert_array_equal(channels, [-1.0, -1.0, 1.0])


def stub_network(log_depth: float, focal_px: str | None) -> bytes:
    """An ONNX network that answers a constant, one pixel for 4x4 of the image."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])
    output = helper.make_tensor_value_info("log_depth", TensorProto.FLOAT, [1, 1, "rows", "columns"])
    constants = [
        helper.make_tensor("kernel", TensorProto.FLOAT, [1, 3, 1, 1], [0.0, 0.0, 0.0]),
        helper.make_tensor("bias", TensorProto.FLOAT, [1], [log_depth]),
    ]
    node = helper.make_node("Conv", ["image", "kernel", "bias"], ["log_depth"], strides=[4, 4])
    graph = helper.make_graph([node], "stub", [image], [output], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if focal_px is not None:
        model.metadata_props.add(key=FOCAL_KEY, value=focal_px)
    return bytes(model.SerializeToString())


@pytest.mark.parametrize("focal_px", [90.0, 136.0, 150.0, 290.0])
def test_depth_is_brought_from_the_canonical_focal_length_to_the_cameras(focal_px: float) -> None:
    """A thing that looks as large at twice the focal length is twice as far; the rounding of sizes counts too."""
    camera = Camera(640, 360, 500.0, 510.0, 317.0, 182.0)
    predictor = DepthPredictor(stub_network(np.log(1.7), repr(focal_px)), camera)
    prediction = predictor(random_image(360, 640))
    scale_x, scale_y = predictor.input_camera.width / 640, predictor.input_camera.height / 360
    expected = 1.7 * np.sqrt(500.0 * scale_x * 510.0 * scale_y) / focal_px
    np.testing.assert_allclose(prediction.depth_m, expected, rtol=1e-6)
    assert prediction.depth_m.shape == (prediction.camera.height, prediction.camera.width)
    # The image is as near to the canonical focal length as multiples of 32 allow.
    assert abs(scale_x * camera.focal_px / focal_px - 1.0) * 640 * focal_px / camera.focal_px <= 16.0 + 1e-9


def test_rays_of_the_depth_image_are_the_cameras() -> None:
    """Output pixel (i, j) covers a block of the image, whose middle has the same ray."""
    camera = Camera(640, 360, 500.0, 510.0, 317.0, 182.0, (0.05, -0.02, 0.001, 0.002, 0.0))
    prediction = DepthPredictor(stub_network(0.0, "136.0"), camera)(random_image(360, 640))
    rows, columns = prediction.depth_m.shape
    block = np.array([640 / columns, 360 / rows])
    pixels = np.array([[0.0, 0.0], [columns - 1, 0], [3, 7], [columns - 1, rows - 1]])
    in_image = (pixels + 0.5) * block - 0.5
    np.testing.assert_allclose(prediction.camera.rays(pixels), camera.rays(in_image), atol=1e-9)


def test_network_size_is_never_empty() -> None:
    assert network_size(Camera(640, 480, 5000.0, 5000.0, 320.0, 240.0), 136.0) == (32, 32)


def test_network_without_a_focal_length(tmp_path: Path) -> None:
    path = tmp_path / "depth.onnx"
    path.write_bytes(stub_network(0.0, None))
    with pytest.raises(DataError, match=rf"depth\.onnx: lacks the metadata {FOCAL_KEY}; export it with: monoloc"):
        DepthPredictor(path, Camera(64, 48, 50.0, 50.0, 32.0, 24.0))


@pytest.mark.parametrize("as_bytes", [False, True])
@pytest.mark.parametrize("damage", ["empty", "text", "cut short", "focal length"])
def test_damaged_onnx(tmp_path: Path, damage: str, as_bytes: bool) -> None:
    content = {
        "empty": b"",
        "text": b"not a network",
        "cut short": stub_network(0.0, "136.0")[:-60],
        "focal length": stub_network(0.0, "wide"),
    }[damage]
    path = tmp_path / "depth.onnx"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"depth\.onnx: cannot be loaded \(.*\); export it with") as caught:
        DepthPredictor(content if as_bytes else path, Camera(64, 48, 50.0, 50.0, 32.0, 24.0))
    assert "\n" not in str(caught.value)


def test_absent_onnx(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nothing\.onnx: cannot be loaded"):
        DepthPredictor(tmp_path / "nothing.onnx", Camera(64, 48, 50.0, 50.0, 32.0, 24.0))
