"""Reader of video files that OpenCV can decode: colour only, without poses."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray
from monoloc.io.reader_options import ReaderOptions
from monoloc.io.recording import Recording, Selection
from monoloc.io.video_frames import VideoFrames

_SUFFIXES = {".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm"}
_GUESSED_FOCAL = 0.85  # of the longer side: 61 degrees, as most phones film
_FEW_FRAMES = 5  # at the end, which decoders may not give of a whole file
_WHOLE_SHARE = 0.95  # of the frames or the duration that a file states, from which it counts as whole


def recognises(path: Path) -> bool:
    """Whether a file has a video suffix."""
    return path.is_file() and path.suffix.lower() in _SUFFIXES


def read(path: Path, options: ReaderOptions) -> VideoRecording:
    """Open a video file. The file does not contain intrinsics: they are given, or guessed if that is allowed.

    Raises:
        DataError: the file is missing or undecodable, or no camera is given.
        SettingError: an override does not apply to this format, or the camera has another image size.
    """
    options.allow_only("video", "camera")
    return VideoRecording(path, options.camera, options.guesses_camera)


def has_guessed_camera(recording: Recording) -> bool:
    """Whether a recording is a video whose intrinsics are a guess."""
    if isinstance(recording, Selection):
        return has_guessed_camera(recording.source)
    return isinstance(recording, VideoRecording) and recording.camera_is_guessed


def _cut_note(times_s: FloatArray, frames: VideoFrames) -> list[str]:
    """A note where far less can be decoded than a file states; the last few frames may be missing of a whole one."""
    count, stated_count = len(times_s), frames.stated_count
    # Where the rate varies, the number that OpenCV makes up from the duration may be wrong.
    if (
        count >= min(_WHOLE_SHARE * stated_count, stated_count - _FEW_FRAMES)
        or times_s[-1] >= _WHOLE_SHARE * frames.stated_duration_s > 0.0
    ):
        return []
    return [
        f"only {count} of the {stated_count} frames that the file states can be decoded; copy it again if it was cut"
    ]


class VideoRecording:
    """A :class:`~monoloc.io.recording.Recording` without poses and depth.

    The constructor reads all frames once to get their time stamps and number. Containers store only a mean frame
    rate, and a wrong number of frames if the file was cut. Frames are turned as the file's rotation tag asks, and the
    intrinsics are those of the turned frames.

    Attributes:
        camera_is_guessed: whether the intrinsics are a guess.
    """

    def __init__(self, path: Path, camera: Camera | None, guesses_camera: bool = False) -> None:
        self._frames = VideoFrames(path)
        width, height = self._frames.size
        self.camera_is_guessed = camera is None and guesses_camera
        if self.camera_is_guessed:
            focal_px = _GUESSED_FOCAL * max(width, height)
            camera = Camera(width, height, focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0)
        if camera is None:
            problem = "is a video, without poses, without depth, and does not state its intrinsics"
            known = f"give --camera FILE.toml of monoloc calibrate, or --camera {width},{height},FX,FY,CX,CY"
            command = ["monoloc", "reconstruct", str(path), "--out", path.stem, "--camera-out", "cam.toml"]
            fix = f"{known}; without a board, estimate them: {shlex.join(command)}"
            raise DataError(path, problem, fix)
        if (camera.width, camera.height) != (width, height):
            turned = f", turned by the {self._frames.rotation_deg} degrees of its rotation tag"
            raise SettingError(
                "camera",
                f"is for {camera.width}x{camera.height}, but {path} is {width}x{height}"
                + (turned if self._frames.rotation_deg else ""),
                "give the intrinsics of this video's images",
            )
        self.name = path.stem
        self.camera = camera
        self.notes: list[str] = []
        self.timestamps_s = self._frames.times_s(self.notes)
        self.frame_names = [f"{index:06d}" for index in range(len(self.timestamps_s))]
        self.poses: NDArray[np.float64] | None = None
        self.has_depth = False
        self.notes += _cut_note(self.timestamps_s, self._frames)

    def __len__(self) -> int:
        return len(self.frame_names)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return self._frames.read(index)

    def depth(self, index: int) -> NDArray[np.float32]:
        """Always raises DataError: a video has no depth."""
        raise DataError(self._frames.path, "is a video and has no depth", "use predicted depth")
