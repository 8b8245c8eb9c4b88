"""Networks of any kind, fed and read as described: depth along the camera's rays, and zero where there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper

from depth_helpers import random_image, stub_network
from monoloc.camera import Camera
from monoloc.depth.predictor import DepthPrediction, DepthPredictor
from monoloc.depth.spec import DepthModel
from monoloc.errors import DataError, SettingError
from onnx_networks import IMAGE, IMAGENET, MIDAS, PLAIN, error_at_95_percent, graph, one_node, onnx_network, spec
from refusals import refuses
from synthetic_room import BLUE_SPAN, CAMERA, NEAREST_M, Room, RoomRecording, depth_from_blue, make_path


@pytest.fixture(scope="module")
def recording() -> RoomRecording:
    return RoomRecording(Room(), make_path(2))


@pytest.mark.parametrize("output", ["depth", "log-depth", "disparity"])
@pytest.mark.parametrize(
    ("channels", "layout", "normalisation"),
    [("rgb", "nchw", IMAGENET), ("bgr", "nchw", PLAIN), ("rgb", "nhwc", PLAIN), ("bgr", "nhwc", IMAGENET)],
)
def test_any_kind_of_network_gives_the_room_s_depth(
    recording: RoomRecording, output: str, channels: str, layout: str, normalisation: dict[str, Any]
) -> None:
    scale, shift = (2.0, 0.0) if output == "log-depth" else (0.01, -0.2)
    used = spec(output=output, channels=channels, layout=layout, scale=scale, shift=shift, **normalisation)
    predictor = DepthPredictor(DepthModel(onnx_network(used, scale, shift), used), recording.camera)
    # One step of 8 bits is 1.3 % of depth; edges add the rest.
    assert error_at_95_percent(predictor(recording.color(0)), recording, 0) < 0.03


@pytest.mark.parametrize("wrong", [{"channels": "bgr"}, {"mean": (0.4, 0.4, 0.2)}, {"output": "log-depth"}])
def test_wrong_description_gives_wrong_depth(recording: RoomRecording, wrong: dict[str, Any]) -> None:
    """So the test above can fail."""
    content, used = onnx_network(spec(scale=1.0), 1.0), spec(scale=1.0, **wrong)
    prediction = DepthPredictor(DepthModel(content, used), recording.camera)(recording.color(0))
    assert not error_at_95_percent(prediction, recording, 0) < 0.1


@pytest.mark.parametrize(
    ("shape", "size", "pool"),
    [
        ("1 1 h w", (128, 128), 1),
        ("1 h w 1", (64, 192), 2),
        ("1 h w", (320, 256), 1),
        ("h w", (320, 256), 2),
        ("h w", (64, 192), 1),
    ],
)
def test_output_may_have_any_size_and_shape(
    recording: RoomRecording, shape: str, size: tuple[int, int], pool: int
) -> None:
    """The depth image's camera accounts for stretched images."""
    used = spec(width=size[0], height=size[1], scale=1.0)
    predictor = DepthPredictor(DepthModel(onnx_network(used, pool=pool, shape=shape), used), recording.camera)
    prediction = predictor(recording.color(1))
    assert prediction.camera == predictor.output_camera
    assert prediction.depth_m.shape == (prediction.camera.height, prediction.camera.width)
    assert prediction.depth_m.dtype == np.float32
    assert prediction.log_error is None
    assert error_at_95_percent(prediction, recording, 1) < 0.05


@given(
    st.integers(64, 200), st.integers(64, 200), st.floats(100.0, 600.0), st.floats(100.0, 600.0), st.floats(-0.3, 0.3)
)
@settings(max_examples=10)
def test_rays_of_stretched_depth_are_those_of_the_camera(
    width: int, height: int, fx: float, fy: float, off_centre: float
) -> None:
    """The middle of the image block that an output pixel covers has the same ray."""
    camera = Camera(640, 360, fx, fy, 640 * (0.5 + off_centre), 360 * (0.5 - off_centre))
    used = spec(width=width, height=height, scale=1.0)
    out = DepthPredictor(DepthModel(onnx_network(used), used), camera).output_camera
    pixels = np.array([[0.0, 0.0], [out.width - 1, 0], [3, 7], [out.width - 1, out.height - 1]])
    in_image = (pixels + 0.5) * np.array([640 / out.width, 360 / out.height]) - 0.5
    np.testing.assert_allclose(out.rays(pixels), camera.rays(in_image), atol=1e-9)


def test_rays_of_distorted_images_are_those_of_the_camera() -> None:
    """As above, for a camera with distortion."""
    camera = Camera(640, 360, 500.0, 510.0, 317.0, 182.0, (0.05, -0.02, 0.001, 0.002, 0.0))
    prediction = DepthPredictor(stub_network(0.0, 136.0), camera)(random_image(360, 640))
    rows, columns = prediction.depth_m.shape
    block = np.array([640 / columns, 360 / rows])
    pixels = np.array([[0.0, 0.0], [columns - 1, 0], [3, 7], [columns - 1, rows - 1]])
    in_image = (pixels + 0.5) * block - 0.5
    np.testing.assert_allclose(prediction.camera.rays(pixels), camera.rays(in_image), atol=1e-9)


@pytest.mark.parametrize(("focal_px", "stride"), [(100.0, 14), (136.0, 32), (170.0, 14)])
def test_canonical_depth_is_scaled_by_the_ratio_of_focal_lengths(
    recording: RoomRecording, focal_px: float, stride: int
) -> None:
    used = spec(width=None, height=None, focal_px=focal_px, stride=stride, output="depth", scale=1.0)
    predictor = DepthPredictor(DepthModel(onnx_network(used), used), recording.camera)
    assert predictor.input_camera.width % stride == predictor.input_camera.height % stride == 0
    ratio = predictor.input_camera.focal_px / focal_px
    assert abs(np.log(ratio)) < 0.5 * stride / min(predictor.input_camera.width, predictor.input_camera.height) + 1e-9
    prediction = predictor(recording.color(0))
    stretched = DepthPrediction(prediction.depth_m / np.float32(ratio), prediction.camera)
    assert error_at_95_percent(stretched, recording, 0) < 0.03


@pytest.mark.parametrize("focal_px", [90.0, 290.0])
def test_depth_is_scaled_from_the_canonical_to_the_camera_s_focal_length(focal_px: float) -> None:
    """An object of the same size in the image is twice as far at twice the focal length; rounded sizes count too."""
    camera = Camera(640, 360, 500.0, 510.0, 317.0, 182.0)
    predictor = DepthPredictor(stub_network(np.log(1.7), focal_px), camera)
    prediction = predictor(random_image(360, 640))
    scale_x, scale_y = predictor.input_camera.width / 640, predictor.input_camera.height / 360
    expected = 1.7 * np.sqrt(500.0 * scale_x * 510.0 * scale_y) / focal_px
    np.testing.assert_allclose(prediction.depth_m, expected, rtol=1e-6)
    assert prediction.depth_m.shape == (prediction.camera.height, prediction.camera.width)
    # The image is as near to the canonical focal length as multiples of 32 allow.
    assert abs(scale_x * camera.focal_px / focal_px - 1.0) * 640 * focal_px / camera.focal_px <= 16.0 + 1e-9


def test_large_output_is_sampled_not_averaged(recording: RoomRecording) -> None:
    used = spec(width=320, height=256, scale=1.0)
    model = DepthModel(onnx_network(used), used)
    prediction = DepthPredictor(model, recording.camera)(recording.color(0))
    assert prediction.depth_m.size <= 128 * 96 * 1.02 and prediction.depth_m.size > 0.9 * 128 * 96
    blue = np.unique(recording.color(0)[..., 2]).astype(np.float64)
    possible = NEAREST_M * np.exp(BLUE_SPAN * blue / 255.0)
    nearest = possible[np.abs(np.log(prediction.depth_m[..., None] / possible)).argmin(axis=-1)]
    np.testing.assert_allclose(prediction.depth_m, nearest, rtol=1e-4)


def test_images_are_enlarged_smoothly() -> None:
    """A network larger than the image sees slopes, not blocks."""
    camera = Camera(64, 64, 60.0, 60.0, 31.5, 31.5)
    ramp = np.repeat(np.repeat(np.arange(0, 256, 4, dtype=np.uint8)[None], 64, axis=0)[..., None], 3, axis=2)
    used = spec(width=192, height=192, **PLAIN, output="depth", scale=1.0)
    raw = DepthPredictor(DepthModel(one_node("Add", 1.0), used), camera).raw(ramp)
    steps = np.diff(raw[50, 5:-5])
    assert steps.min() > 0.0 and steps.max() < 3.0 * steps.mean()


@pytest.mark.parametrize("pool", [1, 4])
def test_stated_error_is_returned_with_the_depth(recording: RoomRecording, pool: int) -> None:
    used = spec(output="log-depth", scale=1.0, width=192, height=160)
    content = onnx_network(used, pool=pool, extra_output="log_error_scale")
    prediction = DepthPredictor(DepthModel(content, used), recording.camera)(recording.color(0))
    assert prediction.log_error is not None and prediction.log_error.shape == prediction.depth_m.shape
    # This network states an error of a twentieth of the depth.
    np.testing.assert_allclose(prediction.log_error, np.log(0.05 * prediction.depth_m), atol=1e-4)
    other = onnx_network(used, pool=pool, extra_output="features")
    assert DepthPredictor(DepthModel(other, used), recording.camera)(recording.color(0)).log_error is None


def test_impossible_depth_is_zero() -> None:
    """Negative, infinite, NaN and absurd values give pixels without depth."""
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


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_depth_that_is_no_number_is_refused_before_it_spoils_a_frame(value: float) -> None:
    camera = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
    depth_m, log_error = np.ones((3, 4), np.float32), np.full((3, 4), -2.0, np.float32)
    depth_m[0, 0] = 0.0
    log_error[0, 0] = value  # where there is no depth, none is needed
    DepthPrediction(depth_m, camera, log_error)
    log_error[1, 1] = value
    with pytest.raises(ValueError, match="log_error must be finite where there is depth"):
        DepthPrediction(depth_m, camera, log_error)
    for bad in (value, -1.0):
        depth_m[2, 2] = bad
        with pytest.raises(ValueError, match="depth_m must be finite and not negative: 0 where there is none"):
            DepthPrediction(depth_m, camera)


def test_pixel_whose_stated_error_is_nan_has_no_depth() -> None:
    used = spec(width=64, height=64, mean=(0.0,) * 3, std=(1.0 / 255.0,) * 3, output="depth", scale=1.0)
    nodes = [
        helper.make_node("Identity", ["pixels"], ["all"]),
        helper.make_node("Gather", ["all", "first"], ["result"], axis=1),
        helper.make_node("Sub", ["result", "fifty"], ["beyond"]),
        helper.make_node("Log", ["beyond"], ["log_error_scale"]),
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("result", "log_error_scale")]
    content = graph(nodes, [IMAGE], outputs, {"first": np.array([0]), "fifty": np.float32(50.0)})
    color = np.full((64, 64, 3), 40, dtype=np.uint8)  # ten below the logarithm's domain
    color[:, 32:] = 60
    prediction = DepthPredictor(DepthModel(content, used), Camera(64, 64, 60.0, 60.0, 31.5, 31.5))(color)
    np.testing.assert_allclose(prediction.depth_m[:, 32:], 60.0, rtol=1e-4)
    assert np.all(prediction.depth_m[:, :32] == 0.0)


def test_interpolation_ignores_pixels_without_depth() -> None:
    depth = np.full((8, 8), 2.0, dtype=np.float32)
    depth[2:4, 2:4] = 0.0
    large = DepthPrediction(depth, CAMERA.resized(8, 8)).resized(64, 48)
    assert large.shape == (48, 64)
    assert np.all((large == 0.0) | (np.abs(large - 2.0) < 1e-6))
    assert np.all(large[13:23, 18:30] == 0.0) and np.all(large[:11] > 0.0) and np.all(large[25:] > 0.0)


def test_frame_of_nan_is_a_frame_without_depth() -> None:
    """A drone does not stop for one image; a network that never gives depth is refused at the start."""
    camera = Camera(64, 64, 60.0, 60.0, 31.5, 31.5)
    used = spec(width=64, height=64, **PLAIN, output="depth", scale=1.0)
    predictor = DepthPredictor(DepthModel(one_node("Pow", -0.5), used), camera)  # of black: infinite
    assert np.all(predictor(np.zeros((64, 64, 3), dtype=np.uint8)).depth_m == 0.0)


def test_relative_depth_is_not_taken_for_metric(recording: RoomRecording) -> None:
    predictor = DepthPredictor(DepthModel(onnx_network(MIDAS), MIDAS, "another"), recording.camera)
    refuses(
        lambda: predictor(recording.color(0)), DataError, "another: gives relative depth.*; fit it by monoloc build"
    )
    metric = spec(metric=True)
    prediction = DepthPredictor(DepthModel(onnx_network(metric), metric), recording.camera)(recording.color(0))
    assert error_at_95_percent(prediction, recording, 0) < 0.03


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            onnx_network(MIDAS, shape="1 2 h w"),
            "gives 2 x 128 x 128, which is no depth image; its first output must be",
        ),
        (onnx_network(MIDAS, shape="number"), "gives one number, which is no depth image"),
        (onnx_network(MIDAS, shape="fixed"), r"cannot be run on images of 128x128 \(.*\); correct width and height"),
        (one_node("Mul", float("nan")), "gives NaN for every pixel; check the file"),
    ],
)
def test_network_that_gives_no_depth_image_is_refused(
    capfd: pytest.CaptureFixture[str], content: bytes, message: str
) -> None:
    model = DepthModel(content, spec(scale=1.0), "another")
    refuses(lambda: DepthPredictor(model, CAMERA), DataError, "another: " + message)
    out, err = capfd.readouterr()
    assert out == err == ""  # onnxruntime prints nothing either


def test_stated_error_of_another_size_is_refused() -> None:
    used = spec(output="log-depth", scale=1.0)
    nodes = [
        helper.make_node("Identity", ["pixels"], ["all"]),
        helper.make_node("Gather", ["all", "first"], ["result"], axis=1),
        helper.make_node("AveragePool", ["result"], ["log_error_scale"], kernel_shape=[2, 2], strides=[2, 2]),
    ]
    outputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("result", "log_error_scale")]
    content = graph(nodes, [IMAGE], outputs, {"first": np.array([0])})
    model = DepthModel(content, used, "another")
    refuses(
        lambda: DepthPredictor(model, CAMERA), DataError, "another: gives log_error_scale of another size than depth"
    )


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (Camera(640, 24, 500.0, 500.0, 320.0, 12.0), "has images of 640x24; give at least 32 pixels a side"),
        (
            Camera(640, 480, 5000.0, 5000.0, 320.0, 240.0),
            "focal length of 5000 px, for blue 32x32; check the intrinsics",
        ),
        # The network's image would take all memory.
        (Camera(640, 480, 9.0, 9.0, 320.0, 240.0), "length of 9 px for images of 640x480; give it in pixels"),
    ],
)
def test_camera_whose_images_are_too_small_is_refused(camera: Camera, message: str) -> None:
    refuses(lambda: DepthPredictor(depth_from_blue(), camera), SettingError, f"camera: .*{message}")


def test_depth_must_have_its_cameras_shape() -> None:
    small = CAMERA.resized(8, 6)
    with pytest.raises(ValueError, match=r"depth_m and log_error must have the camera's shape \(6, 8\)"):
        DepthPrediction(np.ones((8, 6), np.float32), small)
    with pytest.raises(ValueError, match="log_error must have"):
        DepthPrediction(np.ones((6, 8), np.float32), small, np.ones((3, 4), np.float32))
