"""Read and replace the last layer of an exported network in its file; needs onnx, not PyTorch."""

from __future__ import annotations

import numpy as np
import onnx
from numpy.typing import NDArray

_WEIGHT, _BIAS = "head.weight", "head.bias"


def read_last_layer(content: bytes) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return weight (1, C, 3, 3) and bias (1,) of an exported network's last layer (the paper's theta_D).

    Raises:
        ValueError: the file has no such layer.
    """
    tensors = _last_layer(onnx.load_from_string(content))
    weight, bias = (np.array(onnx.numpy_helper.to_array(tensors[name])) for name in (_WEIGHT, _BIAS))
    return weight, bias


def replace_last_layer(content: bytes, weight: NDArray[np.float32], bias: NDArray[np.float32]) -> bytes:
    """Replace the last layer of an exported network, quantised or not.

    Args:
        content: ONNX bytes from :func:`export_onnx` or :func:`monoloc.depth.training.quantise.quantise`.
        weight: (1, C, 3, 3).
        bias: (1,), log-depth.

    Raises:
        ValueError: the file has no such layer, or its shapes differ.
    """
    model = onnx.load_from_string(content)
    tensors = _last_layer(model)
    for name, value in ((_WEIGHT, weight), (_BIAS, bias)):
        if tuple(tensors[name].dims) != value.shape:
            raise ValueError(f"{name} must have shape {tuple(tensors[name].dims)}, got {value.shape}")
        tensors[name].CopyFrom(onnx.numpy_helper.from_array(np.ascontiguousarray(value, np.float32), name))
    changed: bytes = model.SerializeToString()
    return changed


def _last_layer(model: onnx.ModelProto) -> dict[str, onnx.TensorProto]:
    tensors = {tensor.name: tensor for tensor in model.graph.initializer if tensor.name in (_WEIGHT, _BIAS)}
    for name in (_WEIGHT, _BIAS):
        if name not in tensors:
            raise ValueError(f"the model has no tensor {name}")
    return tensors
