"""Choice of the frames that structure from motion uses: apart enough to show depth, and sharp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from monoloc.io.recording import Recording, evenly_spaced
from monoloc.odometry.corner_tracking import find_corners, track_corners
from monoloc.odometry.odometry_config import OdometryConfig
from monoloc.progress import NoProgress, Progress
from monoloc.recording_check.correspondences import tracking_images
from monoloc.recording_check.image_quality import blur_of

_TRACKING = OdometryConfig()  # the odometry's settings for corners
_MOTION = 0.04  # median motion of corners between keyframes, share of the image's width
_CANDIDATE = 0.6  # of that motion; the sharpest frame from there on becomes the keyframe
_LEAST_SHARE = 0.5  # of a keyframe's corners that are still tracked
_LEAST_CORNERS = 30
_GAP_S = 1.0  # longest time between keyframes; a build measures its bias on frames at most 1.5 s apart
_MOST_KEYFRAMES = 400  # the time of a reconstruction grows faster than their number


@dataclass(frozen=True)
class _Frame:
    """A frame after a keyframe, and how far the keyframe's corners have moved until it, share of the width."""

    index: int
    gray: NDArray[np.uint8] | None
    motion: float


def choose_keyframes(
    recording: Recording, required: Sequence[int] = (), progress: Progress = NoProgress()
) -> NDArray[np.int64]:
    """Choose keyframes by the motion of tracked corners, and among neighbours the sharpest: (K,) ascending indices.

    Args:
        recording: read once, in order of time.
        required: frames that are keyframes whatever they show.
        progress: shows the number of frames done.

    Raises:
        DataError: a frame cannot be read.
    """
    images = tracking_images(recording)
    with progress.task("keyframes", len(recording)) as step:
        chosen, ahead = [0], [_Frame(0, images(0), 0.0)]
        follower = _Follower(ahead[0])
        ahead = []
        for index in range(1, len(recording)):
            ahead.append(follower.follow(index, images(index)))
            elapsed_s = float(recording.timestamps_s[index] - recording.timestamps_s[chosen[-1]])
            while ahead and (follower.is_done or elapsed_s >= _GAP_S):
                position = _sharpest(ahead)
                follower = _Follower(ahead[position])
                chosen.append(ahead[position].index)
                later = ahead[position + 1 :]
                ahead = [follower.follow(frame.index, frame.gray) for frame in later]
                elapsed_s = float(recording.timestamps_s[index] - recording.timestamps_s[chosen[-1]])
            step(index + 1)
    keyframes = np.array(chosen, dtype=np.int64)
    if len(keyframes) > _MOST_KEYFRAMES:
        keyframes = keyframes[evenly_spaced(len(keyframes), _MOST_KEYFRAMES)]
    return np.unique(np.concatenate([keyframes, np.array(required, dtype=np.int64)]))


def _sharpest(frames: list[_Frame]) -> int:
    """Position of the sharpest of the later frames that moved almost as far as the last."""
    later = range(len(frames) // 2, len(frames))
    far = [position for position in later if frames[position].motion >= _CANDIDATE * frames[-1].motion]
    return min(far, key=lambda position: (_blur(frames[position].gray), -position))


def _blur(gray: NDArray[np.uint8] | None) -> float:
    return 1.0 if gray is None else blur_of(gray)


class _Follower:
    """Tracks the corners of a keyframe from frame to frame.

    Attributes:
        is_done: whether the corners have moved far enough, or too few of them are left.
    """

    def __init__(self, keyframe: _Frame) -> None:
        self._gray = keyframe.gray
        self._corners = np.zeros((0, 2), dtype=np.float32)
        if self._gray is not None:
            self._corners = find_corners(self._gray, _TRACKING.corners, _TRACKING)
        self._pixels, self._count = self._corners, len(self._corners)
        self.is_done = False

    def follow(self, index: int, gray: NDArray[np.uint8] | None) -> _Frame:
        """The next frame; frames that show nothing are passed over, and do not end the tracks."""
        if gray is None:
            return _Frame(index, None, 0.0)
        if self._gray is None or self._count < _LEAST_CORNERS:
            self.is_done = True
            return _Frame(index, gray, np.inf)
        if len(self._pixels):
            pixels, valid = track_corners(self._gray, gray, self._pixels, _TRACKING)
            self._pixels, self._corners = pixels[valid], self._corners[valid]
        self._gray = gray
        motion = np.inf
        if len(self._pixels) >= _LEAST_SHARE * self._count:
            motion = float(np.median(np.linalg.norm(self._pixels - self._corners, axis=1))) / gray.shape[1]
        self.is_done |= motion > _MOTION
        return _Frame(index, gray, motion)
