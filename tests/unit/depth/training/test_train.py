"""Training: it learns, repeats, starts from given weights, ends without a bias, and refuses bad settings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import monoloc.depth.training.train as train_module
from depth_helpers import ROOM, SMALL_CAMERA, TINY, encoder_arrays, looking_around, small_recording, tiny_network
from monoloc.depth.model_files import read_model
from monoloc.depth.predictor import DepthPredictor
from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.checkpoint import load_network, save_network
from monoloc.depth.training.examples import TrainingFrames, ValidationFrames
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.train import train_network
from monoloc.errors import DataError, SettingError
from monoloc.io.recording import Recording
from synthetic_room import RoomRecording
from training_helpers import (
    SHORT,
    UNCERTAIN,
    FourfoldDepth,
    RecordedProgress,
    assert_same_weights,
    weights,
    without_seconds,
)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def training() -> RoomRecording:
    return FourfoldDepth(ROOM, looking_around(8), SMALL_CAMERA)


@pytest.fixture(scope="module")
def validation() -> RoomRecording:
    return small_recording(2, seed=1)


def test_training_learns_repeats_and_writes_its_results(
    tmp_path: Path, training: Recording, validation: Recording
) -> None:
    progress = RecordedProgress()
    folder = tmp_path / "runs" / "a"
    history = train_network([training], validation, SHORT, folder, progress=progress)
    assert [record.epoch for record in history] == [0, 1, 2, 3]
    assert progress.steps == [
        *(("read frames", done + 1, "") for done in range(len(training))),
        *(("train", r.epoch + 1, f"AbsRel {r.absrel:.3f}, delta1 {r.delta1:.3f}") for r in history),
    ]
    assert history[-1].train_loss < 0.75 * history[0].train_loss
    assert json.loads((folder / "history.json").read_text()) == [asdict(record) for record in history]
    network = load_network(folder / "network.safetensors")
    assert network.config == TINY
    evaluated = ValidationFrames(validation, TINY.focal_px).evaluate(network, torch.device("cpu"))
    assert evaluated == pytest.approx((history[-1].absrel, history[-1].delta1), abs=1e-4)


@pytest.mark.slow
def test_training_repeats_with_its_seed_only(tmp_path: Path, training: Recording, validation: Recording) -> None:
    config = SHORT.model_copy(update={"epochs": 1})
    one, same, other = (
        train_network([training], validation, config.model_copy(update={"seed": seed}), tmp_path / name)
        for seed, name in ((0, "one"), (0, "same"), (1, "other"))
    )
    assert without_seconds(one) == without_seconds(same)
    assert_same_weights(weights(tmp_path / "one"), weights(tmp_path / "same"))
    assert other[0].train_loss != one[0].train_loss


def test_training_learns_the_error_it_states(tmp_path: Path, training: Recording, validation: Recording) -> None:
    history = train_network([training], validation, UNCERTAIN, tmp_path / "uncertain")
    state = weights(tmp_path / "uncertain")
    assert bool((state["error_head.weight"] != 0.0).any())
    assert float(state["error_head.bias"]) > np.log(0.2) + 0.05  # its depth is wrong by a factor of up to four
    assert history[-1].train_loss < history[0].train_loss


@pytest.mark.parametrize("suffix", [".safetensors", ".npz"])
def test_training_starts_from_given_weights(tmp_path: Path, suffix: str) -> None:
    """A whole network, or an encoder's weights."""
    network, room = tiny_network(5), small_recording(4)
    start = tmp_path / f"start{suffix}"
    given = {"encoder_weights": start} if suffix == ".npz" else {"start": start}
    if suffix == ".npz":
        np.savez(start, **encoder_arrays(network))
    else:
        save_network(network, start)
    config = SHORT.model_copy(update={"epochs": 1, "learning_rate": 1e-12, "ema_decay": 0.0})
    train_network([room], room, config, tmp_path / "out", **given)
    trained = load_network(tmp_path / "out" / "network.safetensors").state_dict()
    for name, tensor in network.named_parameters():
        # The head's bias is centred at the end.
        if name != "head.bias" and (suffix != ".npz" or name.startswith("encoder.")):
            torch.testing.assert_close(trained[name], tensor)


def test_start_of_another_architecture_is_refused(tmp_path: Path) -> None:
    save_network(tiny_network(), tmp_path / "start.safetensors")
    line = "is not the network that the settings describe; name it in the settings' network"
    room = small_recording(4)
    with pytest.raises(DataError, match=line):
        train_network([room], room, UNCERTAIN, tmp_path / "out", start=tmp_path / "start.safetensors")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_training_ends_without_a_bias_on_whole_frames(tmp_path: Path) -> None:
    """However far off the start is, and although the zoomed views of training alone would give another bias."""
    network, room = DepthNetwork(TINY), small_recording(6)
    with torch.no_grad():
        network.head.bias += 1.5
    save_network(network, tmp_path / "start.safetensors")
    config = SHORT.model_copy(update={"epochs": 1, "learning_rate": 1e-12, "ema_decay": 0.0})
    train_network([room], room, config, tmp_path / "out", start=tmp_path / "start.safetensors")
    predictor = DepthPredictor(read_model(tmp_path / "out" / "network.safetensors"), room.camera)
    errors = []
    for index in range(6):
        truth = room.depth(index)
        predicted = predictor(room.color(index)).resized(*truth.shape[::-1])
        known = (truth > 0.0) & (predicted > 0.0)
        errors.append(np.median(np.log(predicted[known] / truth[known])))
    # An untrained network's depth jumps between pixels, so interpolation has an effect; the start was 1.5 off.
    assert np.median(errors) == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_recordings_are_mixed_and_the_first_one_centres_the_bias(tmp_path: Path, validation: Recording) -> None:
    """Of two recordings, one reads four times too far: depth comes out between them, but centred on the first."""
    true, fourfold = small_recording(6, seed=2), FourfoldDepth(ROOM, looking_around(6), SMALL_CAMERA)
    frames = TrainingFrames([true, fourfold], TINY.focal_px, AugmentConfig(), lambda done: None)
    assert len(frames) == 12
    (batch,) = frames.epoch(seed=0, epoch=0, batch_size=12)
    median = batch[1].flatten(1).median(dim=1).values.sort().values
    assert median[6:].mean() > 2.5 * median[:6].mean()  # both are among the examples
    for first, other in ((true, fourfold), (fourfold, true)):
        folder = tmp_path / first.__class__.__name__
        history = train_network([first, other], first, SHORT.model_copy(update={"batch_size": 6}), folder)
        ratios = []
        predictor = DepthPredictor(read_model(folder / "network.safetensors"), first.camera)
        for index in range(len(first)):
            truth = first.depth(index)
            ratios.append(
                np.median(np.log(cv2.resize(predictor(first.color(index)).depth_m, truth.shape[::-1]) / truth))
            )
        assert abs(np.median(ratios)) < 0.15, history


def test_mixed_recordings_need_one_field_of_view(tmp_path: Path, training: Recording) -> None:
    wide = RoomRecording(
        ROOM, looking_around(4), replace(SMALL_CAMERA, fx=0.5 * SMALL_CAMERA.fx, fy=0.5 * SMALL_CAMERA.fy)
    )
    with pytest.raises(
        DataError, match=r"its views are \d+ x \d+, those of .+ \d+ x \d+; train on recordings of the same"
    ):
        train_network([training, wide], training, SHORT, tmp_path)
    assert not list(tmp_path.iterdir())


def test_recording_without_depth_is_refused(tmp_path: Path) -> None:
    without, with_depth = small_recording(4, has_depth=False), small_recording(4)
    for training, validation in ((without, with_depth), (with_depth, without)):
        with pytest.raises(DataError, match="room: has no depth; train on a recording with depth images"):
            train_network([training], validation, SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_fewer_frames_than_a_batch_are_refused(tmp_path: Path) -> None:
    room = small_recording(3)
    with pytest.raises(SettingError, match="batch_size: 4 exceeds 3 frames; use more frames"):
        train_network([room], room, SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_batch_that_workers_cannot_share_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Batch normalisation needs two examples per worker."""

    @contextmanager
    def one_of_three() -> Iterator[train_module.Worker]:
        yield train_module.Worker(0, 3, torch.device("cpu"))

    monkeypatch.setattr(train_module, "training_worker", one_of_three)
    room = small_recording(4)
    with pytest.raises(
        SettingError, match=r"batch_size: 4 does not give 3 workers the same share, .*; choose a multiple of 3"
    ):
        train_network([room], room, SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_diverging_learning_rate_is_named(tmp_path: Path) -> None:
    room = small_recording(8)
    config = SHORT.model_copy(update={"learning_rate": 1e36})
    with pytest.raises(SettingError, match=r"learning_rate: 1e\+36 made the loss infinite; lower it"):
        train_network([room], room, config, tmp_path)
    assert not list(tmp_path.glob(".*"))  # and nothing half-written
