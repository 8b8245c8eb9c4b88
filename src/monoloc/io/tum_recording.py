"""Reader of the TUM RGB-D benchmark (Sturm et al., IROS 2012): rgb.txt, depth.txt, groundtruth.txt.

Depth is 16-bit with 5000 per metre, and the driver registers it to the colour camera. Poses are camera-to-world poses
of the colour camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.images import ImageRecording, names_of
from monoloc.io.pose_files import check_increasing, interpolate_poses, nearest_times, read_tum
from monoloc.io.reader_options import ReaderOptions

DEPTH_SCALE = 5000.0
MAX_TIME_DIFFERENCE_S = 0.02  # the benchmark's own tolerance for association

# The benchmark's calibrations of its three colour cameras, and ROS's default for other sensors.
_CAMERAS = {
    "freiburg1": Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": Camera(640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": Camera(640, 480, 535.4, 539.2, 320.1, 247.6),
}
_DEFAULT_CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
_DEFAULT_CAMERA_NOTE = (
    "the intrinsics are assumed (f = 525 pixels, ROS's default), because the folder's name has no freiburg1, 2 or 3; "
    "give --camera for another camera"
)


def recognises(path: Path) -> bool:
    """Whether a folder contains an ``rgb.txt``."""
    return (path / "rgb.txt").is_file()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open a sequence folder. freiburg1, 2 or 3 in the folder's name selects the intrinsics.

    The recording contains each colour frame that has a depth image within 20 ms (mutual nearest neighbours, hence one
    to one) and a pose. Poses may have another rate than images, see
    :func:`monoloc.io.pose_files.interpolate_poses`. Without ``depth.txt`` the recording has no depth, and without
    ``groundtruth.txt`` it has no poses.

    Raises:
        DataError: a list is missing or malformed, no frame remains, or images have another size.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("tum", "camera", "depth_scale")
    require_folder(path)
    color_times, color_paths = _read_list(path / "rgb.txt")
    frames, poses, depth_paths = FrameFilter(len(color_paths)), None, None
    if (path / "depth.txt").is_file():
        depth_times, all_depth_paths = _read_list(path / "depth.txt")
        partner = mutual_nearest(color_times, depth_times)
        frames.require(partner >= 0, f"without depth within {1e3 * MAX_TIME_DIFFERENCE_S:g} ms")
        depth_paths = [all_depth_paths[j] for j in partner]
    if (path / "groundtruth.txt").is_file():
        known, poses = interpolate_poses(color_times, *read_tum(path / "groundtruth.txt"))
        frames.require(known, "without a pose")
    positions = frames.positions(path, "check that the three lists use one clock, in seconds")
    name = path.resolve().name
    camera = next((camera for freiburg, camera in _CAMERAS.items() if freiburg in name), None)
    is_assumed = camera is None and options.camera is None
    used_color_paths = [color_paths[p] for p in positions]
    return ImageRecording(
        name=name,
        folder=path,
        camera=options.camera_or(camera or _DEFAULT_CAMERA),
        frame_names=names_of(used_color_paths, path),
        timestamps_s=color_times[positions],
        poses=None if poses is None else poses[positions],
        color_paths=used_color_paths,
        depth_paths=None if depth_paths is None else [depth_paths[p] for p in positions],
        depth_scale=options.depth_scale or DEPTH_SCALE,
        notes=[*frames.notes(), *([_DEFAULT_CAMERA_NOTE] if is_assumed else [])],
    )


def _read_list(path: Path) -> tuple[FloatArray, list[Path]]:
    """Read time stamps in seconds and file paths from lines of ``timestamp filename``."""
    require_file(path, "give a TUM sequence folder, with its rgb.txt")
    times, files = [], []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            time_text, file_text = words
            times.append(float(time_text))
        except ValueError as error:
            raise DataError(
                path, f"line {number} is not a time stamp and a file", "each line holds: t filename"
            ) from error
        files.append(path.parent / file_text)
        require_file(files[-1], f"restore it, or remove its line from {path.name}")
    if not files:
        raise DataError(path, "lists no images", "each line holds: t filename")
    times_s = np.array(times)
    check_increasing(times_s, path)
    return times_s, files


def mutual_nearest(times_s: FloatArray, others_s: FloatArray) -> NDArray[np.int64]:
    """Index of the matching other entry for each entry, or -1: (N,), (M,) seconds, increasing -> (N,).

    Matching entries are mutual nearest neighbours, hence one to one, at most 20 ms apart.
    """
    partner = nearest_times(times_s, others_s)
    mutual = nearest_times(others_s, times_s)[partner] == np.arange(len(times_s))
    close = np.abs(others_s[partner] - times_s) <= MAX_TIME_DIFFERENCE_S
    return np.where(mutual & close, partner, -1)
