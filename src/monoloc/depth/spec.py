"""Input and output specification of depth networks, whoever trained them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from monoloc.camera import Camera
from monoloc.errors import SettingError
from monoloc.image_size import resize_image
from monoloc.io.recording import Recording

STRIDE = 32  # monoloc networks halve their input five times
FOCAL_KEY = "monoloc_focal_px"
LEAST_INPUT_PX = 64
MOST_INPUT_PX = 4096
_MOST_NORMALISATION = 2.0  # of values from 0 to 1; those of values from 0 to 255 are 50 and more
_WIDEST = 6.0  # image side over focal length, 143 degrees; beyond it the focal length is not in pixels

_Size = Annotated[int, Field(ge=LEAST_INPUT_PX, le=MOST_INPUT_PX)]
_Focal = Annotated[float, Field(gt=0.0, le=1e5)]
_Positive = Annotated[float, Field(gt=0.0, le=1e9)]


class ModelSpec(BaseModel):
    """How an ONNX depth network takes images and returns depth.

    Give either width and height, or focal_px.

    Attributes:
        width, height: size of the network's input; images are stretched to it.
        focal_px: canonical focal length; images are resized to approximately this focal length, and the predicted
            depth is that of a camera with it.
        stride: with ``focal_px``, width and height are multiples of it.
        mean, std: normalisation of red, green and blue, for values from 0 to 1, so at most 2.
        channels, layout: order of the colour channels and of the input's axes.
        output: quantity of the network's first output.
        metric: whether that output is in metres (1/m for disparity) up to the factor ``scale``; if not, scale and
            shift must be fitted.
        scale, shift: ``depth = scale * raw + shift``, ``1 / depth = scale * raw + shift`` for disparity, and
            ``depth = scale * exp(raw)`` for log-depth. A scale of None is fitted by ``monoloc build``, and counts as
            1 until then.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    width: _Size | None = None
    height: _Size | None = Field(None, validate_default=True)
    focal_px: _Focal | None = Field(None, validate_default=True)
    stride: int = Field(STRIDE, ge=1, le=1024)
    mean: tuple[float, float, float]
    std: tuple[_Positive, _Positive, _Positive]
    channels: Literal["rgb", "bgr"] = "rgb"
    layout: Literal["nchw", "nhwc"] = "nchw"
    output: Literal["depth", "log-depth", "disparity"]
    metric: bool
    scale: _Positive | None = None
    shift: float = Field(0.0, ge=-1e9, le=1e9)

    @field_validator("height")
    @classmethod
    def _both_or_neither(cls, height: int | None, info: ValidationInfo) -> int | None:
        if "width" in info.data and (height is None) != (info.data["width"] is None):
            raise PydanticCustomError("size", "Width and height go together")
        return height

    @field_validator("mean", "std")
    @classmethod
    def _of_values_up_to_1(cls, values: tuple[float, float, float]) -> tuple[float, float, float]:
        if max(abs(value) for value in values) > _MOST_NORMALISATION:
            raise PydanticCustomError(
                "range", "Mean and std are of values from 0 to 1: divide those of 0 to 255 by 255"
            )
        return values

    @field_validator("focal_px")
    @classmethod
    def _one_kind_of_size(cls, focal_px: float | None, info: ValidationInfo) -> float | None:
        if "height" in info.data and (focal_px is None) == (info.data["height"] is None):
            raise PydanticCustomError("size", "Give either width and height, or focal_px")
        return focal_px

    @field_validator("shift")
    @classmethod
    def _shift_of_a_scale(cls, shift: float, info: ValidationInfo) -> float:
        if shift and info.data.get("output") == "log-depth":
            raise PydanticCustomError("shift", "Log-depth has a scale only")
        if shift and "scale" in info.data and info.data["scale"] is None:
            raise PydanticCustomError("shift", "Give scale as well, or leave both to be fitted")
        return shift

    @property
    def is_usable(self) -> bool:
        """Whether the depth is metric without a fit."""
        return self.metric or self.scale is not None

    @property
    def has_shift(self) -> bool:
        """Whether a fit determines a shift in addition to the scale."""
        return not self.metric and self.output != "log-depth"

    def input_size(self, camera: Camera) -> tuple[int, int]:
        """(width, height) of the network's input for a camera's images."""
        if self.width is not None and self.height is not None:
            return self.width, self.height
        assert self.focal_px is not None
        return network_size(camera, self.focal_px, self.stride)

    def depth(self, raw: NDArray[np.float32]) -> NDArray[np.float32]:
        """Convert the network's output to depth; not finite or not positive where there is none."""
        scale = np.float32(1.0 if self.scale is None else self.scale)
        with np.errstate(all="ignore"):
            if self.output == "log-depth":
                return np.asarray(scale * np.exp(raw))
            line = scale * raw + np.float32(self.shift)
            return np.asarray(np.float32(1.0) / line if self.output == "disparity" else line)


def monoloc_spec(focal_px: float) -> ModelSpec:
    """Spec shared by all monoloc networks: metric log-depth for a camera of that focal length in pixels."""
    half = (0.5, 0.5, 0.5)
    return ModelSpec(focal_px=focal_px, mean=half, std=half, output="log-depth", metric=True, scale=1.0)


@dataclass(frozen=True)
class DepthModel:
    """A depth network that can be run.

    Attributes:
        content: the ONNX file.
        spec: input and output specification.
        name: display name.
    """

    content: bytes = field(repr=False)  # megabytes, which a notebook would print
    spec: ModelSpec
    name: str = "depth.onnx"


def network_size(camera: Camera, focal_px: float, stride: int = STRIDE) -> tuple[int, int]:
    """(width, height), multiples of the stride, that bring a camera's image closest to the canonical focal length.

    Rounding leaves the focal length a few percent off; the runtime corrects the depth for it.

    Raises:
        SettingError: the focal length is so short that the network's image would not fit in memory.
    """
    if max(camera.width, camera.height) > _WIDEST * camera.focal_px:
        problem = f"has a focal length of {camera.focal_px:.3g} px for images of {camera.width}x{camera.height}"
        raise SettingError("camera", problem, "give it in pixels, fx and fy alike")
    scale = focal_px / camera.focal_px
    width = max(1, round(camera.width * scale / stride)) * stride
    height = max(1, round(camera.height * scale / stride)) * stride
    if max(width, height) > MOST_INPUT_PX:
        problem = f"has images that become {width}x{height} at the network's focal length of {focal_px:.3g} px"
        raise SettingError("camera", problem, "check the intrinsics and the network's focal_px")
    return width, height


def image_tensor(
    color: NDArray[np.uint8], input_camera: Camera, spec: ModelSpec | None = None
) -> NDArray[np.float32]:
    """Convert an image to a network's input, float32: (H, W, 3) uint8 RGB -> (1, 3, h, w) or (1, h, w, 3).

    Args:
        color: (H, W, 3) uint8 RGB.
        input_camera: a camera with the input's size.
        spec: normalisation, channels and layout; None is that of monoloc networks: [-1, 1], RGB, channels first.
    """
    values = resize_image(color, (input_camera.width, input_camera.height)).astype(np.float32)
    if spec is None:
        spec = monoloc_spec(input_camera.focal_px)
    mean, std = np.array(spec.mean), np.array(spec.std)
    values = values / (255.0 * std).astype(np.float32) - (mean / std).astype(np.float32)
    if spec.channels == "bgr":
        values = values[..., ::-1]
    if spec.layout == "nchw":
        values = values.transpose(2, 0, 1)
    return np.ascontiguousarray(values[None])


def network_images(recording: Recording, spec: ModelSpec) -> list[NDArray[np.float32]]:
    """Network inputs of all images of a recording, as :func:`image_tensor` returns them."""
    camera = recording.camera.resized(*spec.input_size(recording.camera))
    return [image_tensor(recording.color(index), camera, spec) for index in range(len(recording))]
