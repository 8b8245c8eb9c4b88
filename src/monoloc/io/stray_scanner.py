"""Reader of Stray Scanner's recordings (iPhone or iPad with LiDAR): a video, depth images and ARKit's poses.

Layout (https://github.com/strayrobots/scanner, docs/format.md): ``rgb.mp4``, ``depth/NNNNNN.png`` (16-bit
millimetres, 256x192, of the same field of view as colour), ``confidence/NNNNNN.png`` (0, 1, 2), ``camera_matrix.csv``
(3x3, of the video's size) and ``odometry.csv``: ``timestamp, frame, x, y, z, qx, qy, qz, qw``, camera to world, with
OpenCV's camera axes and y up in the world. Newer versions add ``fx, fy, cx, cy`` of each frame, and the centre of a
distortion that they do not state, often left empty. Early versions wrote depth as .npy, and poses without a header,
time stamp and number, one line for each frame of the video.

ARKit's lower confidence levels mark depth that is filled in at edges and on dark or shiny surfaces, which would blur
the map. Only depth of the highest level is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import read_text, require_file, require_folder
from monoloc.io.frame_filter import FrameFilter
from monoloc.io.image_cameras import one_camera, stated_by
from monoloc.io.image_files import read_depth
from monoloc.io.image_resampling import Resampler
from monoloc.io.pose_files import DOWN_OF_ARKIT, check_increasing, poses_from_quaternions
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.video_frames import VideoFrames

DEPTH_SCALE = 1000.0
HIGH_CONFIDENCE = 2
NO_CONFIDENCE = "no confidence is recorded, so depth of every confidence is used"
_VIDEO, _ODOMETRY, _MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_INTRINSICS = ("fx", "fy", "cx", "cy")
_AGAIN = "export the recording from Stray Scanner again"
# Frames are kept as JPEG for the next pass over the recording, because a step back in a video costs a decoding from
# its start. The video is a lossy code with halved colour resolution itself.
_QUALITY, _MOST_KEPT_BYTES = 95, 1 << 29


def recognises(path: Path) -> bool:
    """Whether a folder contains two of ``rgb.mp4``, ``odometry.csv`` and ``camera_matrix.csv``; :func:`read` asks for
    the third."""
    return sum((path / name).is_file() for name in (_VIDEO, _ODOMETRY, _MATRIX)) >= 2


def read(path: Path, options: ReaderOptions) -> StrayScannerRecording:
    """Open a recording's folder.

    Frames of the video without a pose, a depth image or its confidence are left out. Images whose intrinsics differ
    from those of the recording are rendered with these. Colour is as stored: a rotation tag of the video is ignored,
    as the intrinsics and the depth are those of the stored pixels.

    Raises:
        DataError: a file is missing or malformed, or no frame remains.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("stray-scanner", "camera", "depth_scale")
    require_folder(path)
    for name in (_VIDEO, _ODOMETRY, _MATRIX):
        require_file(path / name, "give a folder that Stray Scanner exported, with all its files")
    return StrayScannerRecording(path, options)


class StrayScannerRecording:
    """A :class:`~monoloc.io.recording.StoredRecording` of a folder of Stray Scanner."""

    def __init__(self, path: Path, options: ReaderOptions) -> None:
        self._video = VideoFrames(path / _VIDEO, turned=False)
        self._kept: dict[int, bytes] = {}
        self._kept_bytes = 0
        self._folder = path
        self.notes: list[str] = []
        odometry = _read_odometry(path / _ODOMETRY, self._video.size)
        times_s, numbers, poses = odometry.times_s, odometry.numbers, odometry.poses
        count = self._video.stated_count
        if times_s is None:
            video_times_s = self._video.times_s(self.notes)
            count = len(video_times_s)
            times_s = video_times_s[np.minimum(numbers, count - 1)]
        frames = FrameFilter(len(poses))
        frames.require(numbers < count, "without an image in the video")
        depth_paths = [_file_of(path / "depth", number) for number in numbers]
        self.down_world = DOWN_OF_ARKIT
        self.has_depth = frames.require_if_any([each is not None for each in depth_paths], "without depth")
        if self.has_depth:
            with_confidence = [_file_of(path / "confidence", number) is not None for number in numbers]
            if not frames.require_if_any(with_confidence, "without confidence"):
                self.notes.append(NO_CONFIDENCE)
        cameras = odometry.cameras or [_read_camera(path / _MATRIX, self._video.size)] * len(poses)
        self.camera, own_cameras = one_camera(cameras, options, frames)
        used = frames.positions(path, _AGAIN)
        self._resampler = None if own_cameras is None else Resampler(self.camera, [own_cameras[p] for p in used])
        check_increasing(times_s[used], path / _ODOMETRY)
        self._numbers = numbers[used]
        self._depth_paths = [depth_paths[p] for p in used]
        self.depth_scale = options.depth_scale or DEPTH_SCALE
        self.name = path.resolve().name
        self.frame_names = [f"{number:06d}" for number in self._numbers]
        self.timestamps_s = times_s[used]
        self.poses: FloatArray | None = poses[used]
        self.notes += frames.notes()
        self.color(0)

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        number = int(self._numbers[index])
        if number not in self._kept:
            image = self._checked(self._video.read(number, self._numbers))
            if self._resampler is not None:
                image = self._resampler.color(index, image)
            bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
            self._keep(number, cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes())
        stored = np.frombuffer(self._kept[number], dtype=np.uint8)
        bgr = np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR), dtype=np.uint8)
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        depth_path = self._depth_paths[index]
        if depth_path is None:
            raise DataError(self._folder, "has no depth images", "use a recording with depth, or predicted depth")
        confidence_path = _file_of(self._folder / "confidence", int(self._numbers[index]))
        depth_m = read_depth(depth_path, self.depth_scale, self.camera, confidence_path, HIGH_CONFIDENCE)
        return depth_m if self._resampler is None else self._resampler.depth(index, depth_m)

    def _checked(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        height, width = image.shape[:2]
        if (width, height) != (self.camera.width, self.camera.height):
            raise DataError(
                self._video.path,
                f"is {width}x{height}, but the intrinsics are for {self.camera.width}x{self.camera.height}",
                "give the intrinsics of this video's stored images",
            )
        return image

    def _keep(self, number: int, image: bytes) -> None:
        while self._kept and self._kept_bytes + len(image) > _MOST_KEPT_BYTES:
            self._kept_bytes -= len(self._kept.pop(next(iter(self._kept))))  # the oldest
        self._kept[number] = image
        self._kept_bytes += len(image)


def _file_of(folder: Path, number: int) -> Path | None:
    """Image of a frame, or None."""
    files = (folder / f"{number:06d}{suffix}" for suffix in (".png", ".npy"))
    return next((file for file in files if file.is_file()), None)


def _read_camera(path: Path, size: tuple[int, int]) -> Camera:
    rows = _numbers(path, [line for line in read_text(path).splitlines() if line.strip()], 3)
    if rows.shape != (3, 3):
        raise DataError(path, f"has {len(rows)} rows instead of 3", _AGAIN)
    with stated_by(path):
        return Camera(*size, rows[0, 0], rows[1, 1], rows[0, 2], rows[1, 2])


@dataclass(frozen=True)
class _Odometry:
    """Lines of ``odometry.csv``.

    Attributes:
        times_s: time stamps (N,) seconds; None of early versions.
        numbers: frame numbers (N,).
        poses: ``T_world_camera`` (N, 4, 4).
        cameras: camera of each frame, N; None if the file does not state them.
    """

    times_s: FloatArray | None
    numbers: NDArray[np.int64]
    poses: FloatArray
    cameras: list[Camera] | None


def _read_odometry(path: Path, size: tuple[int, int]) -> _Odometry:
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    header = [name.strip() for name in lines[0].split(",")] if lines else []
    if "qw" in header:
        lines = lines[1:]
    else:
        header = list(_POSE)
    missing = [name for name in _POSE if name not in header]
    if missing or not lines:
        problem = f"has no column {missing[0]}" if missing else "holds no poses"
        raise DataError(path, problem, _AGAIN)
    columns = dict(zip(header, _numbers(path, lines, len(header)).T, strict=True))
    quaternions, positions_m = (
        np.stack([columns[name] for name in names], axis=1) for names in (_POSE[3:], _POSE[:3])
    )
    numbers = columns.get("frame", np.arange(len(lines), dtype=np.float64))
    if not (np.isfinite(numbers) & (numbers >= 0.0)).all():
        raise DataError(path, "column frame has a value that is no frame number", _AGAIN)
    poses = poses_from_quaternions(quaternions, positions_m, path)
    return _Odometry(columns.get("timestamp"), numbers.astype(np.int64), poses, _cameras(columns, size, path))


def _cameras(columns: dict[str, FloatArray], size: tuple[int, int], path: Path) -> list[Camera] | None:
    """Camera of each line; None where the file does not state intrinsics for each."""
    if any(name not in columns or np.isnan(columns[name]).any() for name in _INTRINSICS):
        return None
    rows = np.stack([columns[name] for name in _INTRINSICS], axis=1)
    with stated_by(path):
        return [Camera(*size, *row) for row in rows.tolist()]


def _numbers(path: Path, lines: list[str], count: int) -> FloatArray:
    """Rows of ``count`` numbers each, separated by commas: (N, count); NaN of an empty field."""
    rows = []
    for line in lines:
        try:
            row = [float(word if word.strip() else "nan") for word in line.split(",")]
        except ValueError:
            row = []
        if len(row) != count:
            raise DataError(path, f"{line[:80]!r} is not {count} numbers", _AGAIN)
        rows.append(row)
    return np.array(rows)
