"""Training a depth network on frames with depth."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, cast

import torch
from pydantic import BaseModel, ConfigDict, Field, field_validator
from torch import nn
from torch.nn import functional as F

from monoloc.depth.training.augment import AugmentConfig
from monoloc.depth.training.checkpoint import load_network, save_network
from monoloc.depth.training.distributed import Worker, training_worker
from monoloc.depth.training.examples import TrainingFrames, ValidationFrames
from monoloc.depth.training.family import named_config
from monoloc.depth.training.losses import LossConfig, depth_loss, laplace_loss
from monoloc.depth.training.memory import keep_freed_memory
from monoloc.depth.training.mobilenet import load_encoder_weights
from monoloc.depth.training.network import DepthNetwork, NetworkConfig
from monoloc.depth.training.precision import learns_in_bfloat16
from monoloc.depth.training.schedule import one_cycle
from monoloc.errors import DataError, SettingError
from monoloc.files import write_whole
from monoloc.io.identity import file_sha256, recording_identity
from monoloc.io.recording import Recording
from monoloc.progress import NoProgress, Progress

_STATE = "resume.pt"
_CENTRING_FRAMES = 150


class TrainConfig(BaseModel):
    """Settings of one training run, as read from a TOML file; kept with its state.

    Attributes:
        network: a table of :class:`NetworkConfig`, or the name of a member of the family.
        augment, loss: what is trained on, and for.
        epochs, batch_size, learning_rate, weight_decay, seed: of the optimisation; a batch is shared by the workers.
        encoder_rate_factor: learning rate of the encoder against that of the rest.
        ema_decay: of the averaged weights, which are what is judged and kept.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: NetworkConfig = named_config("full-0.35")
    augment: AugmentConfig = AugmentConfig()
    loss: LossConfig = LossConfig()
    epochs: int = Field(100, ge=1)
    batch_size: int = Field(16, ge=2)
    learning_rate: float = Field(2e-3, gt=0.0)
    encoder_rate_factor: float = Field(0.5, gt=0.0)
    weight_decay: float = Field(1e-3, ge=0.0)
    ema_decay: float = Field(0.998, ge=0.0, lt=1.0)
    seed: int = Field(0, ge=0)

    @field_validator("network", mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        """A member of the family by its name, in place of a table."""
        return named_config(value) if isinstance(value, str) else value


@dataclass(frozen=True)
class EpochRecord:
    """One line of the training history; validation figures are of the averaged weights, without any scale fit."""

    epoch: int
    train_loss: float
    absrel: float
    delta1: float
    seconds: float


def train_network(
    training: Sequence[Recording],
    validation: Recording,
    config: TrainConfig,
    out_dir: Path,
    encoder_weights: Path | None = None,
    start: Path | None = None,
    progress: Progress | None = None,
    show: Callable[[list[EpochRecord]], None] | None = None,
) -> list[EpochRecord]:
    """Train from the encoder's weights, from a network or from nothing, and write the network and its history.

    AdamW, one-cycle learning rate, exponential moving average of the weights; bfloat16 convolutions where they are
    the faster; on GPUs where there are some, and on several under ``torchrun``; at the end the last layer's bias is
    set so that the median error on whole frames is none. After every epoch ``out_dir`` holds
    ``network.safetensors`` (the averaged weights), ``history.json`` (which is returned, by the first of several
    processes) and what it takes to go on from there: called again with the same settings, training resumes. What
    it starts from, and all frames, must be the same too.

    Args:
        training: recordings with depth, which are mixed, of one field of view; the first is of the kind that the
            network is for, and centres it.
        validation: a recording with depth.
        config: all settings.
        out_dir: made where it does not exist.
        encoder_weights: MobileNetV2 weights to start from, as :func:`load_encoder_weights` takes them.
        start: a whole network to start from, as :func:`load_network` takes it; in place of the former.
        progress: shows epochs and their figures.
        show: called by the first process with the history so far, when training begins again and after every epoch.

    Raises:
        DataError: a recording without depth, or one that cannot be read; weights that do not fit.
        SettingError: fewer frames than one batch, or ``out_dir`` holds another run.
    """
    for recording in (*training, validation):
        if not recording.has_depth:
            raise DataError(recording.name, "has no depth", "train on a recording with depth images")
    keep_freed_memory()
    with training_worker() as worker:
        torch.manual_seed(config.seed)
        network = _initial(config.network, encoder_weights, start)
        identity = _identity(config, training, validation, encoder_weights, start)
        run = _Run(config, training, network, identity, worker, progress or NoProgress())
        run.resume(out_dir)
        frames = ValidationFrames(validation, config.network.focal_px) if worker.is_first else None
        if show is not None and worker.is_first and run.history:
            show(run.history)
        with run.progress.task("train", config.epochs) as step:
            for epoch in range(len(run.history), config.epochs):
                started = time.perf_counter()
                loss = run.train_epoch(epoch)
                if epoch + 1 == config.epochs:
                    run.centre()
                if frames is not None:
                    absrel, delta1 = frames.judge(run.averaged_network, worker.device)
                    run.history.append(EpochRecord(epoch, loss, absrel, delta1, time.perf_counter() - started))
                    run.save(out_dir)
                    if show is not None:
                        show(run.history)
                    step(epoch + 1, f"AbsRel {absrel:.3f}, delta1 {delta1:.3f}")
        return run.history if worker.is_first else []


def _initial(config: NetworkConfig, encoder_weights: Path | None, start: Path | None) -> DepthNetwork:
    if start is not None:
        network = load_network(start)
        if network.config != config:
            raise DataError(
                start, "is not the network that the settings describe", "name it in the settings' network"
            )
        return network
    network = DepthNetwork(config)
    if encoder_weights is not None:
        load_encoder_weights(network, encoder_weights)
    return network


def _identity(
    config: TrainConfig,
    training: Sequence[Recording],
    validation: Recording,
    encoder_weights: Path | None,
    start: Path | None,
) -> str:
    """What a run must agree in to be the same."""
    parts = {
        "settings": config.model_dump(mode="json"),
        "start": None if start is None else file_sha256(start),
        "encoder": None if encoder_weights is None else file_sha256(encoder_weights),
        "training": [recording_identity(recording) for recording in training],
        "validation": recording_identity(validation),
    }
    return json.dumps(parts)


class _Run:
    """A network with all that changes while it trains."""

    def __init__(
        self,
        config: TrainConfig,
        training: Sequence[Recording],
        network: DepthNetwork,
        identity: str,
        worker: Worker,
        progress: Progress,
    ) -> None:
        self.config = config
        self.identity = identity
        self.worker = worker
        self.progress = progress
        self.history: list[EpochRecord] = []
        self._network = network.to(worker.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        average = torch.optim.swa_utils.get_ema_multi_avg_fn(config.ema_decay)  # type: ignore[no-untyped-call]
        self._averaged = torch.optim.swa_utils.AveragedModel(self._network, multi_avg_fn=average, use_buffers=True)
        with progress.task("read frames", sum(map(len, training))) as step:
            self._frames = TrainingFrames(training, config.network.focal_px, config.augment, step)
        steps_per_epoch = len(self._frames) // config.batch_size
        if steps_per_epoch < 1:
            raise SettingError(
                "batch_size", f"{config.batch_size} exceeds {len(self._frames)} frames", "use more frames"
            )
        if config.batch_size < 2 * worker.count or config.batch_size % worker.count:
            problem = (
                f"{config.batch_size} does not give {worker.count} workers the same share, of two frames or more"
            )
            raise SettingError("batch_size", problem, f"choose a multiple of {worker.count}")
        encoder = list(self._network.encoder.parameters())
        others = [p for name, p in self._network.named_parameters() if not name.startswith("encoder.")]
        rates = [config.learning_rate * config.encoder_rate_factor, config.learning_rate]
        self._optimizer = torch.optim.AdamW(
            [{"params": p, "lr": rate} for p, rate in zip((encoder, others), rates, strict=True)],
            weight_decay=config.weight_decay,
            fused=True,
        )
        self._schedule = one_cycle(self._optimizer, config.epochs * steps_per_epoch)
        self._trained = worker.wrap(_WithError(self._network))

    @property
    def averaged_network(self) -> DepthNetwork:
        return cast(DepthNetwork, self._averaged.module)

    def train_epoch(self, epoch: int) -> float:
        """One pass over the frames; returns the mean loss."""
        config, worker = self.config, self.worker
        self._trained.train()
        losses = []
        for images, depth in self._frames.epoch(config.seed, epoch, config.batch_size, worker.rank, worker.count):
            images, depth = images.to(worker.device), depth.to(worker.device)
            kind = worker.device.type
            with torch.autocast(kind, dtype=torch.bfloat16, enabled=learns_in_bfloat16(kind)):
                log_depth, log_scale = self._trained(images)
            loss = depth_loss(log_depth.float(), depth, config.loss, config.network.focal_px)
            if log_scale is not None:
                loss = loss + laplace_loss(log_depth.float(), log_scale.float(), depth)
            if not torch.isfinite(loss):
                raise SettingError("learning_rate", f"{config.learning_rate} made the loss infinite", "lower it")
            self._optimizer.zero_grad(set_to_none=True)
            loss.backward()  # type: ignore[no-untyped-call]
            torch.nn.utils.clip_grad_norm_(self._network.parameters(), 5.0)
            self._optimizer.step()
            self._schedule.step()
            self._averaged.update_parameters(self._network)
            losses.append(loss.detach())
        return worker.mean(torch.stack(losses).mean())

    @torch.no_grad()
    def centre(self) -> None:
        """Set the last layer's bias so that the median error on whole frames is none.

        Training sees zoomed views, which are nearer on average than what the network will be shown.
        """
        network = self.averaged_network.eval()
        images, depth = self._frames.whole(_CENTRING_FRAMES)
        errors = []
        for image, truth in zip(torch.split(images, 1), torch.split(depth, 1), strict=True):
            log_depth = network(image.to(self.worker.device)).float().cpu()
            log_depth = F.interpolate(log_depth, size=truth.shape[-2:], mode="bilinear", align_corners=False)
            known = truth > 0.0
            if known.any():
                errors.append((log_depth[known] - torch.log(truth[known])).median())
        assert network.head.bias is not None
        if errors:
            network.head.bias -= torch.stack(errors).median()

    def save(self, out_dir: Path) -> None:
        """Network, history, and the state to resume from; the last is written last."""
        out_dir.mkdir(parents=True, exist_ok=True)
        history = [asdict(record) for record in self.history]
        save_network(self.averaged_network, out_dir / "network.safetensors")
        write_whole(out_dir / "history.json", json.dumps(history, indent=1).encode())
        state = {name: part.state_dict() for name, part in self._parts().items()}
        content = {"run": self.identity, "history": history, **state}
        buffer = io.BytesIO()
        torch.save(content, buffer)
        write_whole(out_dir / _STATE, buffer.getvalue())

    def resume(self, out_dir: Path) -> None:
        """Go on where the same run stopped; nothing if ``out_dir`` holds none.

        Raises:
            SettingError: it holds another run, or one that cannot be read.
        """
        path = out_dir / _STATE
        if not path.is_file():
            return
        fix = f"remove {path} to start anew, or name another folder"
        try:
            content = torch.load(path, map_location=self.worker.device, weights_only=True)
            identity = content["run"]
        except (RuntimeError, EOFError, OSError, ValueError, TypeError, KeyError, UnpicklingError) as error:
            raise SettingError("--out", f"{path} cannot be read", fix) from error
        if identity != self.identity:
            raise SettingError("--out", f"{path} is of a run with other settings, start or frames", fix)
        self.history = [EpochRecord(**record) for record in content["history"]]
        for name, part in self._parts().items():
            part.load_state_dict(content[name])

    def _parts(self) -> dict[str, Any]:
        return {
            "network": self._network,
            "averaged": self._averaged,
            "optimizer": self._optimizer,
            "schedule": self._schedule,
        }


class _WithError(nn.Module):
    """The network called for both of its outputs, as a module that gradients can be averaged over."""

    def __init__(self, network: DepthNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        return self.network.with_error(images)
