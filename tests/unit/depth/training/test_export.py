"""Exported networks: the same depth through onnxruntime as in PyTorch, for any camera."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
import torch
from torch import Tensor

from depth_helpers import TINY, lively_export, random_image, run_onnx, tiny_network
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.spec import FOCAL_KEY, DepthModel, image_tensor, monoloc_spec, network_size
from monoloc.depth.training.checkpoint import NETWORK_KEY
from monoloc.depth.training.examples import network_input
from monoloc.depth.training.export import export_onnx
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import MonolocError

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def exported() -> tuple[DepthNetwork, DepthModel]:
    """A network with both outputs, and its export."""
    network, content = lively_export()
    return network, DepthModel(content, monoloc_spec(TINY.focal_px))


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


def test_both_outputs_are_those_of_the_network(exported: tuple[DepthNetwork, DepthModel]) -> None:
    network, model = exported
    names = [entry.name for entry in onnx.load_from_string(model.content).graph.output]
    assert names == ["log_depth", "log_error_scale"]
    image = np.random.default_rng(0).uniform(-1.0, 1.0, (1, 3, 64, 32)).astype(np.float32)
    with torch.no_grad():
        expected = network.with_error(torch.from_numpy(image))
    for name, tensor in zip(names, expected, strict=True):
        assert tensor is not None and float(tensor.std()) > 0.01
        np.testing.assert_allclose(run_onnx(model.content, image, name), tensor.numpy(), atol=1e-4)


def test_export_that_differs_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_export_leaves_the_network_unchanged() -> None:
    network = tiny_network()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    export_onnx(network)
    for name, tensor in before.items():
        torch.testing.assert_close(network.state_dict()[name], tensor, rtol=0.0, atol=0.0)


@pytest.mark.parametrize(
    "camera",
    [
        Camera(640, 360, 250.0, 250.0, 320.0, 180.0, (0.05, -0.02, 0.001, 0.0, 0.0)),
        Camera(320, 240, 150.0, 160.0, 150.0, 121.0),
        Camera(67, 95, 60.0, 55.0, 33.0, 47.0),
    ],
)
def test_runtime_equals_the_network(exported: tuple[DepthNetwork, DepthModel], camera: Camera) -> None:
    """The same image through onnxruntime and PyTorch, at any size, by one graph."""
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
