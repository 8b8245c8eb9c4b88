"""A training run that is interrupted and called again ends as if it had not been; another run is not continued."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import monoloc.depth.training.train as train_module
from depth_helpers import ROOM, SMALL_CAMERA, TINY, looking_around, small_recording
from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.checkpoint import save_network
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.train import EpochRecord, TrainConfig, train_network
from monoloc.errors import SettingError
from monoloc.io.recording import Recording, Selection
from repository import on_one_thread
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


@pytest.fixture(scope="module")
def uninterrupted(
    tmp_path_factory: pytest.TempPathFactory, training: Recording, validation: Recording
) -> tuple[Path, list[EpochRecord]]:
    folder = tmp_path_factory.mktemp("uninterrupted")
    with on_one_thread():  # as in the tests that compare with it
        return folder, train_network([training], validation, UNCERTAIN, folder)


def interrupt(
    folder: Path, training: Recording, validation: Recording, after: int = 1, config: TrainConfig = UNCERTAIN
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train_network([training], validation, config, folder, progress=RecordedProgress(stop_at=after))


def test_interrupted_run_ends_like_an_uninterrupted_one(
    tmp_path: Path, training: Recording, validation: Recording, uninterrupted: tuple[Path, list[EpochRecord]]
) -> None:
    """To the last bit, interrupted after the first and after the last epoch: weights, averages, momentum, schedule
    and the order of the examples are all restored.
    """
    for epochs in (1, 4):
        interrupt(tmp_path, training, validation, epochs)
        assert len(json.loads((tmp_path / "history.json").read_text())) == epochs
    progress = RecordedProgress()
    history = train_network([training], validation, UNCERTAIN, tmp_path, progress=progress)
    assert [done for name, done, _ in progress.steps if name == "train"] == []
    folder, expected = uninterrupted
    assert without_seconds(history) == without_seconds(expected)
    assert_same_weights(weights(tmp_path), weights(folder))
    assert json.loads((tmp_path / "history.json").read_text()) == [asdict(record) for record in history]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["history.json", "network.safetensors", "resume.pt"]


def test_run_interrupted_within_an_epoch_repeats_that_epoch(
    tmp_path: Path,
    training: Recording,
    validation: Recording,
    uninterrupted: tuple[Path, list[EpochRecord]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two batches per epoch; the interruption comes in the fourth."""
    losses = 0

    def failing(*arguments: object) -> Tensor:
        nonlocal losses
        losses += 1
        if losses == 4:
            raise KeyboardInterrupt
        return depth_loss(*arguments)

    depth_loss = train_module.depth_loss
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(train_module, "depth_loss", failing)
        train_network([training], validation, UNCERTAIN, tmp_path)
    history = train_network([training], validation, UNCERTAIN, tmp_path)
    assert without_seconds(history) == without_seconds(uninterrupted[1])
    assert_same_weights(weights(tmp_path), weights(uninterrupted[0]))


def test_finished_run_is_only_read(tmp_path: Path, training: Recording, validation: Recording) -> None:
    config = SHORT.model_copy(update={"epochs": 1})
    history = train_network([training], validation, config, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert train_network([training], validation, config, tmp_path) == history
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    "changes", [{"epochs": 3}, {"seed": 1}, {"network": TINY}, {"augment": AugmentConfig(roll_deg=3.0)}]
)
def test_folder_of_a_run_with_other_settings_is_refused(
    uninterrupted: tuple[Path, list[EpochRecord]],
    training: Recording,
    validation: Recording,
    changes: dict[str, object],
) -> None:
    folder, _ = uninterrupted
    before = (folder / "resume.pt").read_bytes()
    with pytest.raises(SettingError) as caught:
        train_network([training], validation, UNCERTAIN.model_copy(update=changes), folder)
    path = folder / "resume.pt"
    assert str(caught.value) == (
        f"--out: {path} is of a run with other settings, start or frames; "
        f"remove {path} to start anew, or name another folder"
    )
    assert path.read_bytes() == before


def test_settings_of_another_version_are_other_settings(
    tmp_path: Path, training: Recording, validation: Recording
) -> None:
    torch.save({"run": '{"breadth": 1} on 8 frames'}, tmp_path / "resume.pt")
    with pytest.raises(SettingError, match=r"--out: .*resume\.pt is of a run with other settings, .*; remove"):
        train_network([training], validation, SHORT, tmp_path)


@pytest.mark.parametrize("damage", ["empty", "text", "cut short", "not a state"])
def test_unreadable_state_is_named_in_one_line(
    tmp_path: Path,
    training: Recording,
    validation: Recording,
    uninterrupted: tuple[Path, list[EpochRecord]],
    damage: str,
) -> None:
    whole = (uninterrupted[0] / "resume.pt").read_bytes()
    path = tmp_path / "resume.pt"
    path.write_bytes({"empty": b"", "text": b"not a state", "cut short": whole[:-1000], "not a state": whole}[damage])
    if damage == "not a state":
        torch.save([1, 2, 3], path)
    with pytest.raises(SettingError) as caught:
        train_network([training], validation, UNCERTAIN, tmp_path)
    assert str(caught.value) == (f"--out: {path} cannot be read; remove {path} to start anew, or name another folder")


@pytest.mark.slow
def test_run_is_not_continued_on_other_frames(tmp_path: Path, training: Recording, validation: Recording) -> None:
    """Whether more or as many: neither the learning-rate schedule nor the metrics would be those of one run."""
    interrupt(tmp_path, training, validation)
    more, others = (FourfoldDepth(ROOM, looking_around(n, seed=n - 8), SMALL_CAMERA) for n in (12, 8))
    for recordings, judged_on in (
        ([more], validation),
        ([Selection(training, [*range(7), 6])], validation),
        ([small_recording(8)], validation),  # the same images, other depth
        ([Selection(training, range(4)), Selection(more, range(4))], validation),
        ([training], Selection(others, [0, 1])),
    ):
        with pytest.raises(SettingError, match=r"resume\.pt is of a run with other settings, start or frames; rem"):
            train_network(recordings, judged_on, UNCERTAIN, tmp_path)


@pytest.mark.parametrize("role", ["start", pytest.param("encoder_weights", marks=pytest.mark.slow)])
def test_run_is_not_continued_from_another_start(
    tmp_path: Path, training: Recording, validation: Recording, role: str
) -> None:
    """Nor is a finished run returned for it."""
    config = SHORT.model_copy(update={"epochs": 1})
    file = tmp_path / ("start.safetensors" if role == "start" else "encoder.npz")

    def write_start(seed: int) -> None:
        torch.manual_seed(seed)
        network = DepthNetwork(TINY)
        if role == "start":
            save_network(network, file)
        else:
            np.savez(file, **{name: tensor.numpy() for name, tensor in network.encoder.state_dict().items()})

    def train(**start: Path) -> list[EpochRecord]:
        return train_network([training], validation, config, tmp_path / "run", **start)

    write_start(1)
    history = train(**{role: file})
    assert train(**{role: file}) == history
    for seed in (2, 1):
        write_start(seed)
        with pytest.raises(SettingError, match=r"resume\.pt is of a run with other settings, start or frames; rem"):
            train(**({role: file} if seed == 2 else {}))
