"""The depth networks shipped with monoloc, each in float32 and 8 bits; their training settings are in this folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from monoloc.errors import SettingError

DEFAULT = "full-0.35"

_FOLDER = Path(__file__).parent
_CATALOGUE = _FOLDER / "models.json"
_INT8 = "-int8"


@dataclass(frozen=True)
class ShippedModel:
    """One entry of the catalogue.

    Attributes:
        name: size and width, such as ``one-third-0.35``; the suffix ``-int8`` selects the 8-bit file.
        width: MobileNetV2's width multiplier.
        parameters: number of parameters.
        macs: multiply-adds for one image of ``input_width`` x ``input_height``.
        bytes_fp32, bytes_int8: sizes of the two files.
        input_width, input_height: input size for a camera with NYU's field of view, pixels.
        delta1, absrel: float32 accuracy on the last 100 NYU pairs, whose rooms were not in the training set, without
            a scale fit.
        delta1_int8, absrel_int8: the same in 8 bits.
    """

    name: str
    width: float
    parameters: int
    macs: int
    bytes_fp32: int
    bytes_int8: int
    input_width: int
    input_height: int
    delta1: float
    absrel: float
    delta1_int8: float
    absrel_int8: float


def shipped_models() -> list[ShippedModel]:
    """All shipped networks, the largest first."""
    return [ShippedModel(**entry) for entry in json.loads(_CATALOGUE.read_text(encoding="utf-8"))]


def is_shipped(name: str) -> bool:
    """Whether ``name`` is that of a shipped network, with or without ``-int8``."""
    return name.removesuffix(_INT8) in (model.name for model in shipped_models())


def is_quantised(name: str) -> bool:
    """Whether ``name`` is that of an 8-bit network, which can be run but not tuned."""
    return name.endswith(_INT8)


def shipped_file(name: str) -> Path:
    """Return the ONNX file of a shipped network.

    Raises:
        SettingError: no such network.
    """
    if not is_shipped(name):
        names = ", ".join(model.name for model in shipped_models())
        raise SettingError("network", f"is {name!r}", f"choose one of {names}, or the same with {_INT8}")
    return _FOLDER / f"{name}.onnx"
