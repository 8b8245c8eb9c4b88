"""8-bit quantisation of networks: a quarter of the memory, and faster on processors that multiply bytes."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process

from monoloc.depth.session import load_session
from monoloc.depth.training.last_layer import read_last_layer, replace_last_layer
from monoloc.errors import DataError, SettingError

LEAST_IMAGES = 10
# Log-depth needs more than 256 steps, and the last layer must stay replaceable.
_IN_FLOAT = ("/head/Conv", "/error_head/Conv")


@dataclass(frozen=True)
class QuantisationReport:
    """Size of the 8-bit file, and largest and mean difference from the original's log-depth.

    The differences are measured on images that were not used for calibration.
    """

    bytes: int
    difference_max: float
    difference_mean: float


def quantise(content: bytes, images: Sequence[NDArray[np.float32]]) -> tuple[bytes, QuantisationReport]:
    """Quantise an exported network statically to 8 bits: weights per channel, activations per tensor.

    The last layer stays in floating point; its bias is corrected for the mean shift caused by rounding (Nagel et al.
    2019). Every other image is used for calibration, the rest for evaluation.

    Args:
        content: ONNX bytes of :func:`monoloc.depth.training.export.export_onnx`.
        images: images that represent the network's future input, each (1, 3, H, W) float32 in [-1, 1], all of one
            size.

    Raises:
        DataError: the network is already quantised.
        SettingError: too few images.
    """
    if any(node.op_type == "QuantizeLinear" for node in onnx.load_from_string(content).graph.node):
        raise DataError("network", "is in 8 bits already", "give it as it was before it was quantised")
    if len(images) < LEAST_IMAGES:
        raise SettingError("int8", f"has {len(images)} frames", f"calibrate on at least {LEAST_IMAGES}")
    calibration, evaluation = images[::2], images[1::2]
    with tempfile.TemporaryDirectory() as folder:
        source, prepared, target = (Path(folder) / name for name in ("source.onnx", "prepared.onnx", "target.onnx"))
        source.write_bytes(content)
        with _no_warnings():
            quant_pre_process(source, prepared, skip_symbolic_shape=True)
            quantize_static(
                prepared,
                target,
                _Images(calibration),
                quant_format=QuantFormat.QOperator,
                per_channel=True,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                nodes_to_exclude=[node.name for node in onnx.load(prepared).graph.node if node.name in _IN_FLOAT],
            )
        model = onnx.load(target)
    _shorten_names(model)
    metadata = onnx.load_from_string(content).metadata_props
    del model.metadata_props[:]
    model.metadata_props.extend(metadata)
    quantised = model.SerializeToString()
    shift = float(np.mean(_log_depth(quantised, calibration) - _log_depth(content, calibration)))
    weight, bias = read_last_layer(quantised)
    quantised = replace_last_layer(quantised, weight, (bias - shift).astype(np.float32))
    difference = np.abs(_log_depth(quantised, evaluation) - _log_depth(content, evaluation))
    return quantised, QuantisationReport(len(quantised), float(difference.max()), float(difference.mean()))


class _Images(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime is not typed
    def __init__(self, images: Sequence[NDArray[np.float32]]) -> None:
        self._images = iter(images)

    def get_next(self) -> dict[str, NDArray[np.float32]] | None:
        image = next(self._images, None)
        return None if image is None else {"image": image}


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Silence onnxruntime, which warns at length about shape tensors that are not meant to be quantised."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)


def _shorten_names(model: onnx.ModelProto) -> None:
    """Replace long names in the graph with numbers: in a small network, names take up to a third of the file."""
    public = {value.name for value in (*model.graph.input, *model.graph.output)} | {"", "head.weight", "head.bias"}
    numbers: dict[str, str] = {}

    def short(name: str) -> str:
        return name if name in public else numbers.setdefault(name, str(len(numbers)))

    for tensor in model.graph.initializer:
        tensor.name = short(tensor.name)
    for node in model.graph.node:
        node.input[:] = map(short, node.input)
        node.output[:] = map(short, node.output)
        node.name = ""
    del model.graph.value_info[:]


def _log_depth(content: bytes, images: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    session = load_session(content, "network")
    return np.concatenate([session.run(["log_depth"], {"image": image})[0] for image in images])
