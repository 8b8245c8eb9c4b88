"""Opening of recordings from SOURCE and --frames, and the registry of formats."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from monoloc.errors import DataError, SettingError
from monoloc.files import at_home
from monoloc.io import (
    colmap,
    folder,
    nerfstudio,
    nyu,
    polycam,
    record3d,
    recorded_flight,
    rgbd_scenes_v2,
    rosbag,
    rtabmap,
    seven_scenes,
    stray_scanner,
    tum_recording,
    twelve_scenes,
    video,
)
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording, Selection, StoredRecording
from monoloc.io.upright import upright

_DEVICE = re.compile(r"(?:/dev/video)?(\d+)")  # of a camera, as other programs name it


@dataclass(frozen=True)
class Format:
    """A storage format of recordings.

    Attributes:
        read: opens the recording at a path; raises DataError and SettingError.
        recognises: whether the name or the content of a path indicates this format.
    """

    read: Callable[[Path, ReaderOptions], StoredRecording]
    recognises: Callable[[Path], bool]


# A path without a format is tried in this order, most explicit format first.
FORMATS: dict[str, Format] = {
    "folder": Format(folder.read, folder.recognises),
    "nerfstudio": Format(nerfstudio.read, nerfstudio.recognises),
    "stray-scanner": Format(stray_scanner.read, stray_scanner.recognises),
    "record3d": Format(record3d.read, record3d.recognises),
    "polycam": Format(polycam.read, polycam.recognises),
    "rtabmap": Format(rtabmap.read, rtabmap.recognises),
    "tum": Format(tum_recording.read, tum_recording.recognises),
    "7scenes": Format(seven_scenes.read, seven_scenes.recognises),
    "12scenes": Format(twelve_scenes.read, twelve_scenes.recognises),
    "rgbd-scenes-v2": Format(rgbd_scenes_v2.read, rgbd_scenes_v2.recognises),
    "colmap": Format(colmap.read, colmap.recognises),
    "rosbag": Format(rosbag.read, rosbag.recognises),
    "nyu": Format(nyu.read, nyu.recognises),
    "flight": Format(recorded_flight.read, recorded_flight.recognises),
    "video": Format(video.read, video.recognises),
}

_SOURCE = re.compile(r"([A-Za-z0-9_-]{2,}):(.+)")  # at least two letters, because C:\ is a drive
_BUNDLE_FILE, _PLACE_FILE = "manifest.json", "place.json"  # in the folder of every bundle, and of every place
_IMAGES = {".jpg", ".jpeg", ".png"}
_FRAMES = re.compile(r"(\d*):(\d*)(?::(\d*))?")


def open_recording(source: str, options: ReaderOptions | None = None) -> StoredRecording:
    """Open the recording at SOURCE: ``FORMAT:PATH``, or a path whose format is recognised.

    Where the format tells the direction of gravity, images that lie on their side are turned upright.

    Raises:
        SettingError: the format is unknown, or an override does not apply to it.
        DataError: the path does not exist, its format is not recognised, or the recording is unusable.
    """
    options = options or ReaderOptions()
    name, path = _split_source(source)
    if name is not None:
        if name not in FORMATS:
            fix = f"known formats: {', '.join(FORMATS)}"
            if name == "camera":
                fix = f"monoloc fly and doctor take a camera, by its number as camera:0; {fix}"
            raise SettingError("SOURCE", f"unknown format {name!r}", fix)
        return upright(FORMATS[name].read(path, options))
    if not path.exists() or path.is_char_device():
        raise _no_file(source, path)
    for known in FORMATS.values():
        if known.recognises(path):
            return upright(known.read(path, options))
    raise _unrecognised(path)


def _no_file(source: str, path: Path) -> DataError:
    """A device, or a path that does not exist."""
    problem = "is a device, not a recording" if path.exists() else "does not exist"
    device, (before, mark, _) = _DEVICE.fullmatch(source), source.rpartition("#")
    fix = "check the path, or write FORMAT:PATH"
    if device:
        fix = f"fly by it: camera:{device[1]}"
    elif mark and at_home(before).exists():
        fix = f"to choose topics of a bag, write rosbag:{source}"
    return DataError(path.absolute(), problem, fix)


def _unrecognised(path: Path) -> DataError:
    """What a path of no known format is instead, as far as it shows."""
    if path.suffix.lower() == ".zip":
        return DataError(path, "is an archive", "unpack it, and give the folder")
    if (path / _BUNDLE_FILE).is_file():
        return DataError(path, "is a bundle, not a recording", "give the images or the video of a room or a flight")
    if (path / _PLACE_FILE).is_file():
        return DataError(path, "is a place, not a recording", "give the images or the video of a room or a flight")
    suffixes = [file.suffix.lower() for file in path.iterdir()] if path.is_dir() else [""]
    if {".db3", ".mcap"}.intersection(suffixes):
        fix = f"give its .db3 or .mcap file, or run: ros2 bag reindex {path}"
        return DataError(path, "is a ROS 2 bag without metadata.yaml", fix)
    if not suffixes:
        return DataError(path, "is an empty folder", "give the folder that holds the recording")
    fix = f"write FORMAT:PATH with one of {', '.join(FORMATS)}, or describe its images in a dataset.toml"
    nearby = _recording_near(path)
    if nearby is not None:
        fix = f"give a recording, such as {nearby}"
    elif _IMAGES.intersection(suffixes):
        fix = "describe its images in a dataset.toml"
    return DataError(path, "is not recognised as a recording", fix, page="how-to/record-a-room")


def _recording_near(path: Path) -> Path | None:
    """What is recognised in a folder, as where an archive was unpacked, or the folder that holds a file or images."""
    candidates = [*(sorted(path.iterdir()) if path.is_dir() else []), path.absolute().parent]
    return next((each for each in candidates if any(known.recognises(each) for known in FORMATS.values())), None)


def absolute_source(source: str) -> str:
    """The same SOURCE with an absolute path, for a process with another working directory."""
    name, path = _split_source(source)
    return str(path.resolve()) if name is None else f"{name}:{path.resolve()}"


def _split_source(source: str) -> tuple[str | None, Path]:
    """Split SOURCE into format, or None, and path."""
    match = _SOURCE.fullmatch(source)
    if match and not Path(source).exists():
        return match[1], at_home(match[2])
    return None, at_home(source)


def select_frames(recording: Recording, frames: str) -> Selection:
    """Select the frames START:STOP:STEP of a recording, or several such ranges, separated by commas.

    Each part is optional; STOP is exclusive. A STOP beyond the end is the end.

    Raises:
        SettingError: ``frames`` is malformed, selects no frame, or does not go forward in time.
    """
    ranges = [_range_of(text, frames, len(recording)) for text in frames.split(",")]
    for before, after in itertools.pairwise(ranges):
        if after[0] <= before[-1]:
            fix = "give ranges in order of time, none of which overlap"
            raise SettingError("frames", f"{frames!r} goes back in time", fix)
    return Selection(recording, np.concatenate([np.array(each, dtype=np.int64) for each in ranges]))


def _range_of(text: str, frames: str, count: int) -> range:
    """The frames of one START:STOP:STEP, at least one, of a recording of ``count``."""
    match = _FRAMES.fullmatch(text.strip())
    if match is None:
        raise SettingError(
            "frames", f"{frames!r} is not START:STOP:STEP", "write whole numbers, such as 0:400:4 or 100:"
        )
    start, stop, step = (int(part) if part else None for part in match.groups())
    if step == 0:
        raise SettingError("frames", f"{frames!r} has step 0", "give a step of 1 or more")
    positions = range(count)[start:stop:step]
    if not positions:
        fix = f"choose START below STOP and below {count}"
        raise SettingError("frames", f"{frames!r} selects none of the {count} frames", fix)
    return positions
