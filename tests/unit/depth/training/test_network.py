"""The depth network: sizes, settings, gradients, and the second output."""

from __future__ import annotations

import re

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from torch.nn import functional as F

from depth_helpers import UNCERTAIN, parameter_names, random_input, tiny_network
from monoloc.config import describe
from monoloc.depth.training.mobilenet import Encoder
from monoloc.depth.training.network import DepthNetwork, NetworkConfig, _LastLayer

pytestmark = pytest.mark.usefixtures("one_thread")

FULL = NetworkConfig()


@st.composite
def encoder_blocks(draw: st.DrawFn) -> tuple[int, ...]:
    """Numbers of blocks per stage, of which the last few stages may have none."""
    stages = draw(st.integers(3, 7))
    return tuple(
        draw(st.integers(1, most)) if stage < stages else 0 for stage, most in enumerate(FULL.encoder_blocks)
    )


@pytest.mark.parametrize("size", [(32, 32), (64, 96), (96, 224)])
def test_output_is_a_quarter_of_the_input(size: tuple[int, int]) -> None:
    with torch.no_grad():
        assert tiny_network()(torch.zeros(2, 3, *size)).shape == (2, 1, size[0] // 4, size[1] // 4)


def test_shipped_configuration_has_under_half_a_million_parameters() -> None:
    assert DepthNetwork(NetworkConfig()).parameter_count() == pytest.approx(0.45e6, rel=0.05)


def test_untrained_network_predicts_two_metres() -> None:
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


@torch.no_grad()
def test_depth_is_the_same_with_and_without_a_stated_error() -> None:
    """The seed draws the same weights; those of the error's head come last."""
    plain, uncertain = tiny_network(), tiny_network(config=UNCERTAIN)
    assert set(uncertain.state_dict()) - set(plain.state_dict()) == {"error_head.weight", "error_head.bias"}
    uncertain.load_state_dict(plain.state_dict(), strict=False)
    images = random_input()
    log_depth, log_scale = uncertain.with_error(images)
    torch.testing.assert_close(log_depth, plain(images), rtol=0.0, atol=0.0)
    torch.testing.assert_close(uncertain(images), plain(images), rtol=0.0, atol=0.0)
    assert plain.with_error(images)[1] is None
    # An untrained network states an error of a fifth everywhere.
    assert log_scale is not None and log_scale.shape == log_depth.shape
    torch.testing.assert_close(log_scale.exp(), torch.full_like(log_scale, 0.2))


def test_stated_error_has_gradients_in_its_own_head_only() -> None:
    network = tiny_network(config=UNCERTAIN).train()
    _, log_scale = network.with_error(random_input(2))
    assert log_scale is not None
    log_scale.square().sum().backward()
    moved = {name for name, parameter in network.named_parameters() if parameter.grad is not None}
    assert moved == {"error_head.weight", "error_head.bias"}


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
def test_impossible_settings_are_named_in_one_line(setting: dict[str, object], problem: str) -> None:
    with pytest.raises(ValidationError) as caught:
        NetworkConfig.model_validate(setting)
    assert re.search(problem, describe(caught.value)) and "\n" not in describe(caught.value)


@given(encoder_blocks(), st.tuples(*[st.integers(0, 4)] * 4))
@settings(max_examples=8)
def test_any_allowed_layers_make_a_network(blocks: tuple[int, ...], pooling: tuple[int, ...]) -> None:
    config = NetworkConfig.model_validate(
        {"width": 0.1, "decoder_channels": 8, "encoder_blocks": blocks, "pooling_stages": pooling}
    )
    network = DepthNetwork(config).eval()
    with torch.no_grad():
        output = network(random_input(1, 32, 64))
    assert output.shape == (1, 1, 8, 16) and bool(torch.isfinite(output).all())
    # Remaining blocks have the names that they have in the whole MobileNetV2.
    assert parameter_names(network.encoder) <= parameter_names(Encoder(0.1, FULL.encoder_blocks))


def test_last_layer_is_a_convolution_with_and_without_gradients() -> None:
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
