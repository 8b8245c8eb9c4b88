"""Images, depth, intrinsics and poses of ROS messages.

Sources: sensor_msgs/Image and its encodings, REP 118 (depth: 16UC1 in millimetres, 32FC1 in metres), REP 104 and
http://wiki.ros.org/image_pipeline/CameraInfo (intrinsics), and compressed_depth_image_transport's codec for
``compressedDepth``: 12 bytes (format, quantisation a and b), then a PNG; of 32FC1 depth, it holds a / depth + b.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.distortion import COEFFICIENTS, DistortionModel
from monoloc.errors import DataError
from monoloc.io.image_cameras import stated_by
from monoloc.io.image_files import Stored, decode_color, decode_stored, metric_depth
from monoloc.io.image_header import image_header

IMAGE, COMPRESSED, INFO = (f"sensor_msgs/msg/{name}" for name in ("Image", "CompressedImage", "CameraInfo"))
TF = "tf2_msgs/msg/TFMessage"
POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
MILLIMETRES = 1000.0

# Conversion to RGB and number of channels.
COLOR: dict[str, tuple[int | None, int]] = {
    "rgb8": (None, 3),
    "bgr8": (cv2.COLOR_BGR2RGB, 3),
    "8UC3": (cv2.COLOR_BGR2RGB, 3),
    "rgba8": (cv2.COLOR_RGBA2RGB, 4),
    "bgra8": (cv2.COLOR_BGRA2RGB, 4),
    "mono8": (cv2.COLOR_GRAY2RGB, 1),
    "8UC1": (cv2.COLOR_GRAY2RGB, 1),
}
GREY = ("mono8", "8UC1")
_DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_DEPTH_FORMAT = ("16UC1", "mono16", "32FC1", "compressedDepth")
_COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")
DISTORTION_MODELS: dict[str, DistortionModel] = {
    "plumb_bob": "brown",
    "rational_polynomial": "rational",
    "equidistant": "fisheye",
}


def encoding_of(message: Any) -> str:
    """``encoding`` of an Image, or ``format`` of a CompressedImage."""
    return str(getattr(message, "encoding", None) or getattr(message, "format", ""))


def pixels_of(message: Any) -> str:
    """The encoding of an image's pixels, before any compression.

    Of a CompressedImage, image_transport writes it first, as in ``mono8; jpeg compressed ``. Other drivers only say
    how they compress, as in ``jpeg``, which is returned then.
    """
    return encoding_of(message).partition(";")[0].strip()


def is_depth(message: Any) -> bool:
    """Whether an Image or CompressedImage states a depth encoding."""
    return encoding_of(message).startswith(_DEPTH_FORMAT) or "compressedDepth" in encoding_of(message)


def size_of(message: Any) -> tuple[int, int] | None:
    """Width and height of an Image or CompressedImage, from its header; None if it has none."""
    if hasattr(message, "encoding"):
        return int(message.width), int(message.height)
    data = message.data.tobytes()
    if "compressedDepth" in message.format:
        data = data[_COMPRESSED_DEPTH_HEADER.size :]
    header = image_header(data)
    return None if header is None else (header.width, header.height)


def color_of(message: Any, path: Path, camera: Camera) -> NDArray[np.uint8]:
    """Colour of an Image or CompressedImage: (height, width, 3) uint8, RGB.

    Args:
        message: the message.
        path: where it is, for error messages.
        camera: its size is the required size of the image.

    Raises:
        DataError: the encoding is not read, the image is cut short, or its size differs from the camera's.
    """
    if not hasattr(message, "encoding"):
        return decode_color(message.data.tobytes(), path, camera)
    encoding = message.encoding
    if encoding not in COLOR:
        raise DataError(path, f"has the encoding {encoding!r}", _color_fix(encoding))
    _check_size(message, path, camera)
    conversion, channels = COLOR[encoding]
    pixels = _pixels(message, path, np.dtype(np.uint8), channels)
    image = pixels if conversion is None else cv2.cvtColor(pixels, conversion)
    return np.array(image, dtype=np.uint8)


def _color_fix(encoding: str) -> str:
    if encoding.startswith("bayer"):
        return "convert it to rgb8 with image_proc's debayer node, and record that"
    return f"record one of {', '.join(COLOR)}, or a CompressedImage of JPEG or PNG"


def depth_of(message: Any, path: Path, camera: Camera, depth_scale: float | None) -> NDArray[np.float32]:
    """Depth of an Image or CompressedImage: (height, width) float32 metres, 0 if unknown.

    Args:
        message: the message.
        path: where it is, for error messages.
        camera: its size is the required size of the image.
        depth_scale: stored value of one metre; None for 1000 of integers and 1 of floating-point numbers.

    Raises:
        DataError: the encoding is not read, the image is cut short, or its size differs from the camera's.
    """
    if hasattr(message, "encoding"):
        if message.encoding not in _DEPTH:
            raise DataError(path, f"has the encoding {message.encoding!r}", "record depth as 16UC1 or 32FC1")
        _check_size(message, path, camera)
        dtype = np.dtype(_DEPTH[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
        pixels = _pixels(message, path, dtype, 1)
        stored: Stored = pixels.astype(dtype.newbyteorder("="))
    else:
        _check_size(message, path, camera)
        stored = _compressed_depth(message, path)
    return metric_depth(stored, depth_scale or (1.0 if stored.dtype.kind == "f" else MILLIMETRES))


def _compressed_depth(message: Any, path: Path) -> Stored:
    """Depth as it was before compression, (h, w)."""
    data, fmt = message.data.tobytes(), message.format
    if "compressedDepth" not in fmt:
        return decode_stored(data, path)
    if "rvl" in fmt:
        fix = "record it with the parameter format of compressedDepth set to png"
        raise DataError(path, "is compressed by RVL, which is not read", fix)
    if len(data) <= _COMPRESSED_DEPTH_HEADER.size:
        raise DataError(path, "is cut short", "copy the bag again")
    _, a, b = _COMPRESSED_DEPTH_HEADER.unpack_from(data)
    stored = decode_stored(data[_COMPRESSED_DEPTH_HEADER.size :], path)
    if not fmt.startswith("32FC1"):
        return stored
    inverse = stored.astype(np.float32) - np.float32(b)
    return np.where((stored > 0) & (inverse > 0.0), np.float32(a) / np.where(inverse > 0.0, inverse, 1.0), 0.0)


def _check_size(message: Any, path: Path, camera: Camera) -> None:
    size = size_of(message)
    if size is not None and size != (camera.width, camera.height):
        raise DataError(
            path,
            f"is {size[0]}x{size[1]}, but the intrinsics are for {camera.width}x{camera.height}",
            "record the CameraInfo of these images, or give --camera",
        )


def _pixels(message: Any, path: Path, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Pixels (h, w) or (h, w, channels) of an Image, without the padding of its rows."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * dtype.itemsize
    if step < row or len(message.data) < height * step:
        problem = (
            f"holds {len(message.data)} bytes, rows of {step}, for {width}x{height} pixels of {message.encoding}"
        )
        raise DataError(path, problem, "record it again")
    rows = np.asarray(message.data)[: height * step].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(rows).view(dtype)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def camera_of(info: Any, is_rectified: bool, image_size: tuple[int, int] | None, path: Path) -> Camera:
    """Camera of a CameraInfo: K and the distortion, or P of rectified images.

    These are of the whole sensor, of which images may be a region (roi) with averaged pixels (binning). Some drivers
    state them for the images instead, which have the size of the message then.

    Args:
        info: the message.
        is_rectified: whether the images are those after rectification.
        image_size: width and height of the images; None if they are unknown.
        path: where it is, for error messages.

    Raises:
        DataError: the camera is not calibrated, its distortion model is not read, or its region is not in the image.
    """
    size = (int(info.width), int(info.height))
    K, P = (np.asarray(_field(info, name), dtype=np.float64) for name in ("k", "p"))
    matrix = P.reshape(3, 4)[:, :3] if is_rectified else K.reshape(3, 3)
    if not matrix[0, 0] > 0.0:
        problem = f"has no focal length in {'P' if is_rectified else 'K'}"
        raise DataError(path, problem, "calibrate the camera, and give --camera")
    model, coefficients = ("brown", ()) if is_rectified else _distortion(info, path)
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    with stated_by(path):
        camera = Camera(*size, fx, fy, cx, cy, coefficients, model)
        return camera if image_size == size else _region_of(camera, info, path)


def _region_of(camera: Camera, info: Any, path: Path) -> Camera:
    """Camera of the region of interest of a CameraInfo, after binning."""
    roi = info.roi
    width, height = region_size(info)
    across, down = _binning(info)
    left, top = int(roi.x_offset), int(roi.y_offset)
    if left + width * across > camera.width or top + height * down > camera.height:
        problem = (
            f"has the roi {roi.width}x{roi.height} at ({left}, {top}), outside its {camera.width}x{camera.height}"
        )
        raise DataError(path, problem, "give --camera W,H,FX,FY,CX,CY,K1,K2,P1,P2,K3 of these images")
    return camera.cropped(left, top, width * across, height * down).resized(width, height)


def region_size(info: Any) -> tuple[int, int]:
    """Width and height of the images of a CameraInfo: of its region of interest, after binning."""
    across, down = _binning(info)
    return (info.roi.width or info.width) // across, (info.roi.height or info.height) // down


def _binning(info: Any) -> tuple[int, int]:
    """Pixels of the sensor in one of an image, along x and y; 0 in a message means 1."""
    return max(int(info.binning_x), 1), max(int(info.binning_y), 1)


def same_intrinsics(info: Any, other: Any) -> bool:
    """Whether two messages of CameraInfo state the same size, region and numbers."""
    for each in ("width", "height", "binning_x", "binning_y", "roi"):
        if getattr(info, each) != getattr(other, each):
            return False
    return all(np.array_equal(_field(info, name), _field(other, name)) for name in ("k", "d", "p"))


def _distortion(info: Any, path: Path) -> tuple[DistortionModel, tuple[float, ...]]:
    coefficients = tuple(float(value) for value in _field(info, "d"))
    name = info.distortion_model
    if name != "equidistant" and not any(coefficients):
        return "brown", ()
    if name not in DISTORTION_MODELS:
        known = ", ".join(DISTORTION_MODELS)
        raise DataError(path, f"has the distortion model {name!r}", f"calibrate the camera by one of {known}")
    model = DISTORTION_MODELS[name]
    count = len(COEFFICIENTS[model])
    if any(coefficients[count:]):
        fix = f"calibrate the camera with {', '.join(COEFFICIENTS[model])} only"
        raise DataError(path, f"has {len(coefficients)} coefficients of {name}", fix)
    return model, coefficients[:count]


def _field(info: Any, name: str) -> Any:
    """A matrix of a CameraInfo, whose name is a capital letter in ROS 1."""
    return getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())


def pose_row(message: Any) -> tuple[float, ...]:
    """Position and quaternion ``x, y, z, qx, qy, qz, qw`` of a message of :data:`POSES`."""
    pose = message
    while hasattr(pose, "pose"):
        pose = pose.pose
    if hasattr(pose, "transform"):
        position, rotation = pose.transform.translation, pose.transform.rotation
    else:
        position, rotation = pose.position, pose.orientation
    return (position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)
