"""The one camera of a recording whose files state intrinsics for each image."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_resampling import common_camera
from monoloc.io.reader_options import ReaderOptions


def one_camera(
    cameras: Sequence[Camera], options: ReaderOptions, frames: FrameFilter
) -> tuple[Camera, list[Camera] | None]:
    """Choose the recording's camera, and leave out images of another size or lens.

    Args:
        cameras: camera of each frame, N >= 1.
        options: an overriding camera is that of all images.
        frames: the N frames.

    Returns:
        The recording's camera, and the camera of each of the N images, or None if they are all the same.
    """
    camera, alike = common_camera(cameras)
    if options.camera is not None:
        return options.camera_or(camera), None
    frames.require(alike, "of another image size or lens")
    return camera, None if len(set(cameras)) == 1 else list(cameras)


@contextmanager
def stated_by(path: Path) -> Iterator[None]:
    """Report a camera that is made within, and is impossible, as an error of the file that states it."""
    try:
        yield
    except SettingError as error:
        raise DataError(path, f"{error.field}: {error.problem}", error.fix) from error
