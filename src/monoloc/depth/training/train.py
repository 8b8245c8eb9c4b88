"""Training of a depth network on frames with depth."""

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
    """Settings of one training run, read from a TOML file and stored with the run's state.

    Attributes:
        network: a table of :class:`NetworkConfig`, or the name of a network of the family.
        augment, loss: augmentation of the examples, and weights of the loss terms.
        epochs, batch_size, learning_rate, weight_decay, seed: settings of the optimisation; the workers share a
            batch.
        encoder_rate_factor: learning rate of the encoder relative to that of the other layers.
        ema_decay: decay of the averaged weights, which are validated and saved.
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
        """Accept the name of a network of the family in place of a table."""
        return named_config(value) if isinstance(value, str) else value


@dataclass(frozen=True)
class EpochRecord:
    """One line of the training history; validation metrics use the averaged weights, without a scale fit."""

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
    """Train from encoder weights, a whole network or random weights, and write the network and its history.

    Training uses AdamW, a one-cycle learning rate and an exponential moving average of the weights, with bfloat16
    convolutions where they are faster. It runs on a GPU if there is one, and on several under ``torchrun``. At the
    end, the last layer's bias is set so that the median error on whole frames is zero.

    After every epoch ``out_dir`` holds ``network.safetensors`` (the averaged weights), ``history.json`` and the state
    to resume from. A call with the same settings, start weights and frames resumes training.

    Args:
        training: recordings with depth and one field of view, which are mixed; the first is of the kind that the
            network is for, and the final bias is fitted on it.
        validation: a recording with depth.
        config: all settings.
        out_dir: created if it does not exist.
        encoder_weights: MobileNetV2 weights to start from, see :func:`load_encoder_weights`.
        start: a whole network to start from, see :func:`load_network`; replaces ``encoder_weights``.
        progress: shows epochs and their metrics.
        show: called by the first process with the history so far, when training resumes and after every epoch.

    Returns:
        The history; empty in all processes but the first.

    Raises:
        DataError: a recording has no depth or cannot be read, or weights do not fit.
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
                    absrel, delta1 = frames.evaluate(run.averaged_network, worker.device)
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
    """Identity of a run: two runs are the same if all of this agrees."""
    parts = {
        "settings": config.model_dump(mode="json"),
        "start": None if start is None else file_sha256(start),
        "encoder": None if encoder_weights is None else file_sha256(encoder_weights),
        "training": [recording_identity(recording) for recording in training],
        "validation": recording_identity(validation),
    }
    return json.dumps(parts)


class _Run:
    """A network and all state that changes in training."""

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
        """Train for one pass over the frames and return the mean loss."""
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
        """Set the last layer's bias so that the median error on whole frames is zero.

        Training uses zoomed views, whose canonical depth is smaller on average than that of the images at run time.
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
        """Write network, history, and the state to resume from, in this order."""
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
        """Resume the same run; without a saved state in ``out_dir``, do nothing.

        Raises:
            SettingError: ``out_dir`` holds another run, or a state that cannot be read.
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
    """Wrapper that returns both outputs, as a module whose gradients can be averaged over workers."""

    def __init__(self, network: DepthNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        return self.network.with_error(images)
