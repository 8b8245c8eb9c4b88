"""PoseNets on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depth_helpers import tiny_network
from monoloc.depth.training.checkpoint import save_network
from monoloc.errors import DataError
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.baselines.posenet import PoseCode, PoseNet, PoseNetConfig
from monoloc_lab.baselines.posenet_file import load_posenet, save_posenet
from monoloc_lab.baselines.posenet_training import PosePredictor, TrainedPoseNet, Trial
from synthetic_room import SMALL_CAMERA, Room, make_path

TINY = PoseNetConfig(width=0.1, encoder_blocks=(1, 1, 1, 1, 1, 1, 0), features=64, focal_px=46.0)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def trained() -> TrainedPoseNet:
    """One of its trials diverged."""
    trials = [Trial(1e30, None, None), Trial(1e-2, 0.5, 0.1)]
    return TrainedPoseNet(PoseNet(TINY).eval(), PoseCode.of(make_path(5)), PoseError(0.2, 0.1), trials)


def test_saved_posenet_is_loaded_unchanged(trained: TrainedPoseNet, tmp_path: Path) -> None:
    save_posenet(trained, tmp_path / "net.safetensors")
    loaded = load_posenet(tmp_path / "net.safetensors")
    color = Room().view(make_path(1)[0], SMALL_CAMERA)[0]
    poses = [PosePredictor(network, SMALL_CAMERA)(color) for network in (trained, loaded)]
    # The weights have another memory layout, which changes the order of sums.
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-5)
    assert (loaded.error, loaded.trials) == (trained.error, trained.trials)


@pytest.mark.parametrize("damage", ["absent", "empty", "truncated", "a depth network"])
def test_file_without_posenet_is_refused(trained: TrainedPoseNet, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "net.safetensors"
    if damage == "empty":
        path.touch()
    elif damage == "truncated":
        save_posenet(trained, path)
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "a depth network":
        save_network(tiny_network(), path)
    with pytest.raises(DataError, match=r"net\.safetensors: is not a PoseNet of monoloc .*; train it again"):
        load_posenet(path)
