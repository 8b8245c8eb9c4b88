"""Frames of a recording that did not build a bundle, as flights to be judged."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from monoloc.builder.trajectories import continuous_segments
from monoloc.bundle import Bundle, fingerprint
from monoloc.errors import DataError
from monoloc.io.recording import Recording
from monoloc.progress import Progress
from monoloc_lab.bench.judged_flight import FlightFrame

_KEPT_BYTES = 512 * 2**20  # of images, since flights overlap and reading takes longer than flying
_ROUNDING_S = 1e-6

Frames = NDArray[np.int64]


class UnseenFrames:
    """Frames of a recording that did not build a bundle.

    Args:
        recording: with poses, in the bundle's world.

    Attributes:
        camera: of the images.
        poses: (N, 4, 4) ``T_world_camera`` of all frames of the recording.
        segments: frames that a camera can be followed through, (M,) each; frames of the build in between are skipped.
        interval_s: median time from one of them to the next.
        distance_m: (N,) pose distance from every frame to the nearest of the build's.

    Raises:
        DataError: the recording has no poses, or no two unseen frames in a row, or an image cannot be read.
    """

    def __init__(self, bundle: Bundle, recording: Recording, progress: Progress) -> None:
        if recording.poses is None:
            raise DataError(recording.name, "has no poses", "give a recording with camera poses")
        self.name, self.camera, self.poses = recording.name, recording.camera, recording.poses
        self.distance_m = np.array([bundle.reference_poses.distance_m(pose) for pose in recording.poses])
        self._times_s = recording.timestamps_s
        image_bytes = 3 * recording.camera.width * recording.camera.height
        self._image = lru_cache(max(1, _KEPT_BYTES // image_bytes))(recording.color)
        unseen = self._unseen(set(bundle.provenance.frames.values()), len(recording), progress)
        self.segments = continuous_segments(unseen, self._times_s, self.poses) if len(unseen) else []
        intervals_s = [np.diff(self._times_s[segment]) for segment in self.segments]
        if not any(map(len, intervals_s)):
            raise DataError(
                self.name, "has no consecutive frames that were not used in the build", "give more frames"
            )
        self.interval_s = float(np.median(np.concatenate(intervals_s)))

    def _unseen(self, built: set[int], count: int, progress: Progress) -> Frames:
        unseen = []
        with progress.task("unseen frames", count) as show:
            for frame in range(count):
                if fingerprint(self._image(frame)) not in built:
                    unseen.append(frame)
                show(frame + 1)
        return np.array(unseen, dtype=np.int64)

    def windows_of(self, count: int) -> list[Frames]:
        """Every ``count`` frames in a row."""
        return [
            segment[first : first + count] for segment in self.segments for first in range(len(segment) - count + 1)
        ]

    def windows_lasting(self, seconds: float) -> list[Frames]:
        """Every frame that its segment goes on after for so long, with the frames of that time."""
        windows = []
        for segment in self.segments:
            times_s = self._times_s[segment]
            ends = np.searchsorted(times_s, times_s + seconds + _ROUNDING_S)
            starts = np.flatnonzero(times_s + seconds <= times_s[-1] + _ROUNDING_S)
            windows += [segment[first : ends[first]] for first in starts]
        return windows

    def flight(self, frames: Frames, start_s: float = 0.0) -> list[FlightFrame]:
        """Frames of one segment, of which the first is at ``start_s``."""
        times_s = start_s + (self._times_s[frames] - self._times_s[frames[0]])
        return [
            FlightFrame(
                partial(self._image, int(frame)),
                float(time_s),
                self.poses[frame],
                distance_m=float(self.distance_m[frame]),
            )
            for frame, time_s in zip(frames, times_s, strict=True)
        ]
