"""The family of depth networks: smaller sizes have fewer layers, as in the source paper."""

from __future__ import annotations

from monoloc.depth.training.network import NetworkConfig
from monoloc.errors import SettingError

# Blocks of MobileNetV2's seven stages, and pooling stages at strides 32, 16, 8 and 4.
_LAYERS: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "full": ((1, 2, 3, 4, 3, 3, 1), (4, 4, 4, 4)),
    "two-thirds": ((1, 2, 3, 4, 3, 2, 0), (4, 4, 1, 4)),
    "one-third": ((1, 2, 3, 3, 2, 1, 0), (2, 0, 0, 4)),
    "tiny": ((1, 1, 1, 1, 1, 0, 0), (0, 2, 0, 4)),
}
_DECODER_CHANNELS = {0.35: 104, 1.0: 256}

SIZES = tuple(_LAYERS)
WIDTHS = tuple(_DECODER_CHANNELS)


def named_config(name: str) -> NetworkConfig:
    """Settings of a network of the family by name, such as ``one-third-0.35``.

    Raises:
        SettingError: no such name.
    """
    size, _, width = name.rpartition("-")
    known = [f"{size}-{width}" for width in WIDTHS for size in SIZES]
    if name not in known:
        raise SettingError("network", f"is {name!r}", f"choose one of {', '.join(known)}")
    return network_config(size, float(width))


def network_config(size: str, width: float) -> NetworkConfig:
    """Settings of a network of the family by size and width multiplier.

    Sizes are ``full``, ``two-thirds``, ``one-third`` and ``tiny``.

    Raises:
        SettingError: no such size or width.
    """
    if size not in _LAYERS:
        raise SettingError("size", f"is {size!r}", f"choose one of {', '.join(SIZES)}")
    if width not in _DECODER_CHANNELS:
        raise SettingError("width", f"is {width}", f"choose one of {', '.join(map(str, WIDTHS))}")
    encoder_blocks, pooling_stages = _LAYERS[size]
    return NetworkConfig.model_validate(
        {
            "width": width,
            "decoder_channels": _DECODER_CHANNELS[width],
            "encoder_blocks": encoder_blocks,
            "pooling_stages": pooling_stages,
            "uncertainty": True,
        }
    )
