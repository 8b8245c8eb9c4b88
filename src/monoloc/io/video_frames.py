"""Decoding of video files by frame number."""

from __future__ import annotations

import os
from bisect import bisect_left
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.file_access import require_file

# Silences the decoder (-8), whose messages would add to the one line of an error. It reads this on first use.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

_MOST_MENDED = 0.25  # of the time stamps; if more are wrong, the others are not to be trusted either


class VideoFrames:
    """Frames of a video file that OpenCV can decode.

    Frames are decoded sequentially. A step forward skips frames without converting them. A step back restarts at the
    first frame, because seeking in compressed video is not always exact.

    Args:
        path: the file.
        turned: whether frames are turned as the file's rotation tag asks; otherwise they are as stored.

    Attributes:
        size: width and height of the frames, pixels.
        rotation_deg: what the rotation tag says, 0 without one.

    Raises:
        DataError: the file is missing, cannot be decoded, or has a name that OpenCV cannot open.
    """

    def __init__(self, path: Path, turned: bool = True) -> None:
        require_file(path.absolute(), "check the path")
        _check_name(path.absolute())
        self.path = path
        self._turned = turned
        self._rewind()
        width, height = (self._capture.get(key) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        self.size = (int(width), int(height))
        self.rotation_deg = int(self._capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360

    @property
    def stated_count(self) -> int:
        """Number of frames that the container states; wrong if an .avi was cut, or where Matroska's rate varies."""
        return max(int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)

    @property
    def stated_duration_s(self) -> float:
        """How long the container states that the video is; 0 if it does not."""
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        return self.stated_count / rate_hz if rate_hz > 0.0 else 0.0

    def read(self, index: int, numbers: NDArray[np.int64] | None = None) -> NDArray[np.uint8]:
        """Frame ``index`` >= 0: (height, width, 3) uint8, RGB.

        Args:
            index: number of the frame in the file.
            numbers: those of the recording's frames, ascending; None if it has all.

        Raises:
            DataError: the frame cannot be decoded.
        """
        if index < self._next:
            self._rewind()
        while self._next < index and self._capture.grab():
            self._next += 1
        bgr = self._capture.read()[1] if self._next == index else None
        if bgr is None:
            usable = self._next if numbers is None else int(np.searchsorted(numbers, self._next))
            raise DataError(
                self.path,
                f"cannot be decoded after frame {self._next - 1}",
                f"use --frames 0:{usable}, or convert the video again",
            )
        self._next += 1
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def times_s(self, notes: list[str] | None = None) -> FloatArray:
        """Time stamps of all frames that can be decoded, (N,) seconds, increasing; decodes the whole file.

        Args:
            notes: receives a sentence if time stamps of the file were mended or replaced.

        Raises:
            DataError: no frame can be decoded, or the file states neither usable times nor a frame rate.
        """
        self._rewind()
        times_ms = []
        while self._capture.grab():
            times_ms.append(self._capture.get(cv2.CAP_PROP_POS_MSEC))  # of the last grabbed frame
        rate_hz = self._capture.get(cv2.CAP_PROP_FPS)
        is_empty = not times_ms and self.stated_count == 0
        self._rewind()
        if is_empty:
            raise DataError(self.path, "is empty: it has no frame", "record it again")
        if not times_ms:
            raise DataError(self.path, "has no frame that can be decoded", "convert it to H.264 (.mp4)")
        times_s, notes = np.array(times_ms) / 1000.0, [] if notes is None else notes
        right = _increasing(times_s)
        count, wrong = len(times_s), len(times_s) - len(right)
        if wrong == 0:
            return times_s
        if wrong <= _MOST_MENDED * count:
            notes.append(
                f"time stamps of the video do not increase at {wrong} of {count} frames; they are interpolated"
            )
            return _interpolated(times_s, right)
        if not rate_hz > 0.0:
            raise DataError(self.path, "states neither times that increase nor a frame rate", "convert it to .mp4")
        notes.append(
            f"time stamps of the video do not increase at {wrong} of {count} frames; all are taken to be at its mean "
            f"rate, {rate_hz:.4g} Hz"
        )
        return np.arange(count) / rate_hz

    def _rewind(self) -> None:
        # FFmpeg takes what precedes a colon in a relative path as a protocol, such as http.
        self._capture = cv2.VideoCapture(str(self.path.absolute()))
        self._next = 0
        if not self._capture.isOpened():
            if self.path.stat().st_size == 0:
                raise DataError(self.path, "is empty", "copy it again, or record it again")
            fix = "copy it again if it was cut short, or convert it to .mp4 or .avi"
            raise DataError(self.path, "cannot be decoded as a video", fix)
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, float(self._turned))  # the default depends on the version


def _check_name(path: Path) -> None:
    """Raise DataError if a path is not UTF-8; OpenCV would crash."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise DataError(path, "has a name that is not UTF-8", "rename the file, or the folder it is in") from error


def _increasing(times_s: FloatArray) -> NDArray[np.int64]:
    """Positions of the most time stamps (N,) that increase; of equal ones, the first."""
    ends_s: list[float] = []  # the least last time of an increasing series, by its length
    ends: list[int] = []  # where that is
    before = np.full(len(times_s), -1)
    for position, time_s in enumerate(times_s.tolist()):
        length = bisect_left(ends_s, time_s)
        if length < len(ends) and ends_s[length] == time_s:
            continue
        before[position] = ends[length - 1] if length else -1
        ends_s[length : length + 1], ends[length : length + 1] = [time_s], [position]
    series = ends[-1:]
    while series and before[series[-1]] >= 0:
        series.append(int(before[series[-1]]))
    return np.array(series[::-1], dtype=np.int64)


def _interpolated(times_s: FloatArray, right: NDArray[np.int64]) -> FloatArray:
    """Time stamps (N,), of which those at ``right`` (>= 2) are kept; at the ends, frames follow at the mean rate."""
    count, known_s = len(times_s), times_s[right]
    reach_s = count * (known_s[-1] - known_s[0]) / (right[-1] - right[0])
    positions = np.concatenate([right[:1] - count, right, right[-1:] + count])
    stamps_s = np.concatenate([known_s[:1] - reach_s, known_s, known_s[-1:] + reach_s])
    return np.asarray(np.interp(np.arange(count), positions, stamps_s))
