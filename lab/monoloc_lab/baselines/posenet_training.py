"""Training a PoseNet on the posed frames of a room."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from monoloc.adapt.training_views import make_views
from monoloc.camera import Camera
from monoloc.depth.spec import image_tensor, network_size
from monoloc.depth.training.augment import AugmentConfig, random_exposure
from monoloc.depth.training.checkpoint import load_network
from monoloc.depth.training.examples import network_input
from monoloc.depth.training.memory import keep_freed_memory
from monoloc.depth.training.mobilenet import load_encoder_weights
from monoloc.depth.training.schedule import one_cycle
from monoloc.errors import DataError, SettingError
from monoloc.evaluation.trajectory import pose_errors
from monoloc.geometry import TURN_WORTH_M, FloatArray
from monoloc.image_size import resize_image
from monoloc.io.recording import Recording
from monoloc.progress import Progress
from monoloc_lab.baselines.hold_out_blocks import hold_out_blocks
from monoloc_lab.baselines.pose_error import PoseError
from monoloc_lab.baselines.posenet import HomoscedasticLoss, PoseCode, PoseNet, PoseNetConfig, posenet_config

_HELD_OUT_SHARE, _BLOCKS = 0.2, 4
_AT_ONCE = 32


class PoseNetTraining(BaseModel):
    """Settings of the training.

    Attributes:
        network: architecture.
        augment: photometric ranges; geometric augmentation would change the pose and is not used.
        synthesised_views: total number of views synthesised from nearby poses, as for the depth network.
        learning_rates: tried on some of the frames and evaluated on the others; the best trains on all.
        search_epochs, epochs: of each trial, and of the training on all frames. An epoch has as many views, recorded
            or synthesised, as there are frames.
        batch_size, weight_decay: of the optimiser.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: PoseNetConfig = posenet_config("full", 0.35)
    augment: AugmentConfig = AugmentConfig()
    synthesised_views: int = Field(0, ge=0)
    learning_rates: tuple[float, ...] = Field((1e-3, 3e-3, 1e-2), min_length=1)
    search_epochs: int = Field(40, ge=1)
    epochs: int = Field(100, ge=1)
    batch_size: int = Field(16, ge=2)
    weight_decay: float = Field(1e-3, ge=0.0)

    @property
    def least_frames(self) -> int:
        """Smallest number of training frames: two batches."""
        return 2 * self.batch_size


@dataclass(frozen=True)
class Trial:
    """Mean errors of one learning rate on the held-out frames; None if the loss became infinite."""

    learning_rate: float
    position_m: float | None
    rotation_rad: float | None

    @property
    def score_m(self) -> float:
        if self.position_m is None or self.rotation_rad is None:
            return np.inf
        return self.position_m + TURN_WORTH_M * self.rotation_rad


@dataclass(frozen=True)
class Search:
    """Results of the search for a learning rate.

    Attributes:
        trials: in the order of the learning rates.
        error: of the best learning rate on the held-out frames.
    """

    trials: list[Trial]
    error: PoseError

    @property
    def best(self) -> Trial:
        return min(self.trials, key=lambda trial: trial.score_m)


@dataclass(frozen=True)
class TrainedPoseNet:
    """A PoseNet trained on one room.

    Attributes:
        network: in evaluation mode.
        code: encoding of its outputs.
        error, trials: of the search for its learning rate.
    """

    network: PoseNet
    code: PoseCode
    error: PoseError
    trials: list[Trial]


class _Diverged(SettingError):
    """A learning rate made the loss, or the weights, infinite."""

    def __init__(self, *rates: float) -> None:
        super().__init__("learning_rates", f"{', '.join(map(str, rates))} made the loss infinite", "lower it")


class PosePredictor:
    """A PoseNet applied to the frames of one camera."""

    def __init__(self, trained: TrainedPoseNet, camera: Camera) -> None:
        self._trained = trained
        self._input_camera = camera.resized(*network_size(camera, trained.network.config.focal_px))

    @torch.no_grad()
    def __call__(self, color: NDArray[np.uint8]) -> FloatArray:
        """``T_world_camera`` (4, 4) of an image (H, W, 3) uint8 RGB."""
        image = torch.from_numpy(image_tensor(color, self._input_camera))
        return self._trained.code.decode(self._trained.network(image)[0].double().numpy())


def train_posenet(
    recording: Recording,
    config: PoseNetTraining,
    seed: int,
    progress: Progress,
    encoder_weights: Path | None = None,
    search: Search | None = None,
) -> TrainedPoseNet:
    """Train on all frames at the best learning rate.

    AdamW, one-cycle learning rate, a random exposure of every image in every epoch, dim exposures included.

    Args:
        recording: posed frames; their depth is used only to synthesise views.
        seed: of weights, order, exposures and synthesised views.
        encoder_weights: initial weights of the encoder: MobileNetV2 as .npz, or a depth network; None for random.
        search: of the learning rate; None runs one with the same seed.

    Raises:
        DataError: no poses, fewer frames than two batches, no depth for synthesised views, or weights that do not
            fit.
        SettingError: every learning rate made the loss infinite.
    """
    poses = _checked(recording, config)
    search = search or search_rate(recording, config, seed, progress, encoder_weights)
    frames = _Frames(recording, poses, config, np.zeros(0, dtype=np.int64), seed)
    everything = np.arange(len(recording))
    network = _train(
        frames, everything, config, search.best.learning_rate, config.epochs, seed, progress, encoder_weights
    )
    return TrainedPoseNet(network, frames.code, search.error, search.trials)


def search_rate(
    recording: Recording, config: PoseNetTraining, seed: int, progress: Progress, encoder_weights: Path | None = None
) -> Search:
    """Train with every learning rate on some of the frames, and evaluate on the others, held out in blocks.

    A rate that makes the loss infinite is never the best. The search fails only if all rates do.

    Args and Raises: as :func:`train_posenet`.
    """
    poses = _checked(recording, config)
    training, held_out = hold_out_blocks(len(recording), _BLOCKS, _HELD_OUT_SHARE)
    frames = _Frames(recording, poses, config, held_out, seed)
    trials, predictions = [], {}
    for rate in config.learning_rates:
        try:
            network = _train(frames, training, config, rate, config.search_epochs, seed, progress, encoder_weights)
            predicted = frames.predict(network, held_out)
            if not np.isfinite(predicted).all():
                raise _Diverged(rate)
        except _Diverged:
            trials.append(Trial(rate, None, None))
            continue
        errors = pose_errors(predicted, poses[held_out])
        trials.append(Trial(rate, float(errors.position_m.mean()), float(errors.rotation_rad.mean())))
        predictions[trials[-1]] = predicted
    if not predictions:
        raise _Diverged(*config.learning_rates)
    best = min(predictions, key=lambda trial: trial.score_m)
    return Search(trials, PoseError.fit(predictions[best], poses[held_out]))


def _checked(recording: Recording, config: PoseNetTraining) -> FloatArray:
    """The poses of a recording that is suitable for training."""
    if recording.poses is None:
        raise DataError(recording.name, "has no poses", "train on a recording with camera poses")
    if len(recording) < config.least_frames:
        raise DataError(
            recording.name, f"has too few frames ({len(recording)})", f"train on {config.least_frames} or more"
        )
    if config.synthesised_views and not recording.has_depth:
        raise DataError(recording.name, "has no depth", "set synthesised_views to 0")
    return recording.poses


def _train(
    frames: _Frames,
    chosen: NDArray[np.int64],
    config: PoseNetTraining,
    rate: float,
    epochs: int,
    seed: int,
    progress: Progress,
    encoder_weights: Path | None,
) -> PoseNet:
    keep_freed_memory()
    network = _start(config.network, seed, encoder_weights)
    with progress.task(f"PoseNet at {rate:g}", epochs) as show:
        for epoch in _epochs(network, frames, chosen, config, rate, epochs, seed):
            show(epoch + 1)
    if not all(tensor.isfinite().all() for tensor in network.state_dict().values()):
        raise _Diverged(rate)  # in the last step, which no loss follows
    return network.eval()


def _start(config: PoseNetConfig, seed: int, encoder_weights: Path | None) -> PoseNet:
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        network = PoseNet(config)
    if encoder_weights is not None and encoder_weights.suffix == ".npz":
        load_encoder_weights(network, encoder_weights)
    elif encoder_weights is not None:
        _take_encoder(network, encoder_weights)
    return network.to(memory_format=torch.channels_last)  # type: ignore[no-any-return, call-overload]


def _take_encoder(network: PoseNet, depth_network: Path) -> None:
    """Copy the encoder of a depth network, which must have every block of this one."""
    theirs, ours = load_network(depth_network).encoder.state_dict(), network.encoder.state_dict()
    odd = [name for name, tensor in ours.items() if name not in theirs or theirs[name].shape != tensor.shape]
    if odd:
        raise DataError(depth_network, f"has no {odd[0]} of that shape", "give the largest network of the same width")
    network.encoder.load_state_dict({name: theirs[name] for name in ours})


class _Frames:
    """All frames in memory at the input size of the network, with their encoded poses.

    Synthesised views follow the recorded frames; none is made from held-out frames.
    """

    def __init__(
        self,
        recording: Recording,
        poses: FloatArray,
        config: PoseNetTraining,
        held_out: NDArray[np.int64],
        seed: int,
    ) -> None:
        focal_px, count = config.network.focal_px, config.synthesised_views
        if count:
            views = make_views(recording, recording.depth, focal_px, count, held_out, np.random.default_rng(seed))
            self._images, self._odds = list(views.colors), views.odds().double().numpy()
            self._frame, seen_from = views.frame.numpy(), views.poses.numpy()
        else:
            size = network_size(recording.camera, focal_px)
            self._images = [resize_image(recording.color(index), size) for index in range(len(recording))]
            self._odds = np.ones(len(recording))
            self._frame, seen_from = np.arange(len(recording)), poses
        self._augment = config.augment
        self.code = PoseCode.of(poses)
        self._targets = torch.from_numpy(self.code.encode(seen_from).astype(np.float32))

    def batches(self, chosen: NDArray[np.int64], size: int, seed: int, epoch: int) -> Iterator[tuple[Tensor, Tensor]]:
        """As many views as there are chosen frames, in random order and exposure, which seed and epoch determine."""
        views = np.flatnonzero(np.isin(self._frame, chosen))
        odds = self._odds[views] / self._odds[views].sum()
        order = np.random.default_rng([seed, epoch]).choice(views, len(chosen), replace=False, p=odds)
        for batch in np.array_split(order, max(1, len(order) // size)):
            images = [
                random_exposure(self._images[index], self._augment, np.random.default_rng([seed, epoch, index]))
                for index in batch
            ]
            yield network_input(images), self._targets[torch.from_numpy(batch)]

    @torch.no_grad()
    def predict(self, network: PoseNet, chosen: NDArray[np.int64]) -> FloatArray:
        """Poses of frames as recorded, (N, 4, 4)."""
        images = network_input([self._images[index] for index in chosen])
        codes = torch.cat([network(part) for part in torch.split(images, _AT_ONCE)])
        return self.code.decode(codes.double().numpy())


def _epochs(
    network: PoseNet,
    frames: _Frames,
    chosen: NDArray[np.int64],
    config: PoseNetTraining,
    rate: float,
    epochs: int,
    seed: int,
) -> Iterator[int]:
    """Train, and yield the number of every epoch when it is done."""
    criterion = HomoscedasticLoss()
    groups: list[dict[str, Any]] = [
        {"params": list(network.parameters())},
        {"params": list(criterion.parameters()), "weight_decay": 0.0},
    ]
    optimizer = torch.optim.AdamW(groups, lr=rate, weight_decay=config.weight_decay)
    steps = epochs * max(1, len(chosen) // config.batch_size)
    schedule = one_cycle(optimizer, steps)
    network.train()
    for epoch in range(epochs):
        for images, target in frames.batches(chosen, config.batch_size, seed, epoch):
            loss = criterion(network(images), target)
            if not torch.isfinite(loss):
                raise _Diverged(rate)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
        yield epoch
