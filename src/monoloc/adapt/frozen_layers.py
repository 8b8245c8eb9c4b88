"""What the layers that adaptation leaves as they are make of the training views, computed once for all steps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from monoloc.adapt.settings import AdaptConfig
from monoloc.depth.training.augment import AugmentConfig, random_exposure
from monoloc.depth.training.examples import network_input
from monoloc.depth.training.network import DepthNetwork
from monoloc.depth.training.precision import learns_in_bfloat16

_VIEWS_AT_ONCE = 32
_LIGHT = AugmentConfig(dim_share=0.6)


def batches(colors: NDArray[np.uint8]) -> Iterator[Tensor]:
    """Yield the network's input for images (V, H, W, 3), in batches."""
    for first in range(0, len(colors), _VIEWS_AT_ONCE):
        yield network_input(colors[first : first + _VIEWS_AT_ONCE])


@torch.no_grad()
def frozen_outputs(
    network: DepthNetwork, colors: NDArray[np.uint8], config: AdaptConfig, light: np.random.Generator
) -> list[Tensor]:
    """Outputs of the network's frozen layers for images (V, H, W, 3) uint8 RGB, channels last in memory.

    If some views of a step are relit, each has length 2 V: all images, then all again in light drawn from ``light``.
    """
    encoder = network.encoder
    if config.share_relit > 0.0:
        colors = np.concatenate([colors, [random_exposure(color, _LIGHT, light) for color in colors]])
    # Tuning by depth runs in bfloat16 where that is faster.
    in_half = config.by_depth and learns_in_bfloat16("cpu")
    parts = []
    for images in batches(colors):
        if config.tune == "all":
            part = [encoder.first_layers(images)]
        else:
            part = encoder(images) if config.tunes_features else [network.decoder(encoder(images))]
        parts.append([output.bfloat16() for output in part] if in_half else part)
    return [torch.cat(part).contiguous(memory_format=torch.channels_last) for part in zip(*parts, strict=True)]
