"""Depth prediction with an exported network, from monoloc or a third party; needs onnxruntime only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.depth.session import first_line, load_session, run_within
from monoloc.depth.spec import LEAST_INPUT_PX, DepthModel, ModelSpec, image_tensor
from monoloc.errors import DataError, SettingError

_ERROR_OUTPUT = "log_error_scale"
_FIRST_RUN_S = 60.0  # the first run is the slowest, and a network that takes longer localises nothing
_LATER_RUN_S = 10.0  # a network's work may follow from the image, as in branches
_LEAST_IMAGE_PX = 32
# Monoloc networks predict at a quarter of their input's size: 40 x 32 for most cameras, 120 x 88 for the widest.
# Finer output is subsampled: a scan has a few hundred points, and depth at corners is smooth.
_MOST_PIXELS = 128 * 96
_FARTHEST_M = 100.0  # no room is larger; disparity near zero carries no more information


@dataclass(frozen=True)
class DepthPrediction:
    """Depth of one frame, at the prediction's own resolution.

    Attributes:
        depth_m: (h, w) float32, metres along z, 0 where there is none.
        camera: intrinsics of the depth image; its rays are undistorted (:meth:`Camera.rays`).
        log_error: (h, w) float32, natural logarithm of the Laplace scale of the log-depth error; None if the network
            does not predict it.

    Raises:
        ValueError: other shapes, whole numbers, negative depth, or values that are not finite where they are used.
    """

    depth_m: NDArray[np.float32]
    camera: Camera
    log_error: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        shapes = [self.depth_m.shape] if self.log_error is None else [self.depth_m.shape, self.log_error.shape]
        if any(each != shape for each in shapes):
            raise ValueError(f"depth_m and log_error must have the camera's shape {shape}, got {shapes}")
        if self.depth_m.dtype.kind != "f":  # of a sensor, mostly in millimetres
            got = self.depth_m.dtype
            raise ValueError(f"depth_m must be float32, metres, got {got}; divide millimetres by np.float32(1000)")
        if not (np.isfinite(self.depth_m) & (self.depth_m >= 0.0)).all():
            raise ValueError("depth_m must be finite and not negative: 0 where there is none")
        if self.log_error is not None and not np.isfinite(self.log_error[self.depth_m > 0.0]).all():
            raise ValueError("log_error must be finite where there is depth")

    def resized(self, width: int, height: int) -> NDArray[np.float32]:
        """Interpolate depth between pixels that have depth: (height, width) metres, 0 where there is none."""
        size = (width, height)
        depth = np.asarray(cv2.resize(self.depth_m, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
        known = (self.depth_m > 0.0).astype(np.float32)
        share = np.asarray(cv2.resize(known, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)
        return np.where(share > 0.5, depth / np.maximum(share, np.float32(0.5)), np.float32(0.0))


class DepthSource(Protocol):
    """A source of depth for colour images, such as :class:`DepthPredictor`."""

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        """Predict depth along z, metres, of an image (H, W, 3) uint8 RGB.

        The resolution is free; the camera returned is that of the depth image, and its rays are undistorted.
        """
        ...


class DepthPredictor:
    """Runs a depth network on the frames of one camera.

    The constructor runs the network once on noise, for a minute at most, so that a mismatch is reported before the
    real work begins.

    Attributes:
        name: name of the network.
        input_camera, output_camera: intrinsics of the network's input and of the predicted depth.
        focal_ratio: ratio of the input's focal length to the canonical one; the network's depth is multiplied by it.

    Raises:
        DataError: the network cannot be loaded or run, does not take an image, or does not return a depth image.
        SettingError: the camera's images or its focal length are too small.
    """

    def __init__(self, model: DepthModel, camera: Camera, threads: int = 1) -> None:
        self.name = model.name
        self._spec = model.spec
        self._session = load_session(model.content, model.name, threads)
        check_input(self._session, model.spec, model.name)
        self._input = self._session.get_inputs()[0].name
        outputs = [output.name for output in self._session.get_outputs()]
        self._outputs = outputs[:1] + ([_ERROR_OUTPUT] if _ERROR_OUTPUT in outputs[1:] else [])
        self.input_camera = camera.resized(*_checked_size(model, camera))
        focal_px = self._spec.focal_px
        self.focal_ratio = 1.0 if focal_px is None else self.input_camera.focal_px / focal_px
        raw = self._probe()
        height, width = raw.shape
        shrink = min(1.0, float(np.sqrt(_MOST_PIXELS / (width * height))))
        self._output_size = (max(2, round(width * shrink)), max(2, round(height * shrink)))
        self.output_camera = self.input_camera.resized(*self._output_size)

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        """Predict the depth of an image (H, W, 3) uint8 RGB of the predictor's camera.

        Raises:
            DataError: the network predicts relative depth that was never fitted, or cannot be run on this image in
                10 s and 2 GB.
        """
        if not self._spec.is_usable:
            fix = "fit it by monoloc build, or give its scale and shift"
            raise DataError(self.name, "gives relative depth, whose scale is not known", fix)
        raw, *log_error = self._run(color)
        depth_m = self._spec.depth(raw) * np.float32(self.focal_ratio)
        is_depth = (depth_m > 0.0) & (depth_m <= _FARTHEST_M)  # both are false for NaN
        if log_error:
            is_depth &= np.isfinite(log_error[0])  # do not trust a pixel of unknown error
        depth_m = np.where(is_depth, depth_m, np.float32(0.0))
        return DepthPrediction(depth_m, self.output_camera, log_error[0] if log_error else None)

    def raw(self, color: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Raw network output for an image, at the output camera's resolution: (h, w) float32."""
        return self._run(color)[0]

    def _run(self, color: NDArray[np.uint8]) -> list[NDArray[np.float32]]:
        # Nearest neighbour: an average across a depth edge lies on neither surface.
        return [
            np.asarray(cv2.resize(output, self._output_size, interpolation=cv2.INTER_NEAREST_EXACT), np.float32)
            for output in self._infer(color, _LATER_RUN_S)
        ]

    def _infer(self, color: NDArray[np.uint8], most_s: float) -> list[NDArray[np.float32]]:
        tensor = image_tensor(color, self.input_camera, self._spec)
        try:
            with run_within(most_s) as options:
                outputs = self._session.run(self._outputs, {self._input: tensor}, options)
        except Exception as error:  # onnxruntime's exceptions derive directly from Exception
            size = f"{self.input_camera.width}x{self.input_camera.height}"
            problem = f"cannot be run on images of {size} ({first_line(error)})"
            limits = "2 GB, a minute for its first image and 10 s for others"
            fix = f"correct width and height, or stride; it may take {limits}"
            raise DataError(self.name, problem, fix) from error
        return [np.squeeze(np.asarray(output, dtype=np.float32)) for output in outputs]

    def _probe(self) -> NDArray[np.float32]:
        """Run the network on noise and return its checked first output."""
        name, camera = self.name, self.input_camera
        noise = np.random.default_rng(0).integers(0, 256, (camera.height, camera.width, 3), dtype=np.uint8)
        raw, *log_error = self._infer(noise, _FIRST_RUN_S)
        if raw.ndim != 2 or min(raw.shape) < 2:
            problem = f"gives {' x '.join(map(str, raw.shape)) or 'one number'}, which is no depth image"
            raise DataError(name, problem, "its first output must be (1, 1, h, w), (1, h, w, 1), (1, h, w) or (h, w)")
        if log_error and log_error[0].shape != raw.shape:
            problem = f"gives {_ERROR_OUTPUT} of another size than depth"
            raise DataError(name, problem, "give both outputs one size, or rename the second")
        if not np.isfinite(raw).any():
            raise DataError(name, "gives NaN for every pixel", "check the file, and mean and std, or export it again")
        return raw


def check_input(session: onnxruntime.InferenceSession, spec: ModelSpec, label: str | Path) -> None:
    """Check that a network's declared input agrees with a spec.

    Raises:
        DataError: the input is not a single image, or has another size or layout.
    """
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(entry.name for entry in inputs) or "none"
        raise DataError(label, f"has {len(inputs)} inputs ({names})", "export it with the image as its only input")
    declared, kind = list(inputs[0].shape), inputs[0].type
    if len(declared) != 4 or kind != "tensor(float)":
        problem = f"takes {kind} of {len(declared)} axes"
        raise DataError(label, problem, "export it with one float32 image of 4 axes as its input")
    size = (spec.height, spec.width)
    wanted = (1, 3, *size) if spec.layout == "nchw" else (1, *size, 3)
    # Dynamic axes have a name or None in place of a number.
    fixed = [axis if isinstance(axis, int) and axis > 0 else None for axis in declared]
    if all(axis is None or axis == want for axis, want in zip(fixed, wanted, strict=True)):
        return
    shape = " x ".join("any" if axis is None else str(axis) for axis in fixed)
    if spec.focal_px is not None:
        raise DataError(label, f"takes {shape}, not images of any size", "give width and height, or its layout")
    expected = " x ".join(map(str, wanted))
    raise DataError(label, f"takes {shape}, not {expected}", "correct width, height or layout")


def _checked_size(model: DepthModel, camera: Camera) -> tuple[int, int]:
    """(width, height) of the network's input for a camera.

    Raises:
        SettingError: the images are too small to predict depth from, or the focal length is not in pixels.
    """
    image = f"{camera.width}x{camera.height}"
    if min(camera.width, camera.height) < _LEAST_IMAGE_PX:
        raise SettingError("camera", f"has images of {image}", f"give at least {_LEAST_IMAGE_PX} pixels a side")
    width, height = model.spec.input_size(camera)
    if min(width, height) < LEAST_INPUT_PX:
        problem = (
            f"has images of {image} and a focal length of {camera.focal_px:.0f} px, for {model.name} {width}x{height}"
        )
        fix = f"check the intrinsics, or use a wider lens: it needs {LEAST_INPUT_PX} pixels a side"
        raise SettingError("camera", problem, fix)
    return width, height
