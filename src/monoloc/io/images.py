"""Readers of image files, and the recording that most formats share: one image file per frame."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_bytes
from monoloc.io.registration import DepthRegistration

_PNG_START, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_JPEG_START, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_TAIL_BYTES = 1024  # some cameras write a few bytes after the end marker
_NO_DEPTH_16_BIT = 65535  # marks missing depth in 7-Scenes; elsewhere it is a saturated, invalid reading


def read_color(path: Path, camera: Camera) -> NDArray[np.uint8]:
    """Read an image file: (height, width, 3) uint8, RGB; grey, RGBA and 16-bit images are converted.

    Raises:
        DataError: the file is missing, truncated or not an image, or its size differs from the camera's.
    """
    # The orientation tag is ignored because intrinsics refer to the stored pixels.
    bgr = _decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    _check_size(path, bgr, camera)
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path, depth_scale: float, camera: Camera) -> NDArray[np.float32]:
    """Read a depth image with one channel of 8 or 16 bits: (height, width) float32 metres, 0 if unknown.

    Args:
        path: the file.
        depth_scale: stored value of one metre.
        camera: its size is the required size of the image.

    Raises:
        DataError: the file is missing, truncated or not a depth image, or its size differs from the camera's.
    """
    stored = _decode(path, cv2.IMREAD_UNCHANGED)
    if stored.ndim != 2 or stored.dtype not in (np.uint8, np.uint16):
        raise DataError(path, "is not a depth image", "depth is one channel of 8 or 16 bits")
    _check_size(path, stored, camera)
    depth_m = stored.astype(np.float32) / np.float32(depth_scale)
    if stored.dtype == np.uint16:
        depth_m[stored == _NO_DEPTH_16_BIT] = 0.0
    return depth_m


def _decode(path: Path, flags: int) -> NDArray[np.integer | np.floating]:
    data = read_bytes(path)
    # Some decoders return the available part of a truncated file.
    tail = data[-_TAIL_BYTES:]
    if (data.startswith(_PNG_START) and _PNG_END not in tail) or (
        data.startswith(_JPEG_START) and _JPEG_END not in tail
    ):
        raise DataError(path, "is cut short", "copy the file again")
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    if image is None:
        raise DataError(path, "cannot be decoded as an image", "copy or convert the file again")
    return np.asarray(image)


def _check_size(path: Path, image: NDArray[np.integer | np.floating], camera: Camera) -> None:
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise DataError(
            path,
            f"is {width}x{height}, but the intrinsics are for {camera.width}x{camera.height}",
            "give the intrinsics of these images, or images of that size",
        )


def names_of(files: Sequence[Path], folder: Path) -> list[str]:
    """Unique names of files: without suffix, and with the path from the folder if names repeat."""
    stems = [file.stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    return [os.path.relpath(file, folder).removesuffix(files[0].suffix) for file in files]


@dataclass(eq=False)
class ImageRecording:
    """A :class:`~monoloc.io.recording.Recording` whose frames are image files.

    The constructor reads the first colour image, so that it detects intrinsics of another image size.

    Attributes:
        folder: location of the recording, for error messages.
        color_paths: one colour image per frame.
        depth_paths: one depth image per frame, or None if the recording has no depth.
        depth_scale: stored depth value of one metre.
        registration: transforms depth to the colour camera; None if the stored depth is registered.

    Raises:
        DataError: the recording has no frames, or its first image is unusable.
    """

    name: str
    folder: Path
    camera: Camera
    frame_names: list[str]
    timestamps_s: FloatArray
    poses: FloatArray | None
    color_paths: list[Path]
    depth_paths: list[Path] | None
    depth_scale: float
    registration: DepthRegistration | None = None
    has_depth: bool = field(init=False)

    def __post_init__(self) -> None:
        self.has_depth = self.depth_paths is not None
        if not self.color_paths:
            raise DataError(self.folder, "has no frames", "give a folder with at least one image")
        self.color(0)

    def __len__(self) -> int:
        return len(self.color_paths)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        return read_color(self.color_paths[index], self.camera)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        if self.depth_paths is None:
            raise DataError(self.folder, "has no depth images", "use a recording with depth, or predicted depth")
        if self.registration is None:
            return read_depth(self.depth_paths[index], self.depth_scale, self.camera)
        depth_m = read_depth(self.depth_paths[index], self.depth_scale, self.registration.depth_camera)
        return self.registration(depth_m)
