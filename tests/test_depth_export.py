"""Exported networks: the same depth through onnxruntime, another last layer, and 8 bits."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper
from torch import Tensor

from depth_helpers import TINY, exported_model, tiny_network
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import FOCAL_KEY, DepthModel, image_tensor, monoloc_spec, network_size
from monoloc.depth.training.checkpoint import NETWORK_KEY
from monoloc.depth.training.examples import network_input
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.last_layer import read_last_layer, replace_last_layer
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.quantise import quantise
from monoloc.errors import DataError, MonolocError, SettingError

Image = NDArray[np.float32]

pytestmark = pytest.mark.usefixtures("one_thread")

UNCERTAIN = TINY.model_copy(update={"uncertainty": True})


def random_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def run(content: bytes, image: Image, output: str = "log_depth") -> Image:
    """An output of an exported network for (1, 3, H, W)."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return np.asarray(session.run([output], {"image": image})[0])


# --- Export and runtime ---


@pytest.fixture(scope="module")
def exported() -> tuple[DepthNetwork, DepthModel]:
    network = tiny_network(1)
    return network, exported_model(network)


def test_export_reports_size_and_parity() -> None:
    content, report = export_onnx(tiny_network())
    assert report.bytes == len(content)
    assert 0.0 <= report.parity_mean <= report.parity_max < 1e-4
    model = onnx.load_from_string(content)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert float(metadata.pop(FOCAL_KEY)) == TINY.focal_px
    assert metadata == {NETWORK_KEY: TINY.model_dump_json()}
    assert [entry.name for entry in model.graph.input] == ["image"]
    assert [entry.name for entry in model.graph.output] == ["log_depth"]


def test_the_stated_error_is_a_second_output() -> None:
    network = lively_network()
    content, report = export_onnx(network)
    assert report.parity_max < 1e-4
    model = onnx.load_from_string(content)
    assert [entry.name for entry in model.graph.output] == ["log_depth", "log_error_scale"]
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, 64, 32)).astype(np.float32)
    with torch.no_grad():
        expected = network.with_error(torch.from_numpy(image))
    for name, tensor in zip(("log_depth", "log_error_scale"), expected, strict=True):
        assert tensor is not None and float(tensor.std()) > 0.01
        np.testing.assert_allclose(run(content, image, name), tensor.numpy(), atol=1e-4)


def test_an_export_that_differs_is_not_given_out(monkeypatch: pytest.MonkeyPatch) -> None:
    network = tiny_network()

    class Wrong(torch.nn.Module):
        def __init__(self, inner: DepthNetwork) -> None:
            super().__init__()
            self.network = inner

        def forward(self, images: Tensor) -> Tensor:
            return self.network(images) + 0.01

    monkeypatch.setattr("monoloc.depth.training.export._AllOutputs", Wrong)
    with pytest.raises(
        MonolocError, match=r"the exported network differs from the original by 1\.00e-02 in log-depth"
    ):
        export_onnx(network)


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
        Camera(67, 95, 60.0, 55.0, 33.0, 47.0),
    ],
)
def test_runtime_equals_the_network(exported: tuple[DepthNetwork, DepthModel], camera: Camera) -> None:
    """The same image through onnxruntime and PyTorch, at any size: one graph serves all."""
    network, model = exported
    predictor = DepthPredictor(model, camera)
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


def stub_network(log_depth: float, focal_px: float) -> DepthModel:
    """A network of ours that answers a constant, one pixel for 4x4 of the image."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"])
    output = helper.make_tensor_value_info("log_depth", TensorProto.FLOAT, [1, 1, "rows", "columns"])
    constants = [
        helper.make_tensor("kernel", TensorProto.FLOAT, [1, 3, 1, 1], [0.0, 0.0, 0.0]),
        helper.make_tensor("bias", TensorProto.FLOAT, [1], [log_depth]),
    ]
    node = helper.make_node("Conv", ["image", "kernel", "bias"], ["log_depth"], strides=[4, 4])
    graph = helper.make_graph([node], "stub", [image], [output], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return DepthModel(model.SerializeToString(), monoloc_spec(focal_px))


@pytest.mark.parametrize("focal_px", [90.0, 136.0, 150.0, 290.0])
def test_depth_is_brought_from_the_canonical_focal_length_to_the_cameras(focal_px: float) -> None:
    """A thing that looks as large at twice the focal length is twice as far; the rounding of sizes counts too."""
    camera = Camera(640, 360, 500.0, 510.0, 317.0, 182.0)
    predictor = DepthPredictor(stub_network(np.log(1.7), focal_px), camera)
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
    prediction = DepthPredictor(stub_network(0.0, 136.0), camera)(random_image(360, 640))
    rows, columns = prediction.depth_m.shape
    block = np.array([640 / columns, 360 / rows])
    pixels = np.array([[0.0, 0.0], [columns - 1, 0], [3, 7], [columns - 1, rows - 1]])
    in_image = (pixels + 0.5) * block - 0.5
    np.testing.assert_allclose(prediction.camera.rays(pixels), camera.rays(in_image), atol=1e-9)


def test_network_size_is_never_empty() -> None:
    assert network_size(Camera(640, 480, 5000.0, 5000.0, 320.0, 240.0), 136.0) == (32, 32)


# --- Another last layer ---


def lively_network(seed: int = 0) -> DepthNetwork:
    """Of two outputs that tell images apart: their spread is near that of rooms, not that of an untrained network."""
    network = tiny_network(seed, UNCERTAIN)
    images = torch.from_numpy(np.concatenate(smooth_images(4, seed=99)))
    with torch.no_grad():
        assert network.error_head is not None
        torch.nn.init.normal_(network.error_head.weight)
        for head, output in zip((network.head, network.error_head), network.with_error(images), strict=True):
            assert output is not None
            head.weight *= 0.3 / output.std()
    return network


def smooth_images(count: int, seed: int = 0, height: int = 64, width: int = 96) -> list[Image]:
    """Coloured clouds, each (1, 3, height, width) in [-1, 1]."""
    rng = np.random.default_rng(seed)
    images = []
    for _ in range(count):
        noise = cv2.GaussianBlur(rng.standard_normal((height, width, 3)), (0, 0), rng.uniform(2.0, 8.0))
        image = np.clip(rng.uniform(-0.4, 0.4, 3) + 0.4 * noise / noise.std(), -1.0, 1.0)
        images.append(np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32))
    return images


@pytest.fixture(scope="module")
def lively() -> tuple[DepthNetwork, bytes]:
    network = lively_network()
    return network, export_onnx(network)[0]


@pytest.fixture(scope="module")
def small(lively: tuple[DepthNetwork, bytes]) -> bytes:
    return quantise(lively[1], smooth_images(24))[0]


def another_head(network: DepthNetwork) -> tuple[Image, Image]:
    rng = np.random.default_rng(5)
    weight, bias = network.head.weight.detach().numpy(), network.head.bias.detach().numpy()  # type: ignore[union-attr]
    return weight * rng.uniform(0.5, 1.5, weight.shape).astype(np.float32), bias + np.float32(0.7)


def test_the_last_layer_is_read_as_it_is(lively: tuple[DepthNetwork, bytes], small: bytes) -> None:
    network, content = lively
    weight, bias = read_last_layer(content)
    np.testing.assert_array_equal(weight, network.head.weight.detach().numpy())
    np.testing.assert_array_equal(bias, network.head.bias.detach().numpy())  # type: ignore[union-attr]
    np.testing.assert_array_equal(read_last_layer(small)[0], weight)  # whose bias alone makes up for 8 bits


def test_another_last_layer_gives_what_the_network_gives_with_it(lively: tuple[DepthNetwork, bytes]) -> None:
    network, content = lively
    weight, bias = another_head(network)
    changed = replace_last_layer(content, weight, bias)
    for image in smooth_images(3, seed=7):
        with torch.no_grad():
            features = network.decoder(network.encoder(torch.from_numpy(image)))
            expected = torch.nn.functional.conv2d(
                features, torch.from_numpy(weight), torch.from_numpy(bias), padding=1
            )
            stated = network.with_error(torch.from_numpy(image))[1]
        assert stated is not None
        np.testing.assert_allclose(run(changed, image), expected.numpy(), atol=1e-4)
        np.testing.assert_allclose(run(changed, image, "log_error_scale"), stated.numpy(), atol=1e-4)
    np.testing.assert_array_equal(read_last_layer(changed)[0], weight)
    np.testing.assert_array_equal(read_last_layer(changed)[1], bias)
    assert replace_last_layer(changed, *read_last_layer(content)) == content


def test_a_quantised_network_takes_another_last_layer_as_well(
    lively: tuple[DepthNetwork, bytes], small: bytes
) -> None:
    """Linear in the last layer: twice the weights and bias give twice the output, whatever the features' rounding."""
    weight, bias = read_last_layer(small)
    doubled = replace_last_layer(small, 2.0 * weight, 2.0 * bias)
    for image in smooth_images(3, seed=7):
        np.testing.assert_allclose(run(doubled, image), 2.0 * run(small, image), rtol=1e-4, atol=1e-5)
    other_weight, other_bias = another_head(lively[0])
    of_other = replace_last_layer(small, other_weight, other_bias)
    exact = replace_last_layer(lively[1], other_weight, other_bias)
    image = smooth_images(1, seed=7)[0]
    assert np.abs(run(of_other, image) - run(exact, image)).mean() < 0.1


@pytest.mark.parametrize("quantised", [False, True])
def test_a_last_layer_of_another_shape_is_refused(
    lively: tuple[DepthNetwork, bytes], small: bytes, quantised: bool
) -> None:
    content = small if quantised else lively[1]
    weight, bias = read_last_layer(content)
    with pytest.raises(ValueError, match=r"head\.weight must have shape \(1, 8, 3, 3\), got \(1, 7, 3, 3\)"):
        replace_last_layer(content, weight[:, :7], bias)
    with pytest.raises(ValueError, match=r"head\.bias must have shape \(1,\), got \(\)"):
        replace_last_layer(content, weight, bias[0])


def test_a_file_without_such_a_last_layer_is_refused() -> None:
    content = stub_network(0.0, 136.0).content
    with pytest.raises(ValueError, match=r"the model has no tensor head\.weight"):
        read_last_layer(content)
    with pytest.raises(ValueError, match=r"the model has no tensor head\.weight"):
        replace_last_layer(content, np.zeros((1, 8, 3, 3), np.float32), np.zeros(1, np.float32))


# --- 8 bits ---


def outputs(content: bytes, images: Sequence[Image], name: str = "log_depth") -> Image:
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return np.concatenate([np.asarray(session.run([name], {"image": image})[0]) for image in images])


def test_eight_bits_differ_little_and_not_to_one_side(lively: tuple[DepthNetwork, bytes]) -> None:
    content, images = lively[1], smooth_images(24)
    small, report = quantise(content, images)
    assert report.bytes == len(small) < 0.4 * len(content)
    # Every other image calibrated, and on those the last bias makes up for the mean shift of rounding.
    shift = outputs(small, images[::2]) - outputs(content, images[::2])
    assert abs(float(shift.mean())) < 1e-5
    judged = np.abs(outputs(small, images[1::2]) - outputs(content, images[1::2]))
    assert report.difference_mean == pytest.approx(float(judged.mean()), rel=1e-5)
    assert report.difference_max == pytest.approx(float(judged.max()), rel=1e-5)
    for name in ("log_depth", "log_error_scale"):
        exact = outputs(content, images[1::2], name)
        assert np.abs(outputs(small, images[1::2], name) - exact).mean() < 0.2 * exact.std()


def test_eight_bits_keep_what_the_file_says_and_gives(lively: tuple[DepthNetwork, bytes], small: bytes) -> None:
    before, after = onnx.load_from_string(lively[1]), onnx.load_from_string(small)
    assert {e.key: e.value for e in after.metadata_props} == {e.key: e.value for e in before.metadata_props}
    assert [value.name for value in after.graph.input] == ["image"]
    assert [value.name for value in after.graph.output] == ["log_depth", "log_error_scale"]
    # In the graph the convolutions of the heads alone are as they were.
    assert [node.op_type for node in after.graph.node].count("Conv") == 2
    onnx.checker.check_model(after)
    # Any size, as before.
    other = smooth_images(1, height=96, width=32)[0]
    assert run(small, other).shape == (1, 1, 24, 8)
    camera = Camera(192, 128, 95.0, 93.0, 93.0, 66.0)
    prediction = DepthPredictor(DepthModel(small, monoloc_spec(TINY.focal_px)), camera)(random_image(128, 192))
    assert prediction.depth_m.shape == (16, 24) and (prediction.depth_m > 0.0).all()


def test_eight_bits_are_the_same_every_time(lively: tuple[DepthNetwork, bytes], small: bytes) -> None:
    assert quantise(lively[1], smooth_images(24))[0] == small


def test_quantising_says_nothing(
    lively: tuple[DepthNetwork, bytes], capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Standard output belongs to --json, and what a library remarks on its own graph to nobody."""
    quantise(lively[1], smooth_images(10))
    assert capfd.readouterr().out == ""
    assert [record.getMessage() for record in caplog.records] == []


def test_eight_bits_are_not_quantised_again(small: bytes) -> None:
    with pytest.raises(DataError, match=r"^network: is in 8 bits already; give it as it was before"):
        quantise(small, smooth_images(10))


def test_too_few_images_to_calibrate_on(lively: tuple[DepthNetwork, bytes]) -> None:
    with pytest.raises(SettingError, match=r"^int8: has 9 frames; calibrate on at least 10$"):
        quantise(lively[1], smooth_images(9))
