"""PoseNet: its size, its loss, its training and its file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from depth_helpers import FloatArray, looking_around, small_recording
from monoloc.depth.spec import image_tensor, network_size
from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.examples import network_input
from monoloc.depth.training.family import SIZES, WIDTHS, network_config
from monoloc.depth.training.mobilenet import load_encoder_weights
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.trajectory import pose_errors
from monoloc.progress import NoProgress
from monoloc_lab.baselines import posenet_training
from monoloc_lab.baselines.posenet import HomoscedasticLoss, PoseCode, PoseNet, PoseNetConfig, posenet_config
from monoloc_lab.baselines.posenet_file import load_posenet, save_posenet
from monoloc_lab.baselines.posenet_training import PoseNetTraining, PosePredictor, TrainedPoseNet, train_posenet
from synthetic_room import Room, RoomRecording, make_path

TINY = PoseNetConfig(width=0.1, encoder_blocks=(1, 1, 1, 1, 1, 1, 0), features=64, focal_px=46.0)
SAME_LIGHT = AugmentConfig(
    exposure_stops=0.0, gamma=0.0, contrast=0.0, white_balance=0.0, saturation=0.0, dim_share=0.0, blur_px=0.0
)
QUICK = PoseNetTraining(network=TINY, learning_rates=(1e-2,), search_epochs=1, epochs=2, batch_size=4)

pytestmark = pytest.mark.usefixtures("one_thread")


def train(recording: RoomRecording, config: PoseNetTraining = QUICK, seed: int = 0) -> TrainedPoseNet:
    return train_posenet(recording, config, seed, NoProgress())


def poses_of(trained: TrainedPoseNet, recording: RoomRecording) -> FloatArray:
    predictor = PosePredictor(trained, recording.camera)
    return np.stack([predictor(recording.color(index)) for index in range(len(recording))])


# --- The network ---


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("size", SIZES)
def test_as_many_parameters_as_the_depth_network(size: str, width: float) -> None:
    wanted = DepthNetwork(network_config(size, width)).parameter_count()
    assert PoseNet(posenet_config(size, width)).parameter_count() == pytest.approx(wanted, rel=0.002)


def test_unknown_size_names_the_known() -> None:
    with pytest.raises(SettingError, match="size: is 'half'; choose one of full"):
        posenet_config("half", 0.35)


def test_encoder_that_cannot_be_made_is_refused() -> None:
    with pytest.raises(ValidationError, match="only from the end"):
        PoseNetConfig(encoder_blocks=(1, 2, 0, 4, 3, 3, 1), features=8)


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


# --- The loss ---


def test_loss_is_kendall_and_cipolla_s() -> None:
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


def test_learned_weights_become_the_logarithm_of_what_is_left() -> None:
    """The minimum over s of L exp(-s) + s is at s = log L."""
    error = torch.tensor([[0.3, -0.2, 0.5, 0.01, 0.02, -0.03]])
    criterion = HomoscedasticLoss()
    optimizer = torch.optim.SGD(criterion.parameters(), lr=0.3)
    for _ in range(200):
        optimizer.zero_grad()
        criterion(error, torch.zeros(1, 6)).backward()
        optimizer.step()
    np.testing.assert_allclose(criterion.log_variances.detach(), np.log([1.0, 0.06]), atol=1e-4)


# --- The code ---


def test_code_gives_poses_back() -> None:
    poses = looking_around(20)
    code = PoseCode.of(poses[:10])
    np.testing.assert_allclose(code.decode(code.encode(poses)), poses, atol=1e-12)


def test_code_is_centred_and_scaled() -> None:
    poses = make_path(100)
    code = PoseCode.of(poses).encode(poses)
    np.testing.assert_allclose(code[:, :3].mean(axis=0), 0.0, atol=1e-12)
    assert np.mean(code[:, :3] ** 2) == pytest.approx(1.0)
    assert np.abs(code[:, 3:].mean(axis=0)).max() < 0.01


def test_code_of_a_camera_that_stands_still() -> None:
    poses = np.repeat(looking_around(1), 3, axis=0)
    np.testing.assert_allclose(PoseCode.of(poses).encode(poses), 0.0, atol=1e-12)


# --- Training ---


@pytest.mark.slow
def test_learns_its_frames_by_heart() -> None:
    """Wrong axes, scales or orders anywhere between pose and image would show as decimetres.

    Over settings and seeds medians were 1.5 to 3.1 cm and the largest errors 2.8 to 4.2 cm and 1.3 to 3.2 degrees.
    """
    recording = RoomRecording(Room(), make_path(16, start_s=0.1, rate_hz=2.0), small_recording(1).camera)
    network = TINY.model_copy(update={"features": 256})
    learned = {"network": network, "augment": SAME_LIGHT, "learning_rates": (2e-2,), "epochs": 150, "batch_size": 8}
    trained = train(recording, QUICK.model_copy(update=learned))
    assert recording.poses is not None
    errors = pose_errors(poses_of(trained, recording), recording.poses)
    assert np.median(errors.position_m) < 0.05 and np.max(errors.position_m) < 0.08
    assert np.rad2deg(np.max(errors.rotation_rad)) < 6.0


def test_same_seed_same_network_another_another() -> None:
    recording = small_recording(8)
    first, again, other = (poses_of(train(recording, seed=seed), recording) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4


@pytest.mark.slow
def test_the_better_learning_rate_trains_on_all() -> None:
    recording = RoomRecording(Room(), make_path(16, start_s=0.1, rate_hz=4.0), small_recording(1).camera)
    both = QUICK.model_copy(update={"learning_rates": (1e-9, 1e-2), "search_epochs": 30, "augment": SAME_LIGHT})
    trained = train(recording, both)
    assert trained.trials[1].score_m < trained.trials[0].score_m
    alone = train(recording, both.model_copy(update={"learning_rates": (1e-2,)}))
    np.testing.assert_array_equal(poses_of(trained, recording), poses_of(alone, recording))


def test_stated_error_is_of_the_size_of_the_held_out_one() -> None:
    trained = train(small_recording(8))
    trial = trained.trials[0]
    # Three axes' worth of one axis' deviation, and a heavy tail.
    assert 0.2 * trial.position_m < np.sqrt(3.0) * trained.error.position_sd_m < 2.0 * trial.position_m
    assert 0.2 * trial.rotation_rad < np.sqrt(3.0) * trained.error.rotation_sd_rad < 2.0 * trial.rotation_rad


def test_small_images_are_learned_as_they_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that the network's input enlarges."""
    recording = small_recording(8, camera=small_recording(1).camera.resized(48, 32))
    learned: list[np.ndarray] = []

    def listening(images: list[np.ndarray]) -> torch.Tensor:
        learned.extend(images)
        return network_input(images)

    monkeypatch.setattr(posenet_training, "network_input", listening)
    train(recording)
    camera = recording.camera.resized(*network_size(recording.camera, TINY.focal_px))
    seen = [image_tensor(recording.color(index), camera) for index in range(8)]
    held_out = [network_input([image]).numpy() for image in learned]
    assert any(np.allclose(one, other, atol=1e-6) for one in held_out for other in seen)


def test_recording_without_poses() -> None:
    recording = small_recording(8)
    recording.poses = None
    with pytest.raises(DataError, match="room: has no poses; train on a recording with camera poses"):
        train(recording)


def test_too_few_frames() -> None:
    with pytest.raises(DataError, match="room: gives 7 frames; train on 8 or more"):
        train(small_recording(7))


@pytest.mark.parametrize("search_epochs", [1, 20])
def test_learning_rates_that_all_diverge_are_named(search_epochs: int) -> None:
    config = QUICK.model_copy(update={"learning_rates": (1e30, 1e31), "search_epochs": search_epochs})
    with pytest.raises(SettingError, match=r"^learning_rates: 1e\+30, 1e\+31 made the loss infinite; lower it$"):
        train(small_recording(8), config)


def test_one_learning_rate_that_diverges_does_not_end_the_search(tmp_path: Path) -> None:
    """It is kept among the trials, without errors, in what is written too."""
    recording = small_recording(8)
    config = QUICK.model_copy(update={"learning_rates": (1e30, 1e-2), "search_epochs": 3})
    trained = train(recording, config)
    diverged, other = trained.trials
    assert (diverged.position_m, diverged.rotation_rad, diverged.score_m) == (None, None, np.inf)
    alone = train(recording, config.model_copy(update={"learning_rates": (1e-2,)}))
    assert [other] == alone.trials
    np.testing.assert_array_equal(poses_of(trained, recording), poses_of(alone, recording))
    json.dumps([asdict(trial) for trial in trained.trials], allow_nan=False)
    save_posenet(trained, tmp_path / "net.safetensors")
    assert load_posenet(tmp_path / "net.safetensors").trials == trained.trials


def test_training_may_be_of_ten_steps() -> None:
    """In the search one an epoch, and after it two: a tenth is a single step, less one of which torch divides by."""
    train(small_recording(8), QUICK.model_copy(update={"search_epochs": 10, "epochs": 5}))


# --- On disk ---


def test_file_round_trip(tmp_path: Path) -> None:
    recording = small_recording(8)
    trained = train(recording)
    save_posenet(trained, tmp_path / "net.safetensors")
    loaded = load_posenet(tmp_path / "net.safetensors")
    # Weights come back in another memory layout, and sums are then taken in another order.
    np.testing.assert_allclose(poses_of(loaded, recording), poses_of(trained, recording), atol=1e-5)
    assert (loaded.error, loaded.trials) == (trained.error, trained.trials)


@pytest.mark.parametrize("damage", ["absent", "empty", "cut short", "a depth network"])
def test_file_that_is_no_posenet(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "net.safetensors"
    if damage == "empty":
        path.touch()
    elif damage == "cut short":
        save_posenet(train(small_recording(8)), path)
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "a depth network":
        from monoloc.depth.training.checkpoint import save_network

        save_network(DepthNetwork(network_config("tiny", 0.35)), path)
    with pytest.raises(DataError, match=r"net\.safetensors: is not a PoseNet of monoloc .*; train it again"):
        load_posenet(path)
