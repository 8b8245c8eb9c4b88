"""Reader of what ``monoloc fly --record`` keeps: the images that were localised, upright, with their times.

A recorded flight has no poses: what a flight believed is no reference.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from monoloc.camera import Camera
from monoloc.config import describe
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import json_number, read_json, read_text, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.images import ImageRecording, names_of
from monoloc.io.pose_files import check_increasing
from monoloc.io.reader_options import ReaderOptions

HEADER, FRAMES, IMAGES = "flight.json", "frames.jsonl", "images"
"""In a flight's folder: what it began with, a line a frame, and the frames."""

_TIME = "captured_s"  # of lines of frames; the others are of times without one
_FIX = "give another flight"
_CAMERA = TypeAdapter(Camera)


def image_path(folder: Path, index: int) -> Path:
    """Where a flight keeps the image of its frame ``index``."""
    return folder / IMAGES / f"{index:06d}.png"


def recognises(path: Path) -> bool:
    """Whether a folder contains a ``flight.json`` and a ``frames.jsonl``."""
    return (path / HEADER).is_file() and (path / FRAMES).is_file()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a recorded flight, as far as the disk had taken it.

    Raises:
        DataError: a file is missing or damaged, or no frame remains.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("flight", "camera")
    require_folder(path)
    times_s = _times(path)
    color_paths = [image_path(path, index) for index in range(len(times_s))]
    frames = FrameFilter(len(color_paths))
    # A loss of power leaves empty files.
    frames.require([file.is_file() and file.stat().st_size > 0 for file in color_paths], "without an image")
    used = frames.positions(path, _FIX)
    used_paths = [color_paths[index] for index in used]
    return ImageRecording(
        name=path.resolve().name,
        folder=path,
        camera=options.camera_or(_camera(path / HEADER)),
        frame_names=names_of(used_paths, path),
        timestamps_s=times_s[used],
        poses=None,
        color_paths=used_paths,
        depth_paths=None,
        depth_scale=1.0,
        stands_upright=True,
        notes=frames.notes(),
    )


def _camera(path: Path) -> Camera:
    """Of the images, which were turned upright if the mount says so."""
    require_file(path, "give a folder of monoloc fly --record")
    try:
        return _CAMERA.validate_python(read_json(path).get("camera"))
    except (ValidationError, SettingError) as error:
        what = describe(error) if isinstance(error, ValidationError) else error
        raise DataError(path, f"does not tell the camera ({what})", _FIX) from error


def _times(folder: Path) -> FloatArray:
    """Times of capture, (N,) seconds, of all frames whose line is whole."""
    path = folder / FRAMES
    require_file(path, "give a folder of monoloc fly --record")
    times_s = []
    for number, line in enumerate(read_text(path).splitlines(keepends=True), start=1):
        if not line.endswith("\n"):  # a kill cut it
            break
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            content = None
        if not isinstance(content, dict):
            raise DataError(path, f"is damaged in line {number}", _FIX)
        if _TIME in content:
            times_s.append(json_number(content, _TIME, path))
    values = np.array(times_s)
    check_increasing(values, path)
    return values
