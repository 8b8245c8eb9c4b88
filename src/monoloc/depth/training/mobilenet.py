"""MobileNetV2 (Sandler et al., CVPR 2018): the encoder of depth networks and PoseNets.

Tensors have torchvision's names, so public ImageNet weights load unchanged. Smaller encoders omit blocks, and the
remaining blocks keep their names. Inputs are RGB in [-1, 1], (B, 3, H, W) with H and W multiples of 32.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, cast

import numpy as np
import torch
from pydantic_core import PydanticCustomError
from torch import Tensor, nn
from torch.nn import functional as F

from monoloc.array_files import read_arrays
from monoloc.errors import DataError

# Expansion, channels at width 1, first stride (Sandler et al., table 2).
_STAGES = ((1, 16, 1), (6, 24, 2), (6, 32, 2), (6, 64, 2), (6, 96, 1), (6, 160, 2), (6, 320, 1))
BLOCKS = (1, 2, 3, 4, 3, 3, 1)
"""Number of inverted residuals in each of the seven stages of the full encoder."""

# Index of each stage's first block in torchvision's ``features``.
_FIRST_INDEX = tuple(1 + sum(BLOCKS[:stage]) for stage in range(len(BLOCKS)))
_BATCH_NORM_EPS = 1e-3  # as in the training of the ImageNet weights


def check_encoder_blocks(blocks: Sequence[int]) -> None:
    """Check in a model's validator that an :class:`Encoder` can be built from these blocks per stage.

    Raises:
        PydanticCustomError: it cannot; the error names the field ``encoder_blocks``.
    """
    has_blocks = [count > 0 for count in blocks]
    if any(not 0 <= count <= most for count, most in zip(blocks, BLOCKS, strict=True)):
        raise PydanticCustomError("layers", f"encoder_blocks must lie between 0 and {BLOCKS}")
    if has_blocks != sorted(has_blocks, reverse=True) or not all(has_blocks[:3]):
        raise PydanticCustomError(
            "layers", "encoder_blocks may remove whole stages only from the end, and not the first three"
        )


def _scaled(channels: int, width: float) -> int:
    """Channels at a width multiplier: the nearest multiple of 8 that loses at most a tenth."""
    scaled = max(8, int(channels * width + 4) // 8 * 8)
    return scaled + 8 if scaled < 0.9 * channels * width else scaled


class _SamePadConv(nn.Conv2d):
    """3 x 3 convolution of stride 2 with padding (0, 1, 0, 1) for even sizes, as TensorFlow's 'same'."""

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        if input.requires_grad and input.device.type == "cpu" and self.groups > 1:
            # On a CPU, the gradient of a strided depthwise convolution costs far more than that of a dense one.
            return F.conv2d(input, weight, bias, padding=1, groups=self.groups)[..., 1::2, 1::2]
        y: Tensor = super()._conv_forward(F.pad(input, (0, 1, 0, 1)), weight, bias)
        return y


class _Layers(nn.Sequential):
    """A sequence of layers that folds batch normalisation into the preceding convolution.

    It folds while weights are tuned with fixed statistics. As a layer of its own, batch normalisation would take a
    tenth of a step in the forward pass and as much in the backward pass.
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
    """MobileNetV2 up to its last bottleneck, or fewer layers; returns the output of every stage from stride 4 on.

    Attributes:
        width: MobileNetV2's width multiplier.
        taps: maps the name of the last block of each such stage to its channels, shallow to deep.
        channels_at: maps a stride to the channels of its taps, shallow to deep.
    """

    def __init__(self, width: float, blocks: Sequence[int]) -> None:
        super().__init__()
        self.width = width
        channels = _scaled(32, width)
        layers: dict[str, nn.Module] = {"0": _conv_bn_relu(3, channels, 3, 2)}
        self.taps: dict[str, int] = {}
        self.channels_at: dict[int, list[int]] = {}
        total_stride = 2
        for stage, (expansion, base, first_stride) in enumerate(_STAGES):
            outputs = _scaled(base, width)
            total_stride *= first_stride
            for block in range(blocks[stage]):
                stride = first_stride if block == 0 else 1
                name = str(_FIRST_INDEX[stage] + block)
                layers[name] = _InvertedResidual(channels, outputs, stride, expansion)
                channels = outputs
                if stage >= 1 and block == blocks[stage] - 1:
                    self.taps[name] = channels
                    self.channels_at.setdefault(total_stride, []).append(channels)
        self.features = nn.Sequential(OrderedDict(layers))
        self._first_count = 1 + list(layers).index(next(iter(self.taps)))

    @property
    def first_layers(self) -> nn.Sequential:
        """Layers up to the first tap, at stride 4; they see edges and colours, which are the same in every room."""
        return cast(nn.Sequential, self.features[: self._first_count])

    def forward(self, images: Tensor) -> list[Tensor]:
        return self.after_first(self.first_layers(images))

    def after_first(self, x: Tensor) -> list[Tensor]:
        """Return all taps from the first one, which is the output of :attr:`first_layers`."""
        taps = [x]
        for name, block in self.features[self._first_count :].named_children():
            x = block(x)
            if name in self.taps:
                taps.append(x)
        return taps


class HasEncoder(Protocol):
    """A network with a MobileNetV2 encoder."""

    encoder: Encoder


def load_encoder_weights(network: HasEncoder, path: Path) -> None:
    """Load MobileNetV2 weights (.npz of arrays under torchvision's names) into the encoder.

    Raises:
        DataError: no such archive, or a tensor is missing or has another shape (the message gives both shapes).
    """
    try:
        arrays = read_arrays(path)
    except (OSError, ValueError) as error:
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
