"""Images of the board: a folder of pictures, a video, or a camera."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.calibration.board import Board
from monoloc.calibration.board_views import BoardDetector, BoardView, diverse_views, sharp_views
from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.io.file_access import read_bytes, visible
from monoloc.io.image_files import checked_header
from monoloc.io.video_frames import VideoFrames
from monoloc.live.camera_device import CameraDevice
from monoloc.live.frame_source import CameraGoneError
from monoloc.live.opening import is_live
from monoloc.progress import Progress

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}
_MOST_VIEWS = 60  # that are solved for; more cost time and tell little
_MOST_FRAMES = 600  # of a video, spread evenly, in which the board is looked for
_DEVICE = re.compile(r"camera:(\d+)")

Gray = NDArray[np.uint8]


@dataclass(frozen=True)
class BoardViews:
    """What a source shows of the board.

    Attributes:
        views: the sharp and diverse ones.
        size: width and height of the images.
        images: number of images in which the board was looked for.
    """

    views: list[BoardView]
    size: tuple[int, int]
    images: int


def read_views(
    source: str, board: Board, progress: Progress, device_size: tuple[int, int] = (640, 480), seconds: float = 60.0
) -> BoardViews:
    """The board's views in a folder of pictures, a video or ``camera:N``.

    Pictures are taken as stored, whatever their orientation tag, and frames of a video as its rotation tag turns
    them: as recordings are read.

    Args:
        source: a path, or ``camera:N``.
        board: that is looked for.
        progress: of the search.
        device_size: width and height that a camera is asked for.
        seconds: for how long a camera is watched.

    Raises:
        DataError: the source is missing, holds no images or one that cannot be decoded, or images of different sizes.
        SettingError: it is another camera.
    """
    device = _DEVICE.fullmatch(source)
    if device:
        count, images = None, _watched(int(device[1]), device_size, seconds)
    elif Path(source).is_dir():
        paths = sorted(path for path in visible(Path(source)) if path.suffix.lower() in _SUFFIXES)
        count, images = len(paths), _pictures(paths)
    elif Path(source).exists():
        frames = VideoFrames(Path(source))
        total = len(frames.times_s())
        chosen = range(0, total, -(-total // _MOST_FRAMES))
        count, images = len(chosen), ((f"{source}, frame {index}", _gray(frames.read(index))) for index in chosen)
    elif is_live(source):
        fix = "record a video of the board, and give that, or camera:0"
        raise SettingError("SOURCE", "is a camera that calibrate does not watch", fix)  # it may hold a password
    else:
        raise DataError(Path(source).absolute(), "does not exist", "give a folder of pictures, a video, or camera:0")
    found = _found(source, images, count, BoardDetector(board), progress)
    is_sequence = not Path(source).is_dir()
    views = diverse_views(sharp_views(found.views) if is_sequence else found.views, _MOST_VIEWS)
    return BoardViews(views, found.size, found.images)


def _found(
    source: str,
    images: Iterator[tuple[str, Gray]],
    count: int | None,
    detect: BoardDetector,
    progress: Progress,
) -> BoardViews:
    views: list[BoardView] = []
    size, done = None, 0
    with progress.task("find the board", count) as show:
        for done, (name, gray) in enumerate(images, start=1):
            shape = (gray.shape[1], gray.shape[0])
            if size is not None and shape != size:
                problem = f"is {shape[0]}x{shape[1]}, and others are {size[0]}x{size[1]}"
                raise DataError(name, problem, "give images of one camera at one resolution")
            size = shape
            if (view := detect(name, gray)) is not None:
                views.append(view)
            show(done, f"{len(views)} views" if count is None and done % 30 == 0 else "")
    if size is None:
        fix = f"give a folder of pictures ({', '.join(sorted(_SUFFIXES))}), a video, or camera:0"
        raise DataError(source, "holds no images", fix)
    return BoardViews(views, size, done)


def _pictures(paths: list[Path]) -> Iterator[tuple[str, Gray]]:
    for path in paths:
        data = read_bytes(path)
        checked_header(data, path)
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
        if image is None:
            raise DataError(path, "cannot be decoded as an image", "remove it, or convert it to PNG")
        yield str(path), np.asarray(image, dtype=np.uint8)


def _watched(index: int, size: tuple[int, int], seconds: float) -> Iterator[tuple[str, Gray]]:
    """Images of a device; those that come while one is searched are left out."""
    nominal = Camera(*size, float(max(size)), float(max(size)), (size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    device = CameraDevice(index, nominal)
    device.open()
    try:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            color, stamp_s = device.grab()
            yield f"{device.name} at {stamp_s:.2f} s", _gray(color)
    except CameraGoneError as error:
        raise DataError(device.name, "gives no more images", "check its cable, and try again") from error
    finally:
        device.close()


def _gray(color: NDArray[np.uint8]) -> Gray:
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
