"""Depth of an image by an exported network; needs onnxruntime only."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError

STRIDE = 32  # the network halves its input five times
FOCAL_KEY = "monoloc_focal_px"


def network_size(camera: Camera, focal_px: float) -> tuple[int, int]:
    """(width, height) that bring a camera's image nearest to the canonical focal length, multiples of 32.

    Rounding leaves the two focal lengths a few percent off; the runtime corrects depth for it.
    """
    scale = focal_px / camera.focal_px
    width = max(1, round(camera.width * scale / STRIDE)) * STRIDE
    height = max(1, round(camera.height * scale / STRIDE)) * STRIDE
    return width, height


@dataclass(frozen=True)
class DepthPrediction:
    """Depth of one frame, at a quarter of the network's input resolution.

    Attributes:
        depth_m: (h, w) float32, metres along z.
        camera: intrinsics of the depth image, undistorted rays through :meth:`Camera.rays`.
    """

    depth_m: NDArray[np.float32]
    camera: Camera


class DepthPredictor:
    """Runs ``depth.onnx`` on the frames of one camera.

    Raises:
        DataError: the file is not an ONNX network exported by monoloc.
    """

    def __init__(self, model: Path | bytes, camera: Camera, threads: int = 1) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        label = model if isinstance(model, Path) else "depth.onnx"
        try:
            source = str(model) if isinstance(model, Path) else model
            self._session = onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
            self.focal_px = float(self._session.get_modelmeta().custom_metadata_map[FOCAL_KEY])
        except KeyError as error:
            raise DataError(
                label, f"lacks the metadata {FOCAL_KEY}", "export it with: monoloc depth export"
            ) from error
        except Exception as error:  # onnxruntime raises its own classes, all directly under Exception
            reason = str(error).splitlines()[0]
            raise DataError(label, f"cannot be loaded ({reason})", "export it with: monoloc depth export") from error
        self.input_camera = camera.resized(*network_size(camera, self.focal_px))
        self.output_camera = self.input_camera.resized(self.input_camera.width // 4, self.input_camera.height // 4)
        self._log_focal_ratio = math.log(self.input_camera.focal_px / self.focal_px)

    def __call__(self, color: NDArray[np.uint8]) -> DepthPrediction:
        """Depth of an image (H, W, 3) uint8 RGB of the predictor's camera."""
        tensor = image_tensor(color, self.input_camera)
        log_depth = self._session.run(None, {"image": tensor})[0][0, 0]
        return DepthPrediction(np.exp(log_depth + self._log_focal_ratio), self.output_camera)


def image_tensor(color: NDArray[np.uint8], input_camera: Camera) -> NDArray[np.float32]:
    """The network's input: (H, W, 3) uint8 RGB -> (1, 3, h, w) float32 in [-1, 1]."""
    size = (input_camera.width, input_camera.height)
    small = cv2.resize(color, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.ascontiguousarray((small / 127.5 - 1.0).transpose(2, 0, 1)[None])
