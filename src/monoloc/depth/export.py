"""A network as an ONNX file that the drone's machine can run."""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import onnx
import onnxruntime
import torch

from monoloc.depth.network import DepthNetwork
from monoloc.depth.runtime import FOCAL_KEY, STRIDE
from monoloc.errors import MonolocError

OPSET = 17
_PARITY_LIMIT = 1e-3  # log-depth; a thousandth of the depth


@dataclass(frozen=True)
class ExportReport:
    """Size of the exported file and how far its output is from the network's, in log-depth."""

    bytes: int
    parity_max: float
    parity_mean: float


def export_onnx(network: DepthNetwork) -> tuple[bytes, ExportReport]:
    """The network as ONNX bytes, any image size in multiples of 32, checked against PyTorch.

    Input ``image`` (1, 3, H, W) float32 in [-1, 1], output ``log_depth`` (1, 1, H/4, W/4). The canonical focal
    length travels as metadata.

    Raises:
        MonolocError: the exported network does not reproduce the original.
    """
    network = network.eval().to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    example = torch.zeros(1, 3, 4 * STRIDE, 5 * STRIDE)
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        # The tracing exporter keeps the graph small; its remarks are of no use to a person.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (example,),
            cast(Any, buffer),  # a file object is taken, whatever the annotation says
            input_names=["image"],
            output_names=["log_depth"],
            dynamic_axes={"image": {2: "height", 3: "width"}, "log_depth": {2: "rows", 3: "columns"}},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load_from_string(buffer.getvalue())
    model.metadata_props.add(key=FOCAL_KEY, value=repr(network.config.focal_px))
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    worst, mean = _parity(network, content)
    if worst > _PARITY_LIMIT:
        raise MonolocError(f"the exported network differs from the original by {worst:.2e} in log-depth; not written")
    return content, ExportReport(len(content), worst, mean)


def _parity(network: DepthNetwork, content: bytes) -> tuple[float, float]:
    """Largest and mean difference over random images of two sizes."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    generator = torch.Generator().manual_seed(0)
    differences = []
    for height, width in ((4 * STRIDE, 5 * STRIDE), (3 * STRIDE, 7 * STRIDE)):
        image = torch.rand(1, 3, height, width, generator=generator) * 2.0 - 1.0
        with torch.no_grad():
            expected = network(image).numpy()
        differences.append(np.abs(session.run(None, {"image": image.numpy()})[0] - expected).ravel())
    joined = np.concatenate(differences)
    return float(joined.max()), float(joined.mean())
