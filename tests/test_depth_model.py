"""Networks that monoloc did not make: fed as their TOML says, read as it says, and brought to metres."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from pydantic import ValidationError

from cli_helpers import json_of
from monoloc.bundle import read_bundle, read_network
from monoloc.camera import Camera
from monoloc.cli.main import invoke
from monoloc.depth.model_files import read_model
from monoloc.depth.models import DEFAULT, shipped_file
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.scale_fit import fit_to_depth, fitted_spec
from monoloc.depth.spec import DepthModel, ModelSpec
from monoloc.errors import BundleError, DataError, MonolocError, SettingError
from synthetic_recordings import write_depth
from synthetic_room import (
    BLUE_SPAN,
    CAMERA,
    NEAREST_M,
    SMALL_CAMERA,
    Room,
    RoomRecording,
    depth_from_blue,
    make_path,
    write_recording,
)

IMAGENET = {"mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
PLAIN = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}
# As MiDaS small: a fixed square, ImageNet's statistics, disparity without a scale.
MIDAS = ModelSpec(width=128, height=128, **IMAGENET, output="disparity", metric=False)
SCALE, SHIFT = 0.004, -0.3  # of that network's disparity


def spec(**changes: Any) -> ModelSpec:
    return ModelSpec(**{**MIDAS.model_dump(), **changes})


# --- Networks made by hand ---


def network(
    used: ModelSpec,
    scale: float = 1.0,
    shift: float = 0.0,
    pool: int = 1,
    shape: str = "1 1 h w",
    extra_output: str | None = None,
    declared: list[int | str] | None = None,
) -> bytes:
    """A graph that reads the depth in a room's blue channel, out of an input normalised and laid out as ``used``.

    Its output is that of which ``scale`` and ``shift`` give depth again. Nothing in it is monoloc's.
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
    """A graph that combines the red channel with a constant, and gives that."""
    nodes = [
        helper.make_node("Gather", ["pixels", "first"], ["red"], axis=1),
        helper.make_node(operator, ["red", "constant"], ["result"]),
    ]
    outputs = [helper.make_tensor_value_info("result", TensorProto.FLOAT, None)]
    constants = {"first": np.array([0]), "constant": np.float32(constant)}
    return graph(nodes, [("pixels", TensorProto.FLOAT, [1, 3, "rows", "columns"])], outputs, constants)


def takes(*inputs: tuple[str, int, list[int | str]]) -> bytes:
    """A graph with these inputs that gives back the first."""
    outputs = [helper.make_tensor_value_info("result", inputs[0][1], None)]
    return graph([helper.make_node("Identity", [inputs[0][0]], ["result"])], list(inputs), outputs, {})


def toml_of(used: ModelSpec, file: str = "another.onnx") -> str:
    """The description a person would write."""
    lines = [f'file = "{file}"']
    for name, value in used.model_dump(exclude_unset=True, exclude_none=True).items():
        lines.append(f"{name} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"


def write_network(folder: Path, used: ModelSpec, content: bytes) -> Path:
    (folder / "another.onnx").write_bytes(content)
    (folder / "another.toml").write_text(toml_of(used))
    return folder / "another.toml"


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(6))


def worst_of_most(prediction: DepthPrediction, recording: RoomRecording, index: int) -> float:
    """The relative error that 95 % of the pixels stay under, each against the depth along its own ray."""
    camera = prediction.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    seen = np.round(recording.camera.project(camera.rays(np.stack([u, v], axis=1)))).astype(np.int64)
    u_full = np.clip(seen[:, 0], 0, recording.camera.width - 1)
    v_full = np.clip(seen[:, 1], 0, recording.camera.height - 1)
    truth = recording.depth(index)[v_full, u_full]
    return float(np.quantile(np.abs(prediction.depth_m.ravel() / truth - 1.0), 0.95))


# --- Fed and read as the description says ---


@pytest.mark.parametrize("output", ["depth", "log-depth", "disparity"])
@pytest.mark.parametrize("channels", ["rgb", "bgr"])
@pytest.mark.parametrize("layout", ["nchw", "nhwc"])
@pytest.mark.parametrize("normalisation", [IMAGENET, PLAIN], ids=["imagenet", "plain"])
def test_depth_of_any_kind_of_network(recording, output, channels, layout, normalisation):
    scale, shift = (2.0, 0.0) if output == "log-depth" else (0.01, -0.2)
    used = spec(output=output, channels=channels, layout=layout, scale=scale, shift=shift, **normalisation)
    predictor = DepthPredictor(DepthModel(network(used, scale, shift), used), recording.camera)
    # One step of 8 bits is 1.3 % of depth; the rest is edges.
    assert worst_of_most(predictor(recording.color(0)), recording, 0) < 0.03


@pytest.mark.parametrize("wrong", [{"channels": "bgr"}, {"mean": (0.4, 0.4, 0.2)}, {"output": "log-depth"}])
def test_a_wrong_description_gives_wrong_depth(recording, wrong):
    """The tests above can fail."""
    content, used = network(spec(scale=1.0), 1.0), spec(scale=1.0, **wrong)
    prediction = DepthPredictor(DepthModel(content, used), recording.camera)(recording.color(0))
    assert not worst_of_most(prediction, recording, 0) < 0.1


@pytest.mark.parametrize("shape", ["1 1 h w", "1 h w 1", "1 h w", "h w"])
@pytest.mark.parametrize("size", [(128, 128), (64, 192), (320, 256)])
@pytest.mark.parametrize("pool", [1, 2])
def test_any_size_and_shape_of_output(recording, shape, size, pool):
    """Stretched images too: the depth image's camera knows."""
    used = spec(width=size[0], height=size[1], scale=1.0)
    predictor = DepthPredictor(DepthModel(network(used, pool=pool, shape=shape), used), recording.camera)
    prediction = predictor(recording.color(1))
    assert prediction.camera == predictor.output_camera
    assert prediction.depth_m.shape == (prediction.camera.height, prediction.camera.width)
    assert prediction.depth_m.dtype == np.float32
    assert prediction.log_error is None
    assert worst_of_most(prediction, recording, 1) < 0.05


@given(
    st.integers(64, 200),
    st.integers(64, 200),
    st.floats(100.0, 600.0),
    st.floats(100.0, 600.0),
    st.floats(-0.3, 0.3),
)
@settings(max_examples=20, deadline=None)
def test_rays_of_stretched_depth_are_the_cameras(width, height, fx, fy, off_centre):
    """Output pixel (i, j) covers a block of the image, whose middle has the same ray."""
    camera = Camera(640, 360, fx, fy, 640 * (0.5 + off_centre), 360 * (0.5 - off_centre))
    used = spec(width=width, height=height, scale=1.0)
    out = DepthPredictor(DepthModel(network(used), used), camera).output_camera
    pixels = np.array([[0.0, 0.0], [out.width - 1, 0], [3, 7], [out.width - 1, out.height - 1]])
    in_image = (pixels + 0.5) * np.array([640 / out.width, 360 / out.height]) - 0.5
    np.testing.assert_allclose(out.rays(pixels), camera.rays(in_image), atol=1e-9)


@pytest.mark.parametrize("focal_px", [100.0, 136.0, 170.0])
@pytest.mark.parametrize("stride", [14, 32])
def test_canonical_depth_of_another_network(recording, focal_px, stride):
    """With ``focal_px`` the network's depth is that of such a camera, times the ratio of the focal lengths."""
    used = spec(width=None, height=None, focal_px=focal_px, stride=stride, output="depth", scale=1.0)
    predictor = DepthPredictor(DepthModel(network(used), used), recording.camera)
    assert predictor.input_camera.width % stride == predictor.input_camera.height % stride == 0
    ratio = predictor.input_camera.focal_px / focal_px
    assert abs(np.log(ratio)) < 0.5 * stride / min(predictor.input_camera.width, predictor.input_camera.height) + 1e-9
    prediction = predictor(recording.color(0))
    stretched = DepthPrediction(prediction.depth_m / np.float32(ratio), prediction.camera)
    assert worst_of_most(stretched, recording, 0) < 0.03


def test_large_output_is_picked_from_not_averaged(recording):
    used = spec(width=320, height=256, scale=1.0)
    model = DepthModel(network(used), used)
    prediction = DepthPredictor(model, recording.camera)(recording.color(0))
    assert prediction.depth_m.size <= 128 * 96 * 1.02 and prediction.depth_m.size > 0.9 * 128 * 96
    blue = np.unique(recording.color(0)[..., 2]).astype(np.float64)
    possible = NEAREST_M * np.exp(BLUE_SPAN * blue / 255.0)
    nearest = possible[np.abs(np.log(prediction.depth_m[..., None] / possible)).argmin(axis=-1)]
    np.testing.assert_allclose(prediction.depth_m, nearest, rtol=1e-4)


def test_images_are_enlarged_smoothly():
    """A network larger than the image sees slopes, not blocks."""
    camera = Camera(64, 64, 60.0, 60.0, 31.5, 31.5)
    ramp = np.repeat(np.repeat(np.arange(0, 256, 4, dtype=np.uint8)[None], 64, axis=0)[..., None], 3, axis=2)
    used = spec(width=192, height=192, **PLAIN, output="depth", scale=1.0)
    raw = DepthPredictor(DepthModel(one_node("Add", 1.0), used), camera).raw(ramp)
    steps = np.diff(raw[50, 5:-5])
    assert steps.min() > 0.0 and steps.max() < 3.0 * steps.mean()


@pytest.mark.parametrize("pool", [1, 4])
def test_stated_error_comes_with_the_depth(recording, pool):
    used = spec(output="log-depth", scale=1.0, width=192, height=160)
    content = network(used, pool=pool, extra_output="log_error_scale")
    prediction = DepthPredictor(DepthModel(content, used), recording.camera)(recording.color(0))
    assert prediction.log_error is not None and prediction.log_error.shape == prediction.depth_m.shape
    # This network says that it is off by a twentieth of the depth.
    np.testing.assert_allclose(prediction.log_error, np.log(0.05 * prediction.depth_m), atol=1e-4)
    other = network(used, pool=pool, extra_output="features")
    assert DepthPredictor(DepthModel(other, used), recording.camera)(recording.color(0)).log_error is None


def test_what_is_no_depth_is_zero():
    """Negative, infinite, NaN and absurd values of a network are pixels without depth."""
    color = np.full((64, 64, 3), 100, dtype=np.uint8)
    color[:, :16, 0], color[:, 16:32, 0], color[:, 32:48, 0] = 0, 50, 51
    used = spec(width=64, height=64, mean=(50.0 / 255.0,) * 3, std=(1.0 / 255.0,) * 3, output="disparity", scale=1.0)
    camera = Camera(64, 64, 60.0, 60.0, 31.5, 31.5)
    row = DepthPredictor(DepthModel(one_node("Mul", 0.02), used), camera)(color).depth_m[10]
    assert set(row[:31]) == {np.float32(0.0)}  # -1 and 0 of disparity
    np.testing.assert_allclose(row[33:47], 50.0, rtol=1e-4)
    assert np.all(DepthPredictor(DepthModel(one_node("Mul", 1e-4), used), camera)(color).depth_m == 0.0)  # 200 m
    rooted = DepthModel(one_node("Pow", 0.5), used)  # of negative numbers: NaN
    row = DepthPredictor(rooted, camera)(color).depth_m[10]
    assert set(row[:15]) == {np.float32(0.0)}
    np.testing.assert_allclose(row[33:47], 1.0, rtol=1e-4)


def test_interpolated_depth_does_not_mix_with_none():
    depth = np.full((8, 8), 2.0, dtype=np.float32)
    depth[2:4, 2:4] = 0.0
    large = DepthPrediction(depth, CAMERA.resized(8, 8)).resized(64, 48)
    assert large.shape == (48, 64)
    assert np.all((large == 0.0) | (np.abs(large - 2.0) < 1e-6))
    assert np.all(large[13:23, 18:30] == 0.0) and np.all(large[:11] > 0.0) and np.all(large[25:] > 0.0)


def test_a_frame_of_nan_is_a_frame_without_depth():
    """A drone does not stop for one image; a network that gives nothing else is refused before the start."""
    camera = Camera(64, 64, 60.0, 60.0, 31.5, 31.5)
    used = spec(width=64, height=64, **PLAIN, output="depth", scale=1.0)
    predictor = DepthPredictor(DepthModel(one_node("Pow", -0.5), used), camera)  # of black: infinite
    assert np.all(predictor(np.zeros((64, 64, 3), dtype=np.uint8)).depth_m == 0.0)


# --- Scale and shift ---


def depths(count: int, seed: int) -> NDArray[np.float32]:
    return np.exp(np.random.default_rng(seed).uniform(np.log(0.5), np.log(6.0), count)).astype(np.float32)


@given(
    st.sampled_from(["depth", "disparity"]),
    st.floats(-3.0, 3.0).map(lambda power: 10.0**power),
    st.floats(-2.0, 2.0),
    st.floats(0.0, 0.3),
    st.integers(0, 100),
)
@settings(max_examples=60, deadline=None)
def test_scale_and_shift_are_found_again(output, scale, shift, wrong_share, seed):
    """Under noise of 5 %, and with up to three pixels in ten wrong."""
    rng = np.random.default_rng(seed)
    truth = depths(3000, seed)
    seen = truth * np.exp(rng.normal(0.0, 0.05, len(truth)))
    wrong = rng.uniform(size=len(truth)) < wrong_share
    seen[wrong] = depths(int(wrong.sum()), seed + 1)
    raw = ((1.0 / seen if output == "disparity" else seen) - shift) / scale
    fitted = fitted_spec(spec(output=output), raw.astype(np.float32), truth, "another")
    predicted = fitted.depth(((1.0 / truth if output == "disparity" else truth) - shift).astype(np.float32) / scale)
    np.testing.assert_allclose(predicted, truth, rtol=0.06)
    if wrong_share == 0.0:
        assert fitted.scale == pytest.approx(scale, rel=0.03)
        assert fitted.shift == pytest.approx(shift, abs=0.05)


@given(
    st.sampled_from(["depth", "disparity", "log-depth"]),
    st.booleans(),
    st.floats(-2.0, 2.0).map(lambda power: 10.0**power),
    st.floats(0.0, 0.4),
    st.integers(0, 100),
)
@settings(max_examples=60, deadline=None)
def test_a_metric_network_has_its_scale_found_again(output, metric, scale, wrong_share, seed):
    """A relative log-depth network too: its shift is a scale."""
    metric = metric or output != "log-depth"
    rng = np.random.default_rng(seed)
    truth = depths(3000, seed)
    raw = {"depth": truth / scale, "disparity": 1.0 / (truth * scale), "log-depth": np.log(truth / scale)}[output]
    raw = raw.astype(np.float32)
    raw[rng.uniform(size=len(raw)) < 0.5 * wrong_share] = raw.max()
    raw[rng.uniform(size=len(raw)) < 0.5 * wrong_share] = raw.min()
    fitted = fitted_spec(spec(output=output, metric=metric), raw, truth, "another")
    assert fitted.scale == pytest.approx(scale, rel=0.02) and fitted.shift == 0.0
    assert fitted.is_usable


def test_fit_on_frames(recording):
    """Through images and rays, canonical depth and holes of the truth, with the room's depth where there are none."""
    used = spec(width=None, height=None, focal_px=120.0)
    model = DepthModel(network(used, SCALE, SHIFT), used, "another")

    def with_holes(index: int) -> NDArray[np.float32]:
        depth = recording.depth(index).copy()
        depth[:, : 40 * index] = 0.0
        depth[0] = np.nan
        return depth

    done: list[int] = []
    fitted = fit_to_depth(model, recording, with_holes, done.append)
    assert done == list(range(1, 7))
    assert fitted.content == model.content and fitted.name == "another"
    prediction = DepthPredictor(fitted, recording.camera)(recording.color(3))
    assert worst_of_most(prediction, recording, 3) < 0.03


def run_against(output: str, metric: bool) -> None:
    truth = depths(1000, 0)
    raw = truth if output == "disparity" else 1.0 / truth
    fitted_spec(spec(output=output, metric=metric), raw, truth, "another")


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        (
            lambda: run_against("depth", False),
            r'do not grow with depth \(fitted scale -.*\); write output = "disparity"',
        ),
        (lambda: run_against("disparity", False), r'do not grow with disparity \(.*\); write output = "depth"'),
        (lambda: run_against("depth", True), r"do not grow with depth \(correlation -1.00\)"),
        (lambda: run_against("disparity", True), r"do not grow with disparity \(correlation -1.00\)"),
        (lambda: fitted_spec(MIDAS, np.full(500, 3.0), depths(500, 0), "another"), "gives the same value everywhere"),
        (
            lambda: fitted_spec(MIDAS, depths(9, 0), depths(9, 0), "another"),
            "a value at only 9 pixels of known depth",
        ),
        (lambda: fitted_spec(MIDAS, np.full(500, np.nan), depths(500, 0), "another"), "a value at only 0 pixels"),
        (
            lambda: fitted_spec(
                spec(output="depth", metric=True), np.linspace(-9, 1, 500), depths(500, 0), "another"
            ),
            "positive depth at only 10% of the pixels; check output",
        ),
    ],
)
def test_what_cannot_be_fitted(fit: Callable[[], object], message: str):
    says(fit, DataError, "another: .*" + message)


# --- Read from disk ---


def says(action: Callable[[], object], kind: type[MonolocError], pattern: str) -> None:
    """The action is refused in one line: what, its fault, the fix."""
    with pytest.raises(kind, match=pattern) as caught:
        action()
    assert "\n" not in str(caught.value) and "; " in str(caught.value)


def test_a_description_and_its_network(tmp_path):
    used = spec(scale=SCALE, shift=SHIFT, channels="bgr", layout="nhwc")
    content = network(used, SCALE, SHIFT)
    model = read_model(write_network(tmp_path, used, content))
    assert model == DepthModel(content, used, "another")


def test_the_description_in_the_documents_is_one(tmp_path):
    text = (Path(__file__).parents[1] / "docs" / "depth-models.md").read_text()
    toml = text.split("```toml\n")[1].split("```")[0]
    (tmp_path / "midas.toml").write_text(toml)
    used = spec(width=256, height=256)
    (tmp_path / "midas-small.onnx").write_bytes(network(used))
    assert read_model(tmp_path / "midas.toml") == DepthModel(network(used), used, "midas")
    for field in (*ModelSpec.model_fields, "file"):
        assert f"`{field}`" in text, field


def test_our_own_networks_describe_themselves(tmp_path):
    (tmp_path / "mine.onnx").write_bytes(depth_from_blue().content)
    mine = read_model(tmp_path / "mine.onnx")
    assert mine.content == depth_from_blue().content and mine.spec == depth_from_blue().spec and mine.name == "mine"
    shipped = read_model(DEFAULT)
    assert shipped == DepthModel(shipped_file(DEFAULT).read_bytes(), shipped.spec, DEFAULT)
    assert shipped.spec.focal_px == 136.0 and shipped.spec.is_usable


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("mean", "meen"), "mean: Field required"),
        (lambda text: text + "colour = 3\n", "colour: Extra inputs are not permitted"),
        (lambda text: text + "focal_px = 136\n", "focal_px: Give either width and height, or focal_px"),
        (lambda text: text.replace("width = 128\n", ""), "height: Width and height go together"),
        (
            lambda text: text.replace("width = 128\n", "").replace("height = 128\n", ""),
            "focal_px: Give either width and height, or focal_px",
        ),
        (lambda text: text.replace("width = 128", "width = 32"), "width: .*greater than or equal to 64"),
        (lambda text: text.replace("0.229", "0.0"), "std.0: .*greater than 0"),
        (lambda text: text.replace("0.485", "nan"), "mean.0: .*finite"),
        (lambda text: text.replace('"disparity"', '"depths"'), "output: .*'depth', 'log-depth' or 'disparity'"),
        (lambda text: text + "shift = 1.0\n", "shift: Give scale as well"),
        (
            lambda text: text.replace('"disparity"', '"log-depth"') + "scale = 2\nshift = 1\n",
            "shift: Log-depth has a scale only",
        ),
        (lambda text: text + "scale = -2\n", "scale: .*greater than 0"),
        (lambda text: "width 3\n", "is not TOML"),
        (lambda text: text.replace("another.onnx", "no.onnx"), "file: .*no.onnx cannot be read; name the ONNX file"),
    ],
)
def test_a_description_that_is_wrong(tmp_path, change, message):
    path = write_network(tmp_path, MIDAS, network(MIDAS))
    path.write_text(change(path.read_text()))
    says(lambda: read_model(path), DataError, rf"another\.toml: {message}")


@pytest.mark.parametrize("damage", ["empty", "text", "cut short"])
def test_a_file_that_is_no_network(tmp_path, damage):
    content = network(MIDAS)
    damaged = {"empty": b"", "text": b"not a network", "cut short": content[:-60]}[damage]
    path = write_network(tmp_path, MIDAS, damaged)
    for file in (path, tmp_path / "another.onnx"):
        says(lambda file=file: read_model(file), DataError, r"another\.onnx: cannot be loaded \(.*\); give one self-")
    model = DepthModel(damaged, MIDAS, "another")
    says(lambda: DepthPredictor(model, CAMERA), DataError, r"another: cannot be loaded \(.*\); give one self-")


def test_an_onnx_that_nothing_describes(tmp_path):
    write_network(tmp_path, MIDAS, network(MIDAS))
    message = (
        r"another\.onnx: was not exported by monoloc.*; write a TOML with file, width and height .*output and met"
    )
    says(lambda: read_model(tmp_path / "another.onnx"), DataError, message)


def test_an_onnx_of_ours_whose_focal_length_is_none(tmp_path):
    model = onnx.load_from_string(depth_from_blue().content)
    for value in ("wide", "-1.0", "nan"):
        model.metadata_props[0].value = value
        (tmp_path / "depth.onnx").write_bytes(model.SerializeToString())
        message = rf"depth\.onnx: has metadata monoloc_focal_px = {value}, which is no focal"
        says(lambda: read_model(tmp_path / "depth.onnx"), DataError, message)


def test_networks_that_are_not_there(tmp_path):
    says(lambda: read_model(tmp_path / "no.toml"), DataError, r"no\.toml: does not exist; give a .*full-0.35")
    says(lambda: read_model("fulll"), DataError, r"fulll: does not exist; give a .*full-0.35")
    says(lambda: read_network(tmp_path), BundleError, "is not a bundle")


IMAGE = ("pixels", TensorProto.FLOAT, [1, 3, "rows", "columns"])


@pytest.mark.parametrize(
    ("content", "changes", "message"),
    [
        (
            takes(IMAGE, ("size", TensorProto.INT64, [2])),
            {},
            r"has 2 inputs \(pixels, size\); export it with the image",
        ),
        (takes(("pixels", TensorProto.FLOAT, [3, 128, 128])), {}, r"takes tensor\(float\) of 3 axes; export it with"),
        (takes(("pixels", TensorProto.UINT8, [1, 3, 128, 128])), {}, r"takes tensor\(uint8\) of 4 axes; export it"),
        (
            network(MIDAS, declared=[1, 3, 256, 256]),
            {},
            "takes 1 x 3 x 256 x 256, not 1 x 3 x 128 x 128; correct width",
        ),
        (network(MIDAS, declared=[2, 3, "h", "w"]), {}, "takes 2 x 3 x any x any, not 1 x 3 x 128 x 128"),
        (network(MIDAS), {"layout": "nhwc"}, "takes 1 x 3 x any x any, not 1 x 128 x 128 x 3; correct .*layout"),
        (
            network(MIDAS, declared=[1, 3, 256, 256]),
            {"width": None, "height": None, "focal_px": 136.0},
            "takes 1 x 3 x 256 x 256, not images of any size; give width and height",
        ),
    ],
)
def test_a_network_that_takes_something_else(tmp_path, content, changes, message):
    path = write_network(tmp_path, spec(**changes), content)
    path.write_text(toml_of(ModelSpec(**{k: v for k, v in spec(**changes).model_dump().items() if v is not None})))
    says(lambda: read_model(path), DataError, rf"another\.toml: {message}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (network(MIDAS, shape="1 2 h w"), "gives 2 x 128 x 128, which is no depth image; its first output must be"),
        (network(MIDAS, shape="number"), "gives one number, which is no depth image"),
        (network(MIDAS, shape="fixed"), r"cannot be run on images of 128x128 \(.*\); correct width and height"),
        (one_node("Mul", float("nan")), "gives NaN for every pixel; check the file"),
    ],
)
def test_a_network_that_gives_something_else(capfd, content, message):
    model = DepthModel(content, spec(scale=1.0), "another")
    says(lambda: DepthPredictor(model, CAMERA), DataError, "another: " + message)
    out, err = capfd.readouterr()
    assert out == err == ""  # onnxruntime does not speak beside us


def test_stated_error_of_another_size():
    used = spec(output="log-depth", scale=1.0)
    nodes = [
        helper.make_node("Identity", ["pixels"], ["all"]),
        helper.make_node("Gather", ["all", "first"], ["result"], axis=1),
        helper.make_node("AveragePool", ["result"], ["log_error_scale"], kernel_shape=[2, 2], strides=[2, 2]),
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("result", "log_error_scale")]
    content = graph(nodes, [IMAGE], outputs, {"first": np.array([0])})
    model = DepthModel(content, used, "another")
    says(
        lambda: DepthPredictor(model, CAMERA), DataError, "another: gives log_error_scale of another size than depth"
    )


def test_a_pixel_whose_stated_error_is_nan_has_no_depth():
    used = spec(width=64, height=64, mean=(0.0,) * 3, std=(1.0 / 255.0,) * 3, output="depth", scale=1.0)
    nodes = [
        helper.make_node("Identity", ["pixels"], ["all"]),
        helper.make_node("Gather", ["all", "first"], ["result"], axis=1),
        helper.make_node("Sub", ["result", "fifty"], ["beyond"]),
        helper.make_node("Log", ["beyond"], ["log_error_scale"]),
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("result", "log_error_scale")]
    content = graph(nodes, [IMAGE], outputs, {"first": np.array([0]), "fifty": np.float32(50.0)})
    color = np.full((64, 64, 3), 40, dtype=np.uint8)  # ten under where the logarithm begins
    color[:, 32:] = 60
    prediction = DepthPredictor(DepthModel(content, used), Camera(64, 64, 60.0, 60.0, 31.5, 31.5))(color)
    np.testing.assert_allclose(prediction.depth_m[:, 32:], 60.0, rtol=1e-4)
    assert np.all(prediction.depth_m[:, :32] == 0.0)


def test_relative_depth_is_not_taken_for_metric(recording):
    predictor = DepthPredictor(DepthModel(network(MIDAS), MIDAS, "another"), recording.camera)
    says(lambda: predictor(recording.color(0)), DataError, "another: gives relative depth.*; fit it by monoloc build")
    metric = spec(metric=True)
    prediction = DepthPredictor(DepthModel(network(metric), metric), recording.camera)(recording.color(0))
    assert worst_of_most(prediction, recording, 0) < 0.03


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (Camera(640, 24, 500.0, 500.0, 320.0, 12.0), "has images of 640x24; give at least 32 pixels a side"),
        (
            Camera(640, 480, 5000.0, 5000.0, 320.0, 240.0),
            "focal length of 5000 px, for blue 32x32; check the intrinsics",
        ),
        # The network's image would take all memory.
        (
            Camera(640, 480, 0.82, 1.09, 320.0, 240.0),
            "length of 0.945 px for images of 640x480; give it in pixels",
        ),
        (Camera(640, 480, 1e-320, 1e-320, 320.0, 240.0), "length of 0 px for images of 640x480; give it in pixels"),
    ],
)
def test_images_in_which_nothing_can_be_seen(camera, message):
    says(lambda: DepthPredictor(depth_from_blue(), camera), SettingError, f"camera: .*{message}")


def test_sizes_of_a_spec_are_checked_from_python_too():
    with pytest.raises(ValidationError, match="focal_px"):
        ModelSpec(**PLAIN, output="depth", metric=True)


# --- On the command line ---


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A working folder with a recording ``walk`` and another's network, ``another.toml``."""
    write_recording(tmp_path / "walk", RoomRecording(Room(), make_path(12), SMALL_CAMERA))
    write_network(tmp_path, MIDAS, network(MIDAS, SCALE, SHIFT))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(capfd, *arguments: str) -> tuple[int, str, str]:
    capfd.readouterr()
    code = invoke(list(arguments))
    return code, *capfd.readouterr()


BUILD = ("build", "walk", "--out", "x.monoloc", "-k", "120", "--network")


def test_build_and_localise_with_another_network(capfd, here):
    report = json_of(capfd, *BUILD, "another.toml")
    assert report["depth_scale"] == pytest.approx(SCALE, rel=0.03)
    assert report["depth_shift"] == pytest.approx(SHIFT, abs=0.02)
    assert report["steps"] == 0
    bundle = read_bundle(here / "x.monoloc")
    assert bundle.provenance.tune == "none" and not bundle.provenance.map_transform
    assert bundle.depth_model.spec == MIDAS.model_copy(
        update={"scale": report["depth_scale"], "shift": report["depth_shift"]}
    )
    metrics = json_of(capfd, "localize", "x.monoloc", "walk")
    assert metrics["depth_absrel"] < 0.03
    assert metrics["ate_max_m"] < 0.15 and metrics["ate_median_m"] < 0.08
    inspected = json_of(capfd, "inspect", "x.monoloc")
    assert inspected["network"] == "another"
    assert inspected["network_spec"]["output"] == "disparity"
    assert inspected["network_spec"]["scale"] == report["depth_scale"]
    # The bundle's network is one of the networks that can be run, and needs no fit any more.
    again = json_of(capfd, "build", "walk", "--out", "y.monoloc", "-k", "40", "--network", "x.monoloc")
    assert again["depth_scale"] is None
    assert read_bundle(here / "y.monoloc").depth_model == bundle.depth_model


def test_build_says_what_it_fitted(capfd, here):
    code, _, err = run(capfd, *BUILD, "another.toml")
    assert code == 0
    said = " ".join(err.split())
    assert "another.toml is used as it is, with scale 0.00" in said and " and shift -0." in said


def test_a_cloud_serves_where_there_is_no_sensor_depth(capfd, here):
    toml = (here / "walk" / "dataset.toml").read_text()
    (here / "walk" / "dataset.toml").write_text(toml.replace('depth = "depth/{index:06d}.png"\n', ""))
    np.savez(here / "room.npz", points=Room().cloud(0.03))
    report = json_of(capfd, *BUILD, "another.toml", "--cloud", "room.npz")
    assert report["depth_scale"] == pytest.approx(SCALE, rel=0.1)
    assert report["depth_shift"] == pytest.approx(SHIFT, abs=0.05)


def test_our_own_network_is_run_as_it_is(capfd, here):
    """Its depth is metric, and the filter knows how far that is to be trusted."""
    (here / "mine.onnx").write_bytes(depth_from_blue().content)
    report = json_of(capfd, *BUILD, "mine.onnx", "--tune", "none", "--no-map-transform")
    assert report["depth_scale"] is None and report["depth_shift"] is None
    assert read_bundle(here / "x.monoloc").depth_model == DepthModel(
        depth_from_blue().content, depth_from_blue().spec, "mine"
    )


@pytest.mark.parametrize(
    ("options", "field", "problem"),
    [
        (("--tune", "last"), "--tune", "is last"),
        (("--tune", "decoder", "--no-map-transform"), "--tune", "is decoder"),
        (("--map-transform",), "--map-transform", "is on"),
        (("--settings", "decoder.toml"), "adapt.tune", "is decoder"),
    ],
)
def test_another_network_is_not_tuned(capfd, here, options, field, problem):
    (here / "decoder.toml").write_text('[adapt]\ntune = "decoder"\n')
    code, out, err = run(capfd, *BUILD, "another.toml", *options)
    assert code == 2 and out == "" and err.count("\n") == 1
    assert f"{field}: {problem}, but another.toml can only be run, not tuned; give --tune none" in err
    assert not (here / "x.monoloc").exists()


def test_build_refuses_a_wrong_network_before_the_work(capfd, here):
    for content, message in (
        (network(MIDAS, shape="1 2 h w"), "another: gives 2 x 128 x 128"),
        (network(MIDAS, declared=[1, 3, 64, 64]), "another.toml: takes 1 x 3 x 64 x 64"),
        (b"", "another.onnx: cannot be loaded"),
    ):
        (here / "another.onnx").write_bytes(content)
        code, out, err = run(capfd, *BUILD, "another.toml")
        assert code == 2 and out == "" and err.count("\n") == 1 and message in err, err
    code, _, err = run(capfd, *BUILD, "another.onnx")
    assert code == 2 and "another.onnx: cannot be loaded" in err
    (here / "another.onnx").write_bytes(network(MIDAS))
    code, _, err = run(capfd, *BUILD, "another.onnx")
    assert code == 2 and err.count("\n") == 1 and "write a TOML with file" in err


def test_images_too_small_are_refused_before_our_own_network_is_tuned(capfd, here):
    camera = ("--intrinsics", "160,128,900,900,79.5,63.5")
    code, out, err = run(capfd, "build", "walk", "--out", "x.monoloc", *camera)
    assert code == 2 and out == "" and err.count("\n") == 1
    assert (
        "camera: has images of 160x128 and a focal length of 900 px, for full-0.35 32x32; check the intrinsics" in err
    )


def test_build_with_disparity_that_is_called_depth(capfd, here):
    (here / "another.toml").write_text(toml_of(MIDAS).replace('"disparity"', '"depth"'))
    code, out, err = run(capfd, *BUILD, "another.toml")
    assert code == 2 and out == ""
    assert err.splitlines()[-1].startswith("monoloc: another: gives values that do not grow with depth")
    assert not (here / "x.monoloc").exists()


def test_evaluate_another_network(capfd, here):
    metrics = json_of(capfd, "depth", "evaluate", "another.toml", "walk")
    assert metrics["absrel"] < 0.03 and metrics["predicted_share"] > 0.99
    assert metrics["scale"] == pytest.approx(SCALE, rel=0.03) and metrics["shift"] == pytest.approx(SHIFT, abs=0.02)
    _, _, err = run(capfd, "depth", "evaluate", "another.toml", "walk")
    assert "another.toml: relative depth, fitted to these frames" in err
    metric = spec(metric=True, output="depth")
    write_network(here, metric, network(metric, 2.0))
    halved = json_of(capfd, "depth", "evaluate", "another.toml", "walk")
    assert halved["absrel"] == pytest.approx(0.5, abs=0.02) and halved["scale"] == 1.0 and "shift" not in halved
    fitted = json_of(capfd, "depth", "evaluate", "another.toml", "walk", "--fit-scale")
    assert fitted["absrel"] < 0.03 and fitted["scale"] == pytest.approx(2.0, rel=0.02)


def test_evaluate_counts_what_is_missing(capfd, here):
    """Disparity below the shift is no depth: judged are the other pixels, and their share is said."""
    used = spec(scale=1.0, shift=-0.4)
    write_network(here, used, network(used, 1.0, 0.0))
    metrics = json_of(capfd, "depth", "evaluate", "another.toml", "walk")
    walk = RoomRecording(Room(), make_path(12), SMALL_CAMERA)
    near = np.mean([1.0 / walk.depth(index) > 0.41 for index in range(12)])  # the rest is beyond 100 m, or behind
    assert metrics["predicted_share"] == pytest.approx(near, abs=0.03)
    assert json_of(capfd, "depth", "evaluate", "another.toml", "walk", "--plot", "depth.png") == metrics
    assert (here / "depth.png").is_file()
    used = spec(scale=1.0, shift=-9.0)
    write_network(here, used, network(used, 1.0, 0.0))
    code, _, err = run(capfd, "depth", "evaluate", "another.toml", "walk")
    assert code == 2 and "another: gives no depth at any pixel of known depth" in err


def test_evaluate_draws_frames_that_have_both_depths(capfd, here):
    """Of the first frame, which would be drawn, the sensor sees only what is too far for the network."""
    used = spec(scale=1.0, shift=-0.4)
    write_network(here, used, network(used, 1.0, 0.0))
    file = here / "walk/depth/000000.png"
    stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    depth = RoomRecording(Room(), make_path(12), SMALL_CAMERA).depth(0)
    beyond = cv2.erode((depth > 2.6).astype(np.uint8), np.ones((15, 15), np.uint8))  # where nothing is interpolated
    write_depth(file, np.where(beyond, stored, 0))
    assert json_of(capfd, "depth", "evaluate", "another.toml", "walk", "--plot", "depth.png")["frames"] == 12
    assert (here / "depth.png").is_file()
