"""The family of depth networks: their sizes, and that each of them works."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch

from depth_helpers import random_input
from monoloc.config import load_settings
from monoloc.depth.training.family import SIZES, WIDTHS, named_config, network_config
from monoloc.depth.training.losses import LossConfig, depth_loss, laplace_loss
from monoloc.depth.training.mobilenet import load_encoder_weights
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.train import TrainConfig
from monoloc.errors import SettingError

pytestmark = pytest.mark.usefixtures("one_thread")

NAMES = [f"{size}-{width}" for width in WIDTHS for size in SIZES]


@cache
def member(name: str) -> DepthNetwork:
    torch.manual_seed(0)
    return DepthNetwork(named_config(name))


@pytest.mark.parametrize("width", WIDTHS)
def test_parameter_counts_match_the_names(width: float) -> None:
    count = {size: member(f"{size}-{width}").parameter_count() for size in SIZES}
    assert count["two-thirds"] == pytest.approx(2.0 / 3.0 * count["full"], rel=0.05)
    assert count["one-third"] == pytest.approx(1.0 / 3.0 * count["full"], rel=0.05)
    assert count["tiny"] <= count["full"] / 6.0
    macs = [member(f"{size}-{width}").multiply_adds(160, 128) for size in SIZES]
    assert macs == sorted(macs, reverse=True)


def test_largest_network_is_the_paper_s() -> None:
    """Three million parameters; MobileNetV2 without its last convolution and classifier has 1.81 million of them."""
    network = member("full-1.0")
    assert network.parameter_count() == pytest.approx(3.0e6, rel=0.02)
    # By torchvision's own count: 3,504,872 less 320 x 1280 + 2 x 1280 and 1280 x 1000 + 1000.
    encoder = sum(parameter.numel() for parameter in network.encoder.parameters())
    assert encoder == 3_504_872 - (320 * 1280 + 2 * 1280) - (1280 * 1000 + 1000)


def test_names_and_settings_agree() -> None:
    for name in NAMES:
        size, _, width = name.rpartition("-")
        assert named_config(name) == network_config(size, float(width))
    assert len({named_config(name) for name in NAMES}) == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_member_gives_depth_and_its_error_and_every_parameter_learns(name: str) -> None:
    network = member(name).train()
    depth_m = 1.0 + 2.0 * torch.rand(2, 1, 64, 64, generator=torch.Generator().manual_seed(2))
    log_depth, log_scale = network.with_error(random_input(2))
    assert log_scale is not None
    for output in (log_depth, log_scale):
        assert output.shape == (2, 1, 16, 16) and bool(torch.isfinite(output).all())
    (depth_loss(log_depth, depth_m, LossConfig()) + laplace_loss(log_depth, log_scale, depth_m)).backward()
    for key, parameter in network.named_parameters():
        assert parameter.grad is not None and bool(parameter.grad.abs().max() > 0.0), key


@pytest.mark.parametrize("width", WIDTHS)
def test_weights_of_the_whole_encoder_fit_every_member(tmp_path: Path, width: float) -> None:
    """The blocks of a smaller network have the names, shapes and places that they have in the whole encoder."""
    rng = np.random.default_rng(0)
    state = member(f"full-{width}").encoder.state_dict()
    arrays = {key: rng.random(tensor.shape, dtype=np.float32) for key, tensor in state.items() if tensor.ndim}
    np.savez(tmp_path / "w.npz", **arrays)
    for size in SIZES:
        check_started(DepthNetwork(network_config(size, width)), tmp_path / "w.npz")


def check_started(network: DepthNetwork, path: Path) -> None:
    load_encoder_weights(network, path)
    with np.load(path) as archive:
        for key, tensor in network.encoder.state_dict().items():
            if tensor.ndim:
                np.testing.assert_array_equal(tensor.numpy(), archive[key], err_msg=key)


@pytest.mark.data
def test_imagenet_weights_fit_every_member(weights_file: Path) -> None:
    for size in SIZES:
        check_started(DepthNetwork(network_config(size, 0.35)), weights_file)


@pytest.mark.parametrize("name", ["full", "half-0.35", "full-0.350", "full_0.35", "", "FULL-1.0"])
def test_unknown_name_lists_the_known_ones(name: str) -> None:
    with pytest.raises(SettingError) as caught:
        named_config(name)
    assert str(caught.value) == f"network: is {name!r}; choose one of {', '.join(NAMES)}"


def test_unknown_size_or_width_lists_the_known_ones() -> None:
    with pytest.raises(SettingError, match=r"size: is 'half'; choose one of full, two-thirds, one-third, tiny$"):
        network_config("half", 1.0)
    with pytest.raises(SettingError, match=r"width: is 0\.5; choose one of 0\.35, 1\.0$"):
        network_config("full", 0.5)


def test_training_settings_take_a_member_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "train.toml"
    path.write_text('network = "one-third-0.35"\n')
    assert load_settings(path, TrainConfig).network == named_config("one-third-0.35")
    path.write_text("[network]\nwidth = 0.5\n")
    assert load_settings(path, TrainConfig).network.width == 0.5
    assert TrainConfig().network == named_config("full-0.35")
    path.write_text('network = "huge-2.0"\n')
    with pytest.raises(SettingError, match=r"network: is 'huge-2\.0'; choose one of full-0\.35, "):
        load_settings(path, TrainConfig)
