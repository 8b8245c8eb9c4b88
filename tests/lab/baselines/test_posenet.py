"""PoseNet: its size, its loss and the encoding of poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from depth_helpers import looking_around
from monoloc.depth.training.family import SIZES, WIDTHS, network_config
from monoloc.depth.training.mobilenet import load_encoder_weights
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import SettingError
from monoloc_lab.baselines.posenet import HomoscedasticLoss, PoseCode, PoseNet, PoseNetConfig, posenet_config
from synthetic_room import make_path

TINY = PoseNetConfig(width=0.1, encoder_blocks=(1, 1, 1, 1, 1, 1, 0), features=64, focal_px=46.0)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.mark.parametrize("width", WIDTHS)
def test_as_many_parameters_as_the_depth_network(width: float) -> None:
    for size in SIZES:
        with torch.device("meta"):
            wanted = DepthNetwork(network_config(size, width)).parameter_count()
            parameters = PoseNet(posenet_config(size, width)).parameter_count()
        assert parameters == pytest.approx(wanted, rel=0.002), size


def test_unknown_size_is_refused() -> None:
    with pytest.raises(SettingError, match="size: is 'half'; choose one of full"):
        posenet_config("half", 0.35)


def test_impossible_encoder_is_refused() -> None:
    with pytest.raises(ValidationError, match="only from the end"):
        PoseNetConfig(encoder_blocks=(1, 2, 0, 4, 3, 3, 1), features=8)


@pytest.mark.data
def test_imagenet_weights_of_the_depth_network_load(weights_file: Path) -> None:
    for size in SIZES:
        network = PoseNet(posenet_config(size, 0.35))
        load_encoder_weights(network, weights_file)
        with np.load(weights_file) as archive:
            first = archive["features.0.0.weight"]
        np.testing.assert_array_equal(network.encoder.state_dict()["features.0.0.weight"].numpy(), first)


def test_gradient_reaches_every_parameter() -> None:
    torch.manual_seed(0)
    network, criterion = PoseNet(TINY), HomoscedasticLoss()
    criterion(network(torch.randn(4, 3, 64, 96)), torch.randn(4, 6)).backward()
    for name, parameter in [*network.named_parameters(), *criterion.named_parameters()]:
        assert parameter.grad is not None and bool(parameter.grad.any()), name


def test_multiply_adds_count_both_kinds_of_layer() -> None:
    network = PoseNet(TINY)
    linear = sum(layer.weight.numel() for layer in (network.hidden, network.position, network.orientation))
    narrow = PoseNet(TINY.model_copy(update={"features": 1}))
    difference = network.multiply_adds(96, 64) - narrow.multiply_adds(96, 64)
    assert difference == linear * 63 // 64


def test_loss_follows_kendall_and_cipolla() -> None:
    rng = np.random.default_rng(0)
    predicted, target = rng.normal(size=(2, 5, 6))
    s_p, s_q = 0.7, -2.2
    criterion = HomoscedasticLoss()
    with torch.no_grad():
        criterion.log_variances.copy_(torch.tensor([s_p, s_q]))
    distance = np.abs(predicted - target)
    of_position, of_orientation = distance[:, :3].sum(axis=1).mean(), distance[:, 3:].sum(axis=1).mean()
    expected = of_position * np.exp(-s_p) + s_p + of_orientation * np.exp(-s_q) + s_q
    loss = criterion(torch.from_numpy(predicted), torch.from_numpy(target))
    assert loss.item() == pytest.approx(expected, rel=1e-6)


def test_learned_log_variances_converge_to_the_log_errors() -> None:
    """The minimum over s of L exp(-s) + s is at s = log L."""
    error = torch.tensor([[0.3, -0.2, 0.5, 0.01, 0.02, -0.03]])
    criterion = HomoscedasticLoss()
    optimizer = torch.optim.SGD(criterion.parameters(), lr=0.3)
    for _ in range(200):
        optimizer.zero_grad()
        criterion(error, torch.zeros(1, 6)).backward()
        optimizer.step()
    np.testing.assert_allclose(criterion.log_variances.detach(), np.log([1.0, 0.06]), atol=1e-4)


def test_code_inverts() -> None:
    poses = looking_around(20)
    code = PoseCode.of(poses[:10])
    np.testing.assert_allclose(code.decode(code.encode(poses)), poses, atol=1e-12)


def test_code_is_centred_and_scaled() -> None:
    poses = make_path(100)
    code = PoseCode.of(poses).encode(poses)
    np.testing.assert_allclose(code[:, :3].mean(axis=0), 0.0, atol=1e-12)
    assert np.mean(code[:, :3] ** 2) == pytest.approx(1.0)
    assert np.abs(code[:, 3:].mean(axis=0)).max() < 0.01


def test_code_of_a_stationary_camera() -> None:
    poses = np.repeat(looking_around(1), 3, axis=0)
    np.testing.assert_allclose(PoseCode.of(poses).encode(poses), 0.0, atol=1e-12)
