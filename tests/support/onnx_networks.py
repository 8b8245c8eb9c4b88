"""ONNX depth networks made by hand, as others export them, and their descriptions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from monoloc.depth.predictor import DepthPrediction
from monoloc.depth.spec import ModelSpec
from synthetic_room import BLUE_SPAN, NEAREST_M, RoomRecording

IMAGENET = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
PLAIN = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}
# Like MiDaS small: a fixed square, ImageNet's statistics, disparity without a scale.
MIDAS = ModelSpec(width=128, height=128, **IMAGENET, output="disparity", metric=False)
SCALE, SHIFT = 0.004, -0.3  # of that network's disparity
IMAGE = ("pixels", TensorProto.FLOAT, [1, 3, "rows", "columns"])  # an input of any size


def spec(**changes: Any) -> ModelSpec:
    return ModelSpec(**{**MIDAS.model_dump(), **changes})


def onnx_network(
    used: ModelSpec,
    scale: float = 1.0,
    shift: float = 0.0,
    pool: int = 1,
    shape: str = "1 1 h w",
    extra_output: str | None = None,
    declared: list[int | str] | None = None,
) -> bytes:
    """A network that reads depth from a room's blue channel, with an input normalised and laid out as in ``used``.

    ``scale`` and ``shift`` convert its output to depth. Nothing in it is specific to monoloc.
    """
    axes, to_nchw = [1, 3, "rows", "columns"], [0, 1, 2, 3]
    if used.layout == "nhwc":
        axes, to_nchw = [1, "rows", "columns", 3], [0, 3, 1, 2]
    weight = np.zeros((1, 3, 1, 1), dtype=np.float32)
    weight[0, 2 if used.channels == "rgb" else 0] = BLUE_SPAN * used.std[2]
    bias = np.array([np.log(NEAREST_M) + BLUE_SPAN * used.mean[2]], dtype=np.float32)
    nodes = [
        helper.make_node("Transpose", ["pixels"], ["chw"], perm=to_nchw),
        helper.make_node("AveragePool", ["chw"], ["pooled"], kernel_shape=[pool, pool], strides=[pool, pool]),
        helper.make_node("Conv", ["pooled", "weight", "bias"], ["log"], kernel_shape=[1, 1]),
    ]
    if used.output == "log-depth":
        nodes.append(helper.make_node("Sub", ["log", "log_scale"], ["image"]))
    else:
        sign = ["Neg" if used.output == "disparity" else "Identity"]
        nodes += [
            helper.make_node(sign[0], ["log"], ["signed"]),
            helper.make_node("Exp", ["signed"], ["metric"]),
            helper.make_node("Sub", ["metric", "shift"], ["shifted"]),
            helper.make_node("Div", ["shifted", "scale"], ["image"]),
        ]
    nodes.append(
        {
            "1 1 h w": helper.make_node("Identity", ["image"], ["result"]),
            "1 h w 1": helper.make_node("Transpose", ["image"], ["result"], perm=[0, 2, 3, 1]),
            "1 h w": helper.make_node("Squeeze", ["image", "axis_1"], ["result"]),
            "h w": helper.make_node("Squeeze", ["image", "axes_01"], ["result"]),
            "1 2 h w": helper.make_node("Concat", ["image", "image"], ["result"], axis=1),
            "number": helper.make_node("ReduceMean", ["image"], ["result"], keepdims=0),
            "fixed": helper.make_node("Reshape", ["image", "of_96"], ["result"]),
        }[shape]
    )
    outputs = [helper.make_tensor_value_info("result", TensorProto.FLOAT, None)]
    if extra_output is not None:
        nodes.append(helper.make_node("Log", ["std"], ["log_std"]))
        nodes.append(helper.make_node("Add", ["log", "log_std"], [extra_output]))
        outputs.append(helper.make_tensor_value_info(extra_output, TensorProto.FLOAT, None))
    constants = {
        "weight": weight,
        "bias": bias,
        "scale": np.float32(scale),
        "shift": np.float32(shift),
        "log_scale": np.float32(np.log(scale)),
        "std": np.float32(0.05),
        "axis_1": np.array([1]),
        "axes_01": np.array([0, 1]),
        "of_96": np.array([1, 1, 96, 96]),
    }
    return graph(nodes, [("pixels", TensorProto.FLOAT, declared or axes)], outputs, constants)


def graph(
    nodes: list[Any], inputs: list[tuple[str, int, list[int | str]]], outputs: list[Any], constants: dict[str, Any]
) -> bytes:
    used = {name for node in nodes for name in node.input}
    model = helper.make_model(
        helper.make_graph(
            nodes,
            "another",
            [helper.make_tensor_value_info(*entry) for entry in inputs],
            outputs,
            [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items() if name in used],
        ),
        opset_imports=[helper.make_opsetid("", 17)],
        ir_version=8,
    )
    return bytes(model.SerializeToString())


def one_node(operator: str, constant: float) -> bytes:
    """A network that combines the red channel with a constant."""
    nodes = [
        helper.make_node("Gather", ["pixels", "first"], ["red"], axis=1),
        helper.make_node(operator, ["red", "constant"], ["result"]),
    ]
    outputs = [helper.make_tensor_value_info("result", TensorProto.FLOAT, None)]
    constants = {"first": np.array([0]), "constant": np.float32(constant)}
    return graph(nodes, [("pixels", TensorProto.FLOAT, [1, 3, "rows", "columns"])], outputs, constants)


def takes(*inputs: tuple[str, int, list[int | str]]) -> bytes:
    """A network with these inputs that returns the first."""
    outputs = [helper.make_tensor_value_info("result", inputs[0][1], None)]
    return graph([helper.make_node("Identity", [inputs[0][0]], ["result"])], list(inputs), outputs, {})


def toml_of(used: ModelSpec, file: str = "another.onnx") -> str:
    """The description that a user would write."""
    lines = [f'file = "{file}"']
    for name, value in used.model_dump(exclude_unset=True, exclude_none=True).items():
        lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"


def write_network(folder: Path, used: ModelSpec, content: bytes) -> Path:
    (folder / "another.onnx").write_bytes(content)
    (folder / "another.toml").write_text(toml_of(used))
    return folder / "another.toml"


def error_at_95_percent(prediction: DepthPrediction, recording: RoomRecording, index: int) -> float:
    """95th percentile of the relative error, each pixel against the depth along its own ray."""
    camera = prediction.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    seen = np.round(recording.camera.project(camera.rays(np.stack([u, v], axis=1)))).astype(np.int64)
    u_full = np.clip(seen[:, 0], 0, recording.camera.width - 1)
    v_full = np.clip(seen[:, 1], 0, recording.camera.height - 1)
    truth = recording.depth(index)[v_full, u_full]
    return float(np.quantile(np.abs(prediction.depth_m.ravel() / truth - 1.0), 0.95))
