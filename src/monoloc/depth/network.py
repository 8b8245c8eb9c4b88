"""The depth network: MobileNetV2 encoder, Light-Weight RefineNet decoder, one log-depth map out.

Sources: Sandler et al., *MobileNetV2* (CVPR 2018); Nekrasov et al., *Light-Weight RefineNet* (BMVC 2018)
and *Real-Time Joint Semantic Segmentation and Depth Estimation* (ICRA 2019). Encoder tensors carry
torchvision's names, so public ImageNet weights load as they are.

Inputs are RGB in [-1, 1], (B, 3, H, W) with H and W multiples of 32. The output is the natural logarithm of
*canonical* depth, (B, 1, H/4, W/4): the depth the scene would have were it seen at ``focal_px``
(:mod:`monoloc.depth.runtime` undoes it), so one network serves cameras of any field of view.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn
from torch.nn import functional as F

from monoloc.errors import DataError

# Expansion, channels at width 1, repeats, first stride (Sandler et al., table 2).
_INVERTED_RESIDUALS = (
    (1, 16, 1, 1),
    (6, 24, 2, 2),
    (6, 32, 3, 2),
    (6, 64, 4, 2),
    (6, 96, 3, 1),
    (6, 160, 3, 2),
    (6, 320, 1, 1),
)
# The last block of each of the six stages that the decoder reads, shallow to deep.
_TAPS = (3, 6, 10, 13, 16, 17)
_BATCH_NORM_EPS = 1e-3  # as the ImageNet weights were trained


class NetworkConfig(BaseModel):
    """What defines a depth network; stored with its weights.

    Attributes:
        width: MobileNetV2's width multiplier.
        decoder_channels: channels of every decoder stage.
        focal_px: focal length in pixels at which the network sees the world (canonical camera).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    width: float = Field(0.35, gt=0.0, le=2.0)
    decoder_channels: int = Field(104, ge=8, le=512)
    focal_px: float = Field(136.0, gt=0.0)


def _scaled(channels: int, width: float) -> int:
    """Channels at a width multiplier: the nearest multiple of 8 that loses at most a tenth."""
    scaled = max(8, int(channels * width + 4) // 8 * 8)
    return scaled + 8 if scaled < 0.9 * channels * width else scaled


class _SamePadConv(nn.Conv2d):
    """Stride-2 convolution padded (0, 1, 0, 1) for even sizes, as TensorFlow's 'same'."""

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self._conv_forward(F.pad(x, (0, 1, 0, 1)), self.weight, self.bias)
        return y


def _conv_bn(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    conv = (
        _SamePadConv(inputs, outputs, kernel, stride, groups=groups, bias=False)
        if stride == 2
        else nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2, groups=groups, bias=False)
    )
    return [conv, nn.BatchNorm2d(outputs, eps=_BATCH_NORM_EPS)]


def _conv_bn_relu(inputs: int, outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> nn.Module:
    return nn.Sequential(*_conv_bn(inputs, outputs, kernel, stride, groups), nn.ReLU6())


class _InvertedResidual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int) -> None:
        super().__init__()
        hidden = inputs * expansion
        self.use_residual = stride == 1 and inputs == outputs
        expand = [_conv_bn_relu(inputs, hidden, 1)] if expansion != 1 else []
        depthwise = _conv_bn_relu(hidden, hidden, 3, stride, groups=hidden)
        self.conv = nn.Sequential(*expand, depthwise, *_conv_bn(hidden, outputs, 1))

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.conv(x)
        return x + y if self.use_residual else y


class Encoder(nn.Module):
    """MobileNetV2 up to its last bottleneck; returns six feature maps, strides 4, 8, 16, 16, 32, 32."""

    def __init__(self, width: float) -> None:
        super().__init__()
        channels = _scaled(32, width)
        blocks: list[nn.Module] = [_conv_bn_relu(3, channels, 3, 2)]
        self.channels: list[int] = []
        for expansion, base, repeats, first_stride in _INVERTED_RESIDUALS:
            for repeat in range(repeats):
                outputs = _scaled(base, width)
                stride = first_stride if repeat == 0 else 1
                blocks.append(_InvertedResidual(channels, outputs, stride, expansion))
                channels = outputs
                if len(blocks) - 1 in _TAPS:
                    self.channels.append(channels)
        self.features = nn.Sequential(*blocks)

    def forward(self, x: Tensor) -> list[Tensor]:
        taps = []
        for index, block in enumerate(self.features):
            x = block(x)
            if index in _TAPS:
                taps.append(x)
        return taps


class _ChainedResidualPooling(nn.Module):
    """x + sum of a chain of (5x5 max-pool, 1x1 convolution): context at almost no cost."""

    def __init__(self, channels: int, stages: int = 4, depthwise: bool = False) -> None:
        super().__init__()
        groups = channels if depthwise else 1
        self.convs = nn.ModuleList(nn.Conv2d(channels, channels, 1, groups=groups, bias=False) for _ in range(stages))

    def forward(self, x: Tensor) -> Tensor:
        path = x
        for conv in self.convs:
            path = conv(F.max_pool2d(path, 5, stride=1, padding=2))
            x = x + path
        return x


class Decoder(nn.Module):
    """Light-Weight RefineNet over four resolutions; returns the features that the last layer reads."""

    def __init__(self, encoder_channels: list[int], channels: int) -> None:
        super().__init__()
        self.laterals = nn.ModuleList(nn.Conv2d(c, channels, 1, bias=False) for c in encoder_channels)
        self.pooling = nn.ModuleList(
            _ChainedResidualPooling(channels, depthwise=is_last) for is_last in (False, False, False, True)
        )
        self.adapt = nn.ModuleList(nn.Conv2d(channels, channels, 1, bias=False) for _ in range(3))
        self.pre_depth = nn.Conv2d(channels, channels, 1, groups=channels, bias=False)

    def forward(self, taps: list[Tensor]) -> Tensor:
        s4, s8, s16a, s16b, s32a, s32b = (conv(tap) for conv, tap in zip(self.laterals, taps, strict=True))
        x = F.relu6(s32a + s32b)
        for level, skip in enumerate((s16a + s16b, s8, s4)):
            x = self.adapt[level](self.pooling[level](x))
            x = F.interpolate(x, size=skip.shape[-2:], mode="bilinear", align_corners=False)
            x = F.relu6(x + skip)
        return F.relu6(self.pre_depth(self.pooling[3](x)))


class DepthNetwork(nn.Module):
    """Encoder, decoder, and the last 3x3 layer ``head`` (the paper's theta_D)."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = Encoder(config.width)
        self.decoder = Decoder(self.encoder.channels, config.decoder_channels)
        self.head = nn.Conv2d(config.decoder_channels, 1, 3, padding=1)
        nn.init.constant_(self.head.bias, float(np.log(2.0)))  # type: ignore[arg-type]  # rooms are about 2 m deep

    def forward(self, images: Tensor) -> Tensor:
        """Log canonical depth: (B, 3, H, W) in [-1, 1] -> (B, 1, H/4, W/4)."""
        output: Tensor = self.head(self.decoder(self.encoder(images)))
        return output

    def parameter_count(self) -> int:
        return sum(p.numel() for p in self.parameters())


def load_encoder_weights(network: DepthNetwork, path: Path) -> None:
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
            raise DataError(path, f"has no tensor {name}", "give weights under torchvision's MobileNetV2 names")
        if arrays[name].shape != tuple(target.shape):
            raise DataError(
                path,
                f"{name} has shape {arrays[name].shape}, the network at width {network.config.width} "
                f"needs {tuple(target.shape)}",
                "give weights of the same width multiplier",
            )
        state[name] = torch.from_numpy(np.asarray(arrays[name], dtype=np.float32))
    network.encoder.load_state_dict(state)
