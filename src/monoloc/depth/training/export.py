"""Export of a network to an ONNX file for the drone's computer."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from monoloc.depth.spec import FOCAL_KEY, STRIDE, DepthModel, monoloc_spec
from monoloc.depth.training.checkpoint import NETWORK_KEY
from monoloc.depth.training.network import DepthNetwork
from monoloc.errors import MonolocError

OPSET = 17
_PARITY_LIMIT = 1e-3  # log-depth; a thousandth of the depth


@dataclass(frozen=True)
class ExportReport:
    """Size of the exported file, and largest and mean difference from PyTorch's output in log-depth."""

    bytes: int
    parity_max: float
    parity_mean: float


def export_onnx(network: DepthNetwork) -> tuple[bytes, ExportReport]:
    """Export a network to ONNX bytes for any image size in multiples of 32, and check it against PyTorch.

    Input ``image`` (1, 3, H, W) float32 in [-1, 1]; output ``log_depth`` (1, 1, H/4, W/4) and, if the network has it,
    ``log_error_scale`` of the same shape. Tensors keep their names; the settings are stored as metadata.

    Raises:
        MonolocError: the exported network does not reproduce the original.
    """
    network = network.eval().to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    outputs = ["log_depth"] + (["log_error_scale"] if network.config.uncertainty else [])
    buffer = io.BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        # The tracing exporter keeps the graph small; its warnings do not help a user.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _AllOutputs(network),
            (torch.zeros(1, 3, 4 * STRIDE, 5 * STRIDE),),
            cast(Any, buffer),  # a file object works, despite the annotation
            input_names=["image"],
            output_names=outputs,
            dynamic_axes={"image": {2: "height", 3: "width"}} | {name: {2: "rows", 3: "columns"} for name in outputs},
            opset_version=OPSET,
            dynamo=False,
            # Keep batch normalisation, so that the file can be tuned; the runtime folds it.
            training=torch.onnx.TrainingMode.PRESERVE,
            do_constant_folding=False,
        )
    model = onnx.load_from_string(buffer.getvalue())
    for tensor in model.graph.initializer:
        tensor.name = tensor.name.removeprefix(_PREFIX)
    for node in model.graph.node:
        node.input[:] = [name.removeprefix(_PREFIX) for name in node.input]
        node.name = node.name.replace("/" + _PREFIX.rstrip("."), "")
    model.metadata_props.add(key=FOCAL_KEY, value=repr(network.config.focal_px))
    model.metadata_props.add(key=NETWORK_KEY, value=network.config.model_dump_json())
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    worst, mean = _parity(network, content)
    if worst > _PARITY_LIMIT:
        raise MonolocError(f"the exported network differs from the original by {worst:.2e} in log-depth; not written")
    return content, ExportReport(len(content), worst, mean)


def export_model(network: DepthNetwork, name: str) -> DepthModel:
    """Export a network as a :class:`DepthModel` for the runtime.

    Raises:
        MonolocError: as :func:`export_onnx`.
    """
    return DepthModel(export_onnx(network)[0], monoloc_spec(network.config.focal_px), name)


_PREFIX = "network."  # prefix that the wrapper adds to every tensor's name


class _AllOutputs(nn.Module):
    def __init__(self, network: DepthNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        log_depth, log_error_scale = self.network.with_error(images)
        return log_depth if log_error_scale is None else (log_depth, log_error_scale)


def _parity(network: DepthNetwork, content: bytes) -> tuple[float, float]:
    """Largest and mean difference from PyTorch over random images of two sizes, in log-depth."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(0)
    differences = []
    for height, width in ((4 * STRIDE, 5 * STRIDE), (3 * STRIDE, 7 * STRIDE)):
        image = torch.rand(1, 3, height, width, generator=generator) * 2.0 - 1.0
        with torch.no_grad():
            expected = network.with_error(image)
        for ours, theirs in zip(expected, session.run(None, {"image": image.numpy()}), strict=False):
            assert ours is not None
            differences.append(np.abs(theirs - ours.numpy()).ravel())
    errors = np.concatenate(differences)
    return float(errors.max()), float(errors.mean())
