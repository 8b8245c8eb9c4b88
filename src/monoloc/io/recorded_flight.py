"""Reader of what ``monoloc fly --record`` keeps: the images that were localised, upright, with their times.

A recorded flight has no poses: what a flight believed is no reference.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from monoloc.camera import Camera
from monoloc.config import describe
from monoloc.errors import DataError, SettingError
from monoloc.files import read_regular
from monoloc.io.file_access import finite_number, read_json, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.images import ImageRecording, names_of
from monoloc.io.pose_files import check_increasing
from monoloc.io.reader_options import ReaderOptions

HEADER, FRAMES, IMAGES = "flight.json", "frames.jsonl", "images"
"""In a flight's folder: what it began with, a line a frame, and the frames."""

_TIME, _IDLE = "captured_s", "idle_s"  # of lines of frames, and of times without one
_FIX = "give another flight"
_CAMERA = TypeAdapter(Camera)


def image_path(folder: Path, index: int) -> Path:
    """Where a flight keeps the image of its frame ``index``."""
    return folder / IMAGES / f"{index:06d}.png"


@dataclass(frozen=True)
class FlightLine:
    """A line of a flight's ``frames.jsonl``.

    Attributes:
        number: from 1 on.
        content: of a frame, or of a time without one.
        image: of the frame; None of a time without one.
    """

    number: int
    content: dict[str, Any]
    image: Path | None

    @property
    def is_kept(self) -> bool:
        """Whether the disk has the image, if there is one. A flight ends where it has not: power was lost there."""
        return self.image is None or (self.image.is_file() and self.image.stat().st_size > 0)


def read_lines(folder: Path) -> Iterator[FlightLine]:
    """The lines of a recorded flight, in order, up to one that a kill cut.

    Raises:
        DataError: they cannot be read, or one is no frame and no time without one.
    """
    path, index = folder / FRAMES, 0
    require_file(path, "give a folder of monoloc fly --record")
    try:
        lines = read_regular(path).splitlines(keepends=True)
    except (OSError, ValueError) as error:
        what = error.strerror if isinstance(error, OSError) else error
        raise DataError(path, f"cannot be read ({what})", _FIX) from error
    for number, line in enumerate(lines, start=1):
        if not line.endswith(b"\n"):
            return
        content = _content(line)
        if content is None:
            raise DataError(path, f"is damaged in line {number}", _FIX)
        is_frame = _TIME in content
        yield FlightLine(number, content, image_path(folder, index) if is_frame else None)
        index += is_frame


def _content(line: bytes) -> dict[str, Any] | None:
    """The JSON object of a line, if it has a time."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(content, dict):
        return None
    return None if finite_number(content.get(_TIME, content.get(_IDLE))) is None else content


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
    require_file(path / HEADER, "give a folder of monoloc fly --record")
    header = read_json(path / HEADER)
    taken = [(line, line.image) for line in read_lines(path) if line.image is not None]
    frames = FrameFilter(len(taken))
    is_kept = np.logical_and.accumulate(np.array([line.is_kept for line, _ in taken], dtype=np.bool_))
    frames.require(is_kept, "from the first one without an image on")
    used = frames.positions(path, _FIX)
    times_s = np.array([float(line.content[_TIME]) for line, _ in taken])
    check_increasing(times_s, path / FRAMES)
    used_paths = [taken[index][1] for index in used]
    return ImageRecording(
        name=path.resolve().name,
        folder=path,
        camera=options.camera_or(_camera(header, path / HEADER)),
        frame_names=names_of(used_paths, path),
        timestamps_s=times_s[used],
        poses=None,
        color_paths=used_paths,
        depth_paths=None,
        depth_scale=1.0,
        stands_upright=header.get("stands_upright") is True,
        notes=frames.notes(),
    )


def _camera(header: dict[str, Any], path: Path) -> Camera:
    """Of the images, which were turned upright if the mount says so."""
    try:
        return _CAMERA.validate_python(header.get("camera"))
    except (ValidationError, SettingError) as error:
        what = describe(error) if isinstance(error, ValidationError) else error
        raise DataError(path, f"does not tell the camera ({what})", _FIX) from error
