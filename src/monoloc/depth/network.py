"""The depth network: MobileNetV2 encoder, Light-Weight RefineNet decoder, one log-depth map out.

Sources: Sandler et al., *MobileNetV2* (CVPR 2018); Nekrasov et al., *Light-Weight RefineNet* (BMVC 2018)
and *Real-Time Joint Semantic Segmentation and Depth Estimation* (ICRA 2019). Encoder tensors carry
torchvision's names, so public ImageNet weights load as they are; smaller networks leave blocks out and the
remaining ones keep their names.

Inputs are RGB in [-1, 1], (B, 3, H, W) with H and W multiples of 32. The output is the natural logarithm of
*canonical* depth, (B, 1, H/4, W/4): the depth the scene would have were it seen at ``focal_px``
(:mod:`monoloc.depth.runtime` undoes it), so one network serves cameras of any field of view.
"""

from __future__ import annotations

import zipfile
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol, cast

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError
from torch import Tensor, nn
from torch.nn import functional as F

from monoloc.depth.pooling import max_pool5
from monoloc.depth.work import multiply_adds
from monoloc.errors import DataError

# Expansion, channels at width 1, first stride (Sandler et al., table 2).
_STAGES = ((1, 16, 1), (6, 24, 2), (6, 32, 2), (6, 64, 2), (6, 96, 1), (6, 160, 2), (6, 320, 1))
_BLOCKS = (1, 2, 3, 4, 3, 3, 1)
# Index in torchvision's ``features`` of every stage's first block.
_FIRST_INDEX = tuple(1 + sum(_BLOCKS[:stage]) for stage in range(len(_BLOCKS)))
# The stages that each decoder level reads, deep to shallow: strides 32, 16, 8, 4.
_LEVEL_STAGES = ((5, 6), (3, 4), (2,), (1,))
_BATCH_NORM_EPS = 1e-3  # as the ImageNet weights were trained


class NetworkConfig(BaseModel):
    """What defines a depth network; stored with its weights.

    Attributes:
        width: MobileNetV2's width multiplier.
        decoder_channels: channels of every decoder stage.
        focal_px: focal length in pixels at which the network sees the world (canonical camera).
        encoder_blocks: inverted residuals kept of each of MobileNetV2's seven stages, counted from the stage's
            first; 0 removes a stage, which only the last ones may be.
        pooling_stages: chained-residual-pooling stages at strides 32, 16, 8 and 4; 0 removes the block.
        uncertainty: whether there is a second output, the scale of the error.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: float = Field(0.35, gt=0.0, le=2.0)
    decoder_channels: int = Field(104, ge=8, le=512)
    focal_px: float = Field(136.0, gt=0.0)
    encoder_blocks: tuple[int, int, int, int, int, int, int] = _BLOCKS
    pooling_stages: tuple[int, int, int, int] = (4, 4, 4, 4)
    uncertainty: bool = False

    @model_validator(mode="after")
    def _check(self) -> NetworkConfig:
        check_encoder_blocks(self.encoder_blocks)
        if any(not 0 <= stages <= 4 for stages in self.pooling_stages):
            raise PydanticCustomError("layers", "pooling_stages must lie between 0 and 4")
        return self


def check_encoder_blocks(blocks: Sequence[int]) -> None:
    """Refuse blocks of the seven stages, in a model's validator, that an :class:`Encoder` cannot be made of.

    Raises:
        PydanticCustomError: naming the field ``encoder_blocks``.
    """
    kept = [count > 0 for count in blocks]
    if any(not 0 <= count <= most for count, most in zip(blocks, _BLOCKS, strict=True)):
        raise PydanticCustomError("layers", f"encoder_blocks must lie between 0 and {_BLOCKS}")
    if kept != sorted(kept, reverse=True) or not all(kept[:3]):
        raise PydanticCustomError(
            "layers", "encoder_blocks may remove whole stages only from the end, and not the first three"
        )


def _scaled(channels: int, width: float) -> int:
    """Channels at a width multiplier: the nearest multiple of 8 that loses at most a tenth."""
    scaled = max(8, int(channels * width + 4) // 8 * 8)
    return scaled + 8 if scaled < 0.9 * channels * width else scaled


class _SamePadConv(nn.Conv2d):
    """3 x 3 convolution of stride 2 padded (0, 1, 0, 1) for even sizes, as TensorFlow's 'same'."""

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        if input.requires_grad and input.device.type == "cpu" and self.groups > 1:
            # A strided depthwise convolution's gradient costs far more there than a dense one's.
            return F.conv2d(input, weight, bias, padding=1, groups=self.groups)[..., 1::2, 1::2]
        y: Tensor = super()._conv_forward(F.pad(input, (0, 1, 0, 1)), weight, bias)
        return y


class _LastLayer(nn.Conv2d):
    """3 x 3 convolution to one channel.

    As nine 1 x 1 convolutions whose outputs are shifted and summed its gradient takes a third of the time.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, 1, 3, padding=1)

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        if not torch.is_grad_enabled() or input.device.type != "cpu":
            y: Tensor = super()._conv_forward(input, weight, bias)
            return y
        taps = F.conv2d(input, weight.flatten(2).permute(2, 1, 0).flip(0)[..., None])
        y = F.fold(taps.flatten(2), input.shape[-2:], 3, padding=1)
        return y if bias is None else y + bias


class _Layers(nn.Sequential):
    """Layers in a row, where batch normalisation follows a convolution.

    While weights are tuned and its statistics are kept, it is folded into that convolution: as a layer of its own it
    would take a tenth of a step, and as much again on the way back.
    """

    def forward(self, input: Tensor) -> Tensor:
        x, layers = input, list(self)
        for layer, following in zip(layers, [*layers[1:], None], strict=True):
            if isinstance(layer, nn.BatchNorm2d) and _is_folded(layer):
                continue
            if isinstance(following, nn.BatchNorm2d) and _is_folded(following):
                x = _normalised(layer, following, x)
            else:
                x = layer(x)
        return x


def _is_folded(norm: nn.BatchNorm2d) -> bool:
    return not norm.training and torch.is_grad_enabled()


def _normalised(conv: nn.Module, norm: nn.BatchNorm2d, x: Tensor) -> Tensor:
    assert isinstance(conv, nn.Conv2d) and conv.bias is None
    assert norm.running_var is not None and norm.running_mean is not None
    factor = norm.weight * torch.rsqrt(norm.running_var + norm.eps)
    shift = norm.bias - norm.running_mean * factor
    y: Tensor = conv._conv_forward(x, conv.weight * factor[:, None, None, None], shift)
    return y


def _conv_bn(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    conv = (
        _SamePadConv(inputs, outputs, kernel, stride, groups=groups, bias=False)
        if stride == 2
        else nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, groups=groups, bias=False)
    )
    return [conv, nn.BatchNorm2d(outputs, eps=_BATCH_NORM_EPS)]


def _conv_bn_relu(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> nn.Module:
    return _Layers(*_conv_bn(inputs, outputs, kernel, stride, groups), nn.ReLU6())


class _InvertedResidual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int) -> None:
        super().__init__()
        hidden = inputs * expansion
        self.use_residual = stride == 1 and inputs == outputs
        expand = [_conv_bn_relu(inputs, hidden, 1)] if expansion != 1 else []
        depthwise = _conv_bn_relu(hidden, hidden, 3, stride, groups=hidden)
        self.conv = _Layers(*expand, depthwise, *_conv_bn(hidden, outputs, 1))

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.conv(x)
        return x + y if self.use_residual else y


class Encoder(nn.Module):
    """MobileNetV2 up to its last bottleneck, or less of it; returns the output of every stage from stride 4 on.

    Attributes:
        width: MobileNetV2's width multiplier.
        taps: name of the last block of each such stage -> its channels, shallow to deep.
    """

    def __init__(self, width: float, blocks: Sequence[int]) -> None:
        super().__init__()
        self.width = width
        channels = _scaled(32, width)
        layers: dict[str, nn.Module] = {"0": _conv_bn_relu(3, channels, 3, 2)}
        self.taps: dict[str, int] = {}
        for stage, (expansion, base, first_stride) in enumerate(_STAGES):
            outputs = _scaled(base, width)
            for block in range(blocks[stage]):
                stride = first_stride if block == 0 else 1
                name = str(_FIRST_INDEX[stage] + block)
                layers[name] = _InvertedResidual(channels, outputs, stride, expansion)
                channels = outputs
                if stage >= 1 and block == blocks[stage] - 1:
                    self.taps[name] = channels
        self.features = nn.Sequential(OrderedDict(layers))
        self._first_count = 1 + list(layers).index(next(iter(self.taps)))

    @property
    def first_layers(self) -> nn.Sequential:
        """Up to the first tap, at stride 4: what they see, edges and colours, is the same in every room."""
        return cast(nn.Sequential, self.features[: self._first_count])

    def forward(self, images: Tensor) -> list[Tensor]:
        return self.after_first(self.first_layers(images))

    def after_first(self, x: Tensor) -> list[Tensor]:
        """All taps, from the first one, which is what :attr:`first_layers` gives."""
        taps = [x]
        for name, block in self.features[self._first_count :].named_children():
            x = block(x)
            if name in self.taps:
                taps.append(x)
        return taps


class _ChainedResidualPooling(nn.Module):
    """x + sum of a chain of (5x5 max-pool, 1x1 convolution): context at almost no cost."""

    def __init__(self, channels: int, stages: int, depthwise: bool) -> None:
        super().__init__()
        groups = channels if depthwise else 1
        self.convs = nn.ModuleList(nn.Conv2d(channels, channels, 1, groups=groups, bias=False) for _ in range(stages))

    def forward(self, x: Tensor) -> Tensor:
        path = x
        for conv in self.convs:
            path = conv(max_pool5(path))
            x = x + path
        return x


class Decoder(nn.Module):
    """Light-Weight RefineNet over the encoder's resolutions; returns the features that the last layer reads.

    Args:
        level_channels: channels of the encoder's taps at each resolution, deep to shallow; the last is stride 4.
        channels: of every stage of the decoder.
        pooling_stages: of the chained residual pooling at each of these resolutions.
    """

    def __init__(self, level_channels: Sequence[Sequence[int]], channels: int, pooling_stages: Sequence[int]) -> None:
        super().__init__()
        self._taps_of_level = [len(level) for level in level_channels]
        shallow_first = [c for level in reversed(level_channels) for c in level]
        self.laterals = nn.ModuleList(nn.Conv2d(c, channels, 1, bias=False) for c in shallow_first)
        last = len(level_channels) - 1
        self.pooling = nn.ModuleList(
            _ChainedResidualPooling(channels, stages, depthwise=level == last)
            for level, stages in enumerate(pooling_stages)
        )
        self.adapt = nn.ModuleList(nn.Conv2d(channels, channels, 1, bias=False) for _ in range(last))
        self.pre_depth = nn.Conv2d(channels, channels, 1, groups=channels, bias=False)

    def forward(self, taps: list[Tensor]) -> Tensor:
        skips = [conv(tap) for conv, tap in zip(self.laterals, taps, strict=True)]
        levels = []
        for count in self._taps_of_level:
            levels.append(sum(skips[len(skips) - count + 1 :], skips[len(skips) - count]))
            skips = skips[: len(skips) - count]
        x = F.relu6(levels[0])
        for level, skip in enumerate(levels[1:]):
            x = self.adapt[level](self.pooling[level](x))
            x = F.interpolate(x, size=skip.shape[-2:], mode="bilinear", align_corners=False)
            x = F.relu6(x + skip)
        return F.relu6(self.pre_depth(self.pooling[-1](x)))


class DepthNetwork(nn.Module):
    """Encoder, decoder, and the last 3x3 layer ``head`` (the paper's theta_D).

    With ``uncertainty``, ``error_head`` beside it gives the scale of a Laplace error of log-depth.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config.width, config.encoder_blocks)
        levels = [
            ([_scaled(_STAGES[stage][1], config.width) for stage in stages if config.encoder_blocks[stage]], pooling)
            for stages, pooling in zip(_LEVEL_STAGES, config.pooling_stages, strict=True)
        ]
        kept = [(channels, pooling) for channels, pooling in levels if channels]
        self.decoder = Decoder([c for c, _ in kept], config.decoder_channels, [pooling for _, pooling in kept])
        self.head = _LastLayer(config.decoder_channels)
        nn.init.constant_(self.head.bias, float(np.log(2.0)))  # type: ignore[arg-type]  # rooms are about 2 m deep
        self.error_head = _LastLayer(config.decoder_channels) if config.uncertainty else None
        if self.error_head is not None:
            nn.init.zeros_(self.error_head.weight)
            nn.init.constant_(self.error_head.bias, float(np.log(0.2)))  # type: ignore[arg-type]

    def forward(self, images: Tensor) -> Tensor:
        """Log canonical depth: (B, 3, H, W) in [-1, 1] -> (B, 1, H/4, W/4)."""
        output: Tensor = self.head(self.decoder(self.encoder(images)))
        return output

    def with_error(self, images: Tensor) -> tuple[Tensor, Tensor | None]:
        """Log canonical depth, and the log of its error's Laplace scale if there is such an output.

        Both (B, 1, H/4, W/4). The second learns from features it does not shape, so that depth is the same with
        and without it.
        """
        features = self.decoder(self.encoder(images))
        error = None if self.error_head is None else self.error_head(features.detach())
        return self.head(features), error

    def parameter_count(self) -> int:
        return sum(p.numel() for p in self.parameters())

    def multiply_adds(self, width: int, height: int) -> int:
        """Multiply-adds of the convolutions for one image; all else is a few percent of it."""
        return multiply_adds(self, lambda: self.with_error(torch.zeros(1, 3, height, width)))


class HasEncoder(Protocol):
    """A network that sees through MobileNetV2."""

    encoder: Encoder


def load_encoder_weights(network: HasEncoder, path: Path) -> None:
    """Put MobileNetV2 weights (.npz of arrays under torchvision's names) into the encoder.

    Raises:
        DataError: no such archive, or a tensor is missing or has another shape (both shapes are named).
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays: Mapping[str, np.ndarray] = {name: archive[name] for name in archive.files}
    except (OSError, EOFError, ValueError, TypeError, zipfile.BadZipFile) as error:
        raise DataError(path, "is not a readable .npz archive", "give MobileNetV2 weights as .npz") from error
    state = network.encoder.state_dict()
    for name, target in state.items():
        if name.endswith("num_batches_tracked"):
            continue
        if name not in arrays:
            raise DataError(path, f"has no tensor {name}", "give an .npz under torchvision's MobileNetV2 names")
        if arrays[name].shape != tuple(target.shape):
            raise DataError(
                path,
                f"{name} has shape {arrays[name].shape}, the network at width {network.encoder.width} "
                f"needs {tuple(target.shape)}",
                "give weights of the same width multiplier",
            )
        state[name] = torch.from_numpy(np.asarray(arrays[name], dtype=np.float32))
    network.encoder.load_state_dict(state)
