"""The depth network: MobileNetV2 encoder, Light-Weight RefineNet decoder, one log-depth map as output.

Sources: Nekrasov et al., *Light-Weight RefineNet* (BMVC 2018) and *Real-Time Joint Semantic Segmentation and Depth
Estimation* (ICRA 2019). :mod:`monoloc.depth.training.mobilenet` cites the source of the encoder.

Inputs are RGB in [-1, 1], (B, 3, H, W) with H and W multiples of 32. The output is the natural logarithm of
*canonical* depth, (B, 1, H/4, W/4): the depth of the same image if its focal length were ``focal_px``.
:mod:`monoloc.depth.predictor` converts it to metric depth, so one network serves cameras of any field of view.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError
from torch import Tensor, nn
from torch.nn import functional as F
from torch.utils.flop_counter import FlopCounterMode

from monoloc.depth.training.mobilenet import BLOCKS, Encoder, check_encoder_blocks
from monoloc.depth.training.pooling import chained_pools, has_kernels, max_pool5

_STRIDES = (32, 16, 8, 4)  # of the decoder's levels, deep to shallow


class NetworkConfig(BaseModel):
    """Architecture of a depth network; stored with its weights.

    Attributes:
        width: MobileNetV2's width multiplier.
        decoder_channels: channels of every decoder stage.
        focal_px: focal length of the canonical camera, pixels.
        encoder_blocks: number of inverted residuals in each of MobileNetV2's seven stages, counted from the stage's
            first; 0 removes the stage, which is allowed only for the last stages.
        pooling_stages: chained-residual-pooling stages at strides 32, 16, 8 and 4; 0 removes the block.
        uncertainty: whether the network has a second output, the scale of the error.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: float = Field(0.35, gt=0.0, le=2.0)
    decoder_channels: int = Field(104, ge=8, le=512)
    focal_px: float = Field(136.0, gt=0.0)
    encoder_blocks: tuple[int, int, int, int, int, int, int] = BLOCKS
    pooling_stages: tuple[int, int, int, int] = (4, 4, 4, 4)
    uncertainty: bool = False

    @model_validator(mode="after")
    def _check(self) -> NetworkConfig:
        check_encoder_blocks(self.encoder_blocks)
        if any(not 0 <= stages <= 4 for stages in self.pooling_stages):
            raise PydanticCustomError("layers", "pooling_stages must lie between 0 and 4")
        return self


class _LastLayer(nn.Conv2d):
    """3 x 3 convolution to one channel.

    Computed as nine 1 x 1 convolutions whose outputs are shifted and summed, its gradient takes a third of the time.
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
        channels: channels of every decoder stage.
        pooling_stages: chained-residual-pooling stages at each of these resolutions.
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
        if not has_kernels(x):
            return F.relu6(self.pre_depth(self.pooling[-1](x)))
        # These layers have one weight a channel.
        return chained_pools(x, [*self.pooling[-1].parameters(), self.pre_depth.weight])


class DepthNetwork(nn.Module):
    """Encoder, decoder, and the last 3x3 layer ``head`` (the paper's theta_D).

    With ``uncertainty``, a second layer ``error_head`` predicts the scale of a Laplace error of log-depth.
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config.width, config.encoder_blocks)
        levels = zip(_STRIDES, config.pooling_stages, strict=True)
        present = [(channels, stages) for at, stages in levels if (channels := self.encoder.channels_at.get(at))]
        self.decoder = Decoder([c for c, _ in present], config.decoder_channels, [stages for _, stages in present])
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
        """Log canonical depth, and the log of its Laplace error scale, or None without that output.

        Both are (B, 1, H/4, W/4). The error head learns from detached features, so it does not change the depth.
        """
        features = self.decoder(self.encoder(images))
        error = None if self.error_head is None else self.error_head(features.detach())
        return self.head(features), error

    def parameter_count(self) -> int:
        return sum(p.numel() for p in self.parameters())

    def multiply_adds(self, width: int, height: int) -> int:
        """Multiply-adds of the convolutions for one image; other layers add a few percent."""
        with FlopCounterMode(display=False) as counter, torch.no_grad():
            self.with_error(torch.zeros(1, 3, height, width))
        return int(counter.get_total_flops()) // 2
