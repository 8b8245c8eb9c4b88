"""What hypotheses about a recording are tried on: its corners with depth, and its poses."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from monoloc.geometry import FloatArray, invert
from monoloc.io.corrected import (
    given_depth_fix,
    is_seven_scenes,
    with_depth_fix,
    with_poses,
    without_depth_fix,
    without_pose_fix,
)
from monoloc.io.pose_fixes import CONVENTIONS, PoseFix
from monoloc.io.poses_between_frames import frames_after, poses_after
from monoloc.io.recording import Recording, Selection, evenly_spaced
from monoloc.io.seven_scenes import COLOR_CAMERA
from monoloc.io.upright import T_turned_stored
from monoloc.map.cloud import voxel_thin
from monoloc.map.depth_rendering import map_depth
from monoloc.recording_check.correspondences import PAIRS, Matches, match_corners
from monoloc.recording_check.reprojection import Reprojector, relative_poses

# Points of the cloud are up to 5 pixels apart in a rendered image, which is 160 pixels wide.
_GAPS_PER_WIDTH = 24
_SAME_SURFACE = 1.15
_VOXEL_M = 0.06  # of the cloud, which every hypothesis renders again,
_RENDERED_PAIRS = 10  # in the frames of so many pairs


class Evidence:
    """Corners of a recording, and poses and depth to compare them with.

    Attributes:
        recording: posed.
        reproject: errors of the matches under relative poses.
        what, option: what the recording is taken as, other than stated, and the option for that; empty as stated.
        pose_fix: names of ``--fix-poses`` that these poses have already; empty if it was not given.
        focal_is_unknown: whether the camera's stated focal length is that of another camera.
    """

    def __init__(
        self, recording: Recording, matches: Matches, cloud: FloatArray | None, what: str = "", option: str = ""
    ) -> None:
        assert recording.poses is not None
        self.recording, self.reproject, self.what, self.option = recording, Reprojector(matches), what, option
        self.poses, self.focal_is_unknown = recording.poses, False
        given = without_pose_fix(recording)
        self.pose_fix = "" if given is None else given[0]
        self._cloud = cloud
        self._measured: FloatArray | None = None

    @property
    def matches(self) -> Matches:
        return self.reproject.matches

    def depth_m(self, poses: FloatArray) -> FloatArray:
        """Depth of the corners in the first frame, (P,): the sensor's, or that of the cloud seen from the poses."""
        if not self.recording.has_depth and poses is not self.poses:
            return self._rendered(poses)
        if self._measured is None:
            has_depth, recording = self.recording.has_depth, self.recording
            self._measured = self.matches.depth_m(recording, recording.depth) if has_depth else self._rendered(poses)
        return self._measured

    def _rendered(self, poses: FloatArray) -> FloatArray:
        assert self._cloud is not None
        rendered = map_depth(with_poses(self.recording, poses), self._cloud)
        return self.matches.depth_m(self.recording, lambda index: _without_gaps(rendered(index)))

    def for_search(self) -> Evidence:
        """The same evidence, with fewer pairs if many hypotheses on all of them would take a minute."""
        if self.recording.has_depth:
            return self
        pairs = evenly_spaced(len(self.matches), _RENDERED_PAIRS)
        return self.of(self.recording, self.matches.select(pairs))

    def of(self, recording: Recording, matches: Matches) -> Evidence:
        """Other corners, of other frames, with depth from the same source."""
        return Evidence(recording, matches, self._cloud)

    def without_fix(self) -> Evidence | None:
        """The same corners, with the poses as they are stored; None if no fix of them was asked for."""
        given = without_pose_fix(self.recording)
        return None if given is None else self.of(given[1], self.matches)

    def without_depth_fix(self) -> tuple[str, Evidence] | None:
        """The fix of the depth that was asked for, and the same corners with depth as stored; None if none was."""
        given = without_depth_fix(self.recording)
        return None if given is None else (given[0], self.of(given[1], self.matches))

    def converted(self, convert: PoseFix) -> FloatArray:
        """Poses of the recording, (N, 4, 4), where those of the stored images, not turned upright, are converted."""
        T = T_turned_stored(self.recording)
        return convert(self.poses @ T) @ invert(T)

    def relative(self, poses: FloatArray) -> FloatArray:
        """``T_second_first`` of the pairs, (N, 4, 4), from poses of the recording's frames."""
        return relative_poses(poses, self.matches.frames)

    def relative_late(self, frames: int) -> FloatArray:
        """As :meth:`relative`, with each pose taken from so many frames later; NaN beyond the ends and gaps.

        Frames are those of the recording that the selection is from: poses are late by a time.
        """
        poses, times_s, rows = self._of_source()
        is_known, rows = frames_after(times_s, rows, frames)
        inside = is_known.all(axis=1)
        relative = np.full((len(rows), 4, 4), np.nan)
        relative[inside] = relative_poses(poses, rows[inside])
        return relative

    def relative_after(self, delay_s: float) -> FloatArray:
        """As :meth:`relative_late`, with each pose taken from so many seconds later, between those of frames."""
        poses, times_s, rows = self._of_source()
        known, moved = poses_after(poses, times_s, rows.ravel(), delay_s)
        relative = relative_poses(moved, np.arange(rows.size).reshape(rows.shape))
        relative[~known.reshape(rows.shape).all(axis=1)] = np.nan
        return relative

    @property
    def frame_interval_s(self) -> float:
        """Usual time between two frames."""
        _, times_s, _ = self._of_source()
        return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0

    def _of_source(self) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
        """Poses and times of all frames that the recording was selected from, and the pairs among these."""
        recording, positions = posed_source(self.recording)
        assert recording.poses is not None
        return recording.poses, recording.timestamps_s, positions[self.matches.frames]


def posed_source(recording: Recording) -> tuple[Recording, NDArray[np.int64]]:
    """The recording that a posed one's frames are selected from, if that is posed too, and their positions in it."""
    if isinstance(recording, Selection) and recording.source.poses is not None:
        return recording.source, recording.positions
    return recording, np.arange(len(recording))


def gather_evidence(recording: Recording, cloud: FloatArray | None, pairs: int = PAIRS) -> Evidence:
    """Match corners of a posed recording that has depth, unless the cloud (N, 3) of the room is given.

    Args:
        recording, pairs: as :func:`monoloc.recording_check.correspondences.match_corners`.
        cloud: world frame, metres.

    Raises:
        DataError: a frame cannot be read.
    """
    thin = None if cloud is None or recording.has_depth else voxel_thin(cloud, _VOXEL_M)
    return Evidence(recording, match_corners(recording, pairs), thin)


def other_readings(evidence: Evidence) -> list[Evidence]:
    """The same corners, with the recording's depth read otherwise."""
    recording, matches = evidence.recording, evidence.matches
    if not recording.has_depth:
        return []
    readings = []
    if given_depth_fix(recording) != "turned-180":  # turned once more, it would be as stored
        upside_down = with_poses(
            with_depth_fix(recording, "turned-180"), CONVENTIONS["turned-180"].convert(evidence.poses)
        )
        readings.append(
            Evidence(
                upside_down, matches, None, "images upside down against depth and poses",
                "--fix-depth turned-180 --fix-poses turned-180",
            )
        )  # fmt: skip
    if is_seven_scenes(recording):
        what = "a camera of your own, whose depth is registered already, in the layout of 7-Scenes"
        is_assumed = recording.camera == COLOR_CAMERA
        if is_assumed:
            matches = replace(matches, camera=replace(matches.camera, distortion=()))
        registered = with_depth_fix(recording, "registered")
        readings.append(Evidence(registered, matches, None, what, "--fix-depth registered"))
        readings[-1].focal_is_unknown = is_assumed
    return readings


def _without_gaps(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depth (H, W) rendered from a cloud, with the gaps between points filled where one surface surrounds them."""
    size = max(3, depth_m.shape[1] // _GAPS_PER_WIDTH)
    window = np.ones((size, size), dtype=np.uint8)
    known = depth_m > 0.0
    nearest = cv2.erode(np.where(known, depth_m, np.float32(np.inf)), window)
    farthest = cv2.dilate(depth_m, window)
    weight = cv2.blur(known.astype(np.float32), (size, size))
    mean = cv2.blur(depth_m, (size, size)) / np.maximum(weight, np.float32(1e-6))
    return np.where((weight > 0.0) & (farthest / np.float32(_SAME_SURFACE) <= nearest), mean, np.float32(0.0))
