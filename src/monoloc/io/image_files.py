"""Readers of image files: colour, depth and confidence. Sizes are checked before the pixels are decoded."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.array_files import decode_array
from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.io.file_access import read_bytes
from monoloc.io.image_header import ImageHeader, image_header, is_numpy, is_tiff, is_whole_jpeg
from monoloc.io.image_resampling import resize_nearest

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_JPEG_START = b"\xff\xd8\xff"
_EXR_START = b"v/1\x01"
_TAIL_BYTES = 1024  # some cameras write a few bytes after the end marker
_NO_DEPTH_16_BIT = 65535  # marks missing depth in 7-Scenes; elsewhere it is a saturated, invalid reading
_MOST_PIXELS = 1 << 26  # far beyond any camera's

Stored = NDArray[np.integer | np.floating]


def read_color(path: Path, camera: Camera) -> NDArray[np.uint8]:
    """Read an image file: (height, width, 3) uint8, RGB; grey, RGBA and 16-bit images are converted.

    Raises:
        DataError: the file cannot be read, or see :func:`decode_color`.
    """
    return decode_color(read_bytes(path), path, camera)


def decode_color(data: bytes, path: Path, camera: Camera) -> NDArray[np.uint8]:
    """Decode the content of an image file; see :func:`read_color`.

    An EXIF orientation is obeyed where only the turned image has the camera's size, and ignored where only the stored
    pixels have it.

    Args:
        data: the content.
        path: the file, for error messages.
        camera: its size is the required size of the image.

    Raises:
        DataError: the file is truncated or not an image, its size differs from the camera's, or it has an orientation
            with which its stored and its turned pixels both have the camera's size.
    """
    header = checked_header(data, path)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    stored = (header.width, header.height)
    if header.orientation != 1 and _is_turned(stored, header.orientation, camera, path):
        flags, stored = cv2.IMREAD_COLOR, stored[::-1]
    _check_size(path, stored, camera)
    bgr = _decode(data, path, flags)
    _check_size(path, (bgr.shape[1], bgr.shape[0]), camera)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(
    path: Path, depth_scale: float, camera: Camera, confidence_path: Path | None = None, least_confidence: int = 0
) -> NDArray[np.float32]:
    """Read a depth image: (height, width) float32 metres, 0 if unknown.

    Images of another size than the camera's are enlarged or reduced to it, each pixel to its nearest, if they have
    the same shape: they then show the same field of view.

    Args:
        path: one channel of integers of 8 or 16 bits or of floating-point numbers (PNG, TIFF), or a NumPy array of
            shape (h, w).
        depth_scale: stored value of one metre.
        camera: its size is that of the result.
        confidence_path: image of the confidence of each depth pixel, of the depth image's size.
        least_confidence: depth of a lower confidence is taken as unknown.

    Raises:
        DataError: a file is missing, truncated or not such an image, or its shape differs.
    """
    stored = decode_stored(read_bytes(path), path)
    depth_m = metric_depth(stored, depth_scale)
    if confidence_path is not None:
        confidence = decode_stored(read_bytes(confidence_path), confidence_path)
        if confidence.shape != stored.shape:
            raise DataError(
                confidence_path,
                f"is {confidence.shape[1]}x{confidence.shape[0]}, but its depth image {path.name} is "
                f"{stored.shape[1]}x{stored.shape[0]}",
                "export the recording again",
            )
        depth_m[confidence < least_confidence] = 0.0
    return fit_depth(depth_m, path, camera)


def decode_stored(data: bytes, path: Path) -> Stored:
    """Decode the content of a depth or confidence image: (h, w), as stored.

    Raises:
        DataError: the file is truncated, not an image of one channel, or has too many pixels.
    """
    if data.startswith(_EXR_START):
        raise DataError(
            path,
            "is OpenEXR, which OpenCV's packages do not decode",
            "convert it to a TIFF of floating-point numbers: oiiotool depth.exr --ch 0 -d float -o depth.tiff",
        )
    if is_numpy(data):
        stored = decode_array(data, path)
    else:
        checked_header(data, path)
        stored = _decode(data, path, cv2.IMREAD_UNCHANGED)
    if stored.ndim != 2 or not (stored.dtype in (np.uint8, np.uint16) or stored.dtype.kind == "f"):
        raise DataError(
            path, "is not a depth image", "depth is one channel of 8 or 16 bits, or of floating-point numbers"
        )
    return stored


def metric_depth(stored: Stored, depth_scale: float) -> NDArray[np.float32]:
    """Stored depth (h, w) with ``depth_scale`` to the metre -> (h, w) float32 metres, 0 if unknown."""
    depth_m = stored.astype(np.float32) / np.float32(depth_scale)
    if stored.dtype == np.uint16:
        depth_m[stored == _NO_DEPTH_16_BIT] = 0.0
    elif stored.dtype.kind == "f":
        depth_m[~(np.isfinite(depth_m) & (depth_m > 0.0))] = 0.0
    return depth_m


def fit_depth(depth_m: NDArray[np.float32], path: Path, camera: Camera) -> NDArray[np.float32]:
    """Depth (h, w) of a camera's field of view -> (height, width) of its image.

    Raises:
        DataError: the shapes differ by more than one pixel of rounding.
    """
    height, width = depth_m.shape
    if (width, height) == (camera.width, camera.height):
        return depth_m
    if abs(width * camera.height - height * camera.width) > max(camera.width, camera.height):
        raise DataError(
            path,
            f"is {width}x{height}, but the intrinsics are for {camera.width}x{camera.height}, of another shape",
            "give depth images of that size or shape, or describe the depth camera in a dataset.toml "
            "(depth_width to depth_cy)",
        )
    return resize_nearest(depth_m, camera.width, camera.height)


def checked_header(data: bytes, path: Path) -> ImageHeader:
    """The header of an image that is not cut short.

    Raises:
        DataError: it is cut short, has too many pixels, or its size is not known before it is decoded.
    """
    header = image_header(data)
    if header is not None and header.width * header.height > _MOST_PIXELS:
        raise DataError(path, f"says it is {header.width}x{header.height}", "give images of a camera's size")
    # Some decoders return the available part of a truncated file.
    if (
        (data.startswith(_PNG_START) and _PNG_END not in data[-_TAIL_BYTES:])
        or (data.startswith(_JPEG_START) and not is_whole_jpeg(data))
        or (is_tiff(data) and header is None)
    ):
        raise DataError(path, "is cut short", "copy the file again")
    if header is None:
        raise DataError(path, "cannot be decoded as an image", "copy or convert the file again")
    return header


def _decode(data: bytes, path: Path, flags: int) -> Stored:
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:  # of sizes beyond its own bound
        image = None
    if image is None:
        raise DataError(path, "cannot be decoded as an image", "copy or convert the file again")
    return np.asarray(image)


def _is_turned(stored: tuple[int, int], orientation: int, camera: Camera, path: Path) -> bool:
    """Whether an EXIF orientation is to be obeyed."""
    shown = stored[::-1] if orientation >= 5 else stored
    size = (camera.width, camera.height)
    if shown == stored == size:
        raise DataError(
            path,
            f"is tagged to be shown turned (EXIF orientation {orientation}), and the intrinsics fit both ways",
            "turn its pixels (mogrify -auto-orient), or, if the poses are of the stored pixels, remove the tag "
            "(exiftool -Orientation=)",
        )
    return shown == size


def _check_size(path: Path, size: tuple[int, int], camera: Camera) -> None:
    if size != (camera.width, camera.height):
        raise DataError(
            path,
            f"is {size[0]}x{size[1]}, but the intrinsics are for {camera.width}x{camera.height}",
            "give the intrinsics of these images, or images of that size",
        )
