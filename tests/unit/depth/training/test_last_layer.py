"""The last layer inside an exported file: read, and replaced."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from depth_helpers import lively_export, run_onnx, smooth_images, stub_network
from monoloc.depth.training.last_layer import read_last_layer, replace_last_layer
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.quantise import quantise

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def lively() -> tuple[DepthNetwork, bytes]:
    return lively_export()


@pytest.fixture(scope="module")
def small(lively: tuple[DepthNetwork, bytes]) -> bytes:
    return quantise(lively[1], smooth_images(10))[0]


def another_head(network: DepthNetwork) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    rng = np.random.default_rng(5)
    weight, bias = network.head.weight.detach().numpy(), network.head.bias.detach().numpy()  # type: ignore[union-attr]
    return weight * rng.uniform(0.5, 1.5, weight.shape).astype(np.float32), bias + np.float32(0.7)


def test_last_layer_is_read_exactly(lively: tuple[DepthNetwork, bytes], small: bytes) -> None:
    network, content = lively
    weight, bias = read_last_layer(content)
    np.testing.assert_array_equal(weight, network.head.weight.detach().numpy())
    np.testing.assert_array_equal(bias, network.head.bias.detach().numpy())  # type: ignore[union-attr]
    np.testing.assert_array_equal(
        read_last_layer(small)[0], weight
    )  # only the bias compensates for rounding to 8 bits


def test_replaced_last_layer_gives_the_depth_of_a_network_with_that_layer(lively: tuple[DepthNetwork, bytes]) -> None:
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
        np.testing.assert_allclose(run_onnx(changed, image), expected.numpy(), atol=1e-4)
        np.testing.assert_allclose(run_onnx(changed, image, "log_error_scale"), stated.numpy(), atol=1e-4)
    np.testing.assert_array_equal(read_last_layer(changed)[0], weight)
    np.testing.assert_array_equal(read_last_layer(changed)[1], bias)
    assert replace_last_layer(changed, *read_last_layer(content)) == content


def test_last_layer_of_a_quantised_network_can_be_replaced(lively: tuple[DepthNetwork, bytes], small: bytes) -> None:
    """Output is linear in the last layer: doubling weights and bias doubles it, whatever the features' rounding."""
    weight, bias = read_last_layer(small)
    doubled = replace_last_layer(small, 2.0 * weight, 2.0 * bias)
    for image in smooth_images(3, seed=7):
        np.testing.assert_allclose(run_onnx(doubled, image), 2.0 * run_onnx(small, image), rtol=1e-4, atol=1e-5)
    other_weight, other_bias = another_head(lively[0])
    of_other = replace_last_layer(small, other_weight, other_bias)
    exact = replace_last_layer(lively[1], other_weight, other_bias)
    image = smooth_images(1, seed=7)[0]
    assert np.abs(run_onnx(of_other, image) - run_onnx(exact, image)).mean() < 0.1


@pytest.mark.parametrize("quantised", [False, True])
def test_last_layer_of_another_shape_is_refused(
    lively: tuple[DepthNetwork, bytes], small: bytes, quantised: bool
) -> None:
    content = small if quantised else lively[1]
    weight, bias = read_last_layer(content)
    with pytest.raises(ValueError, match=r"head\.weight must have shape \(1, 8, 3, 3\), got \(1, 7, 3, 3\)"):
        replace_last_layer(content, weight[:, :7], bias)
    with pytest.raises(ValueError, match=r"head\.bias must have shape \(1,\), got \(\)"):
        replace_last_layer(content, weight, bias[0])


def test_file_without_such_a_last_layer_is_refused() -> None:
    content = stub_network(0.0, 136.0).content
    with pytest.raises(ValueError, match=r"the model has no tensor head\.weight"):
        read_last_layer(content)
    with pytest.raises(ValueError, match=r"the model has no tensor head\.weight"):
        replace_last_layer(content, np.zeros((1, 8, 3, 3), np.float32), np.zeros(1, np.float32))
