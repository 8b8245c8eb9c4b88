"""Reader of video files that OpenCV can decode: colour only, without poses."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.io.file_access import require_file
from monoloc.io.reader_options import ReaderOptions

# Silences the decoder (-8), whose messages would add to the one line of an error. It reads this on first use.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

_SUFFIXES = {".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm"}


def recognises(path: Path) -> bool:
    """Whether a file has a video suffix."""
    return path.is_file() and path.suffix.lower() in _SUFFIXES


def read(path: Path, options: ReaderOptions) -> VideoRecording:
    """Open a video file. The file does not contain intrinsics, so the camera option is required.

    Raises:
        DataError: the file is missing or undecodable, or no camera is given.
        SettingError: an override does not apply to this format, or the camera has another image size.
    """
    options.allow_only("video", "camera")
    return VideoRecording(path, options.camera)


class VideoRecording:
    """A :class:`~monoloc.io.recording.Recording` without poses and depth.

    The constructor reads all frames once to get their time stamps and number. Containers store only a mean frame
    rate, and a wrong number of frames if the file was cut.

    Frames are decoded sequentially. A step forward skips frames without converting them. A step back restarts at the
    first frame, because seeking in compressed video is not always exact.
    """

    def __init__(self, path: Path, camera: Camera | None) -> None:
        require_file(path.absolute(), "check the path")
        _check_name(path)
        self._path = path
        self._rewind()
        size = tuple(int(self._capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if camera is None:
            problem = "is a video, without poses, without depth, and says nothing of its camera"
            fix = f"give monoloc localize or inspect --intrinsics {size[0]},{size[1]},FX,FY,CX,CY"
            raise DataError(path, problem, fix)
        if (camera.width, camera.height) != size:
            raise SettingError(
                "camera",
                f"is for {camera.width}x{camera.height}, but {path} is {size[0]}x{size[1]}",
                "give the intrinsics of this video's images",
            )
        self.name = path.stem
        self.camera = camera
        self.timestamps_s = self._times_s()
        self.frame_names = [f"{index:06d}" for index in range(len(self.timestamps_s))]
        self.poses: NDArray[np.float64] | None = None
        self.has_depth = False

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        if index < self._next:
            self._rewind()
        while self._next < index and self._capture.grab():
            self._next += 1
        bgr = self._capture.read()[1] if self._next == index else None
        if bgr is None:
            raise DataError(
                self._path,
                f"cannot be decoded after frame {self._next - 1}",
                f"use --frames 0:{self._next}, or convert the video again",
            )
        self._next += 1
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def depth(self, index: int) -> NDArray[np.float32]:
        """Always raises DataError: a video has no depth."""
        raise DataError(self._path, "is a video and has no depth", "use predicted depth")

    def _times_s(self) -> NDArray[np.float64]:
        """Time stamps of all decodable frames, (N,) seconds."""
        times_ms = []
        while self._capture.grab():
            times_ms.append(self._capture.get(cv2.CAP_PROP_POS_MSEC))  # of the last grabbed frame
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        self._rewind()
        if not times_ms:
            raise DataError(self._path, "has no frame that can be decoded", "convert it to .mp4")
        times_s = np.array(times_ms) / 1000.0
        if np.all(np.diff(times_s) > 0.0):
            return times_s
        # A raw stream has no time stamps, and a broken one has duplicates.
        if not rate_hz > 0.0:
            raise DataError(self._path, "states neither times that increase nor a frame rate", "convert it to .mp4")
        return np.arange(len(times_s)) / rate_hz

    def _rewind(self) -> None:
        self._capture = cv2.VideoCapture(str(self._path))
        self._next = 0
        if not self._capture.isOpened():
            raise DataError(self._path, "cannot be decoded as a video", "convert it to .mp4 or .avi")


def _check_name(path: Path) -> None:
    """Raise DataError if a path is not UTF-8; OpenCV would crash."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise DataError(path, "has a name that is not UTF-8", "rename the file, or the folder it is in") from error
