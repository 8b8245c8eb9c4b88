"""Training a depth network on frames with depth."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from monoloc.camera import Camera
from monoloc.datasets.base import Recording
from monoloc.depth.augment import AugmentConfig, random_exposure, random_view
from monoloc.depth.checkpoint import save_network
from monoloc.depth.losses import depth_loss
from monoloc.depth.network import DepthNetwork, NetworkConfig, load_encoder_weights
from monoloc.depth.runtime import network_size
from monoloc.errors import DataError, SettingError
from monoloc.files import write_whole
from monoloc.memory import keep_freed_memory


class TrainConfig(BaseModel):
    """Settings of one training run, as read from a TOML file; written beside the weights."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: NetworkConfig = NetworkConfig()
    augment: AugmentConfig = AugmentConfig()
    epochs: int = Field(100, ge=1)
    batch_size: int = Field(16, ge=2)
    learning_rate: float = Field(2e-3, gt=0.0)
    encoder_rate_factor: float = Field(0.5, gt=0.0)
    weight_decay: float = Field(1e-3, ge=0.0)
    gradient_weight: float = Field(0.5, ge=0.0)
    ema_decay: float = Field(0.998, ge=0.0, lt=1.0)
    seed: int = 0


@dataclass(frozen=True)
class EpochRecord:
    """One line of the training history; validation figures are of the averaged weights, without any scale fit."""

    epoch: int
    train_loss: float
    absrel: float
    delta1: float
    seconds: float


def network_input(images: list[NDArray[np.uint8]]) -> Tensor:
    """Images (H, W, 3) uint8 RGB of one size -> (B, 3, H, W) in [-1, 1], channels last in memory."""
    batch = torch.from_numpy(np.stack(images)).permute(0, 3, 1, 2)
    return (batch.float() / 127.5 - 1.0).contiguous(memory_format=torch.channels_last)


class _Frames:
    """All frames of a recording in memory, at no more than the resolution that views can use."""

    def __init__(self, recording: Recording, size: tuple[int, int], zoom_max: float) -> None:
        full = recording.camera
        factor = min(1.0, zoom_max * 1.25 * size[0] / full.width)
        self.camera: Camera = full.resized(round(full.width * factor), round(full.height * factor))
        shape = (self.camera.width, self.camera.height)
        self.colors, self.depths = [], []
        for index in range(len(recording)):
            color, depth = recording.color(index), recording.depth(index)
            if not np.all(np.isfinite(depth)):
                raise DataError(recording.frame_names[index], "depth holds NaN", "mark missing depth with 0")
            self.colors.append(cv2.resize(color, shape, interpolation=cv2.INTER_AREA))
            self.depths.append(cv2.resize(depth, shape, interpolation=cv2.INTER_NEAREST_EXACT))

    def __len__(self) -> int:
        return len(self.colors)


def train_network(
    training: Recording,
    validation: Recording,
    config: TrainConfig,
    out_dir: Path,
    encoder_weights: Path | None = None,
    progress: Callable[[EpochRecord], None] | None = None,
) -> list[EpochRecord]:
    """Train from the encoder's weights (or from nothing) and write the network and its history.

    AdamW, one-cycle learning rate, exponential moving average of the weights, bfloat16 convolutions. After every
    epoch ``out_dir`` holds ``network.safetensors`` (the averaged weights) and ``history.json``, which is returned.

    Raises:
        DataError: a recording without depth, or one that cannot be read.
        SettingError: fewer frames than one batch.
    """
    for recording in (training, validation):
        if not recording.has_depth:
            raise DataError(recording.name, "has no depth", "train on a recording with depth images")
    keep_freed_memory()
    rng = np.random.default_rng(config.seed)
    torch.manual_seed(config.seed)
    network = DepthNetwork(config.network)
    if encoder_weights is not None:
        load_encoder_weights(network, encoder_weights)
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    average = torch.optim.swa_utils.get_ema_multi_avg_fn(config.ema_decay)  # type: ignore[no-untyped-call]
    averaged = torch.optim.swa_utils.AveragedModel(network, multi_avg_fn=average, use_buffers=True)
    size = network_size(training.camera, config.network.focal_px)
    frames = _Frames(training, size, config.augment.zoom_max)
    steps_per_epoch = len(frames) // config.batch_size
    if steps_per_epoch < 1:
        raise SettingError("batch_size", f"{config.batch_size} exceeds {len(frames)} frames", "use more frames")
    optimizer = torch.optim.AdamW(
        [
            {"params": network.encoder.parameters(), "lr": config.learning_rate * config.encoder_rate_factor},
            {
                "params": [*network.decoder.parameters(), *network.head.parameters()],
                "lr": config.learning_rate,
            },
        ],
        weight_decay=config.weight_decay,
    )
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        [group["lr"] for group in optimizer.param_groups],
        total_steps=config.epochs * steps_per_epoch,
        pct_start=0.1,
    )
    out_dir.mkdir(parents=True, exist_ok=True)
    history: list[EpochRecord] = []
    for epoch in range(config.epochs):
        started = time.perf_counter()
        network.train()
        losses = []
        for images, depth in _batches(frames, size, config, rng):
            with torch.autocast("cpu", dtype=torch.bfloat16):
                log_depth = network(images)
            loss = depth_loss(log_depth.float(), depth, config.gradient_weight)
            if not torch.isfinite(loss):
                raise SettingError("learning_rate", f"{config.learning_rate} made the loss infinite", "lower it")
            optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
            optimizer.step()
            schedule.step()
            averaged.update_parameters(network)
            losses.append(loss.detach())
        absrel, delta1 = validate(cast(DepthNetwork, averaged.module), validation)
        train_loss = float(torch.stack(losses).mean())
        history.append(EpochRecord(epoch, train_loss, absrel, delta1, time.perf_counter() - started))
        save_network(cast(DepthNetwork, averaged.module), out_dir / "network.safetensors")
        write_whole(out_dir / "history.json", json.dumps([asdict(record) for record in history], indent=1).encode())
        if progress is not None:
            progress(history[-1])
    return history


def _batches(
    frames: _Frames, size: tuple[int, int], config: TrainConfig, rng: np.random.Generator
) -> Iterator[tuple[Tensor, Tensor]]:
    order = rng.permutation(len(frames))
    for start in range(0, len(order) - config.batch_size + 1, config.batch_size):
        images, depths = [], []
        for index in order[start : start + config.batch_size]:
            view = random_view(frames.colors[index], frames.depths[index], frames.camera, size, config.augment, rng)
            images.append(random_exposure(view.color, config.augment, rng))
            depths.append(view.depth_m * np.float32(config.network.focal_px / view.focal_px))
        yield network_input(images), torch.from_numpy(np.stack(depths))[:, None]


@torch.no_grad()
def validate(network: DepthNetwork, recording: Recording) -> tuple[float, float]:
    """AbsRel and delta1 of a network on a recording, metric as predicted, mean over images with depth."""
    network.eval()
    width, height = network_size(recording.camera, network.config.focal_px)
    small = recording.camera.resized(width, height)
    absrel, delta1 = [], []
    for index in range(len(recording)):
        color = cv2.resize(recording.color(index), (width, height), interpolation=cv2.INTER_AREA)
        log_depth = network(network_input([np.asarray(color, dtype=np.uint8)]))[0, 0].numpy()
        truth = recording.depth(index)
        valid = truth > 0.0
        if not valid.any():
            continue
        predicted = cv2.resize(np.exp(log_depth), truth.shape[::-1]) * (small.focal_px / network.config.focal_px)
        ratio = predicted[valid] / truth[valid]
        absrel.append(np.mean(np.abs(ratio - 1.0)))
        delta1.append(np.mean(np.maximum(ratio, 1.0 / ratio) < 1.25))
    return float(np.mean(absrel)), float(np.mean(delta1))
