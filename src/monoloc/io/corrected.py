"""A recording whose poses or depth are of another convention, read as what they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.geometry import FloatArray
from monoloc.io import seven_scenes
from monoloc.io.images import ImageRecording
from monoloc.io.pose_fixes import PoseFixes, parse_pose_fixes
from monoloc.io.poses_between_frames import frames_after, poses_after
from monoloc.io.recording import Recording, Selection, recorded_down, scale_sd_of
from monoloc.io.registration import DepthRegistration
from monoloc.io.upright import Turned

DepthFix = Literal["range", "kinect", "registered", "turned-180"]
_DepthMap = Callable[[NDArray[np.float32]], NDArray[np.float32]]

DEPTH_FIXES: dict[DepthFix, str] = {
    "range": "distance from the camera instead of z",
    "kinect": "not registered to the colour camera of a Kinect",
    "registered": "registered already, so the Kinect's constants do not apply",
    "turned-180": "upside down against the images",
}


@dataclass(frozen=True)
class Fixes:
    """What ``--fix-poses`` and ``--fix-depth`` ask for.

    Attributes:
        poses: names, see :func:`monoloc.io.pose_fixes.parse_pose_fixes`; None leaves the poses as they are.
        depth: key of ``DEPTH_FIXES``; None leaves the depth as it is.

    Raises:
        SettingError: a name is unknown.
    """

    poses: str | None = None
    depth: str | None = None

    def __post_init__(self) -> None:
        if self.poses is not None:
            parse_pose_fixes(self.poses)
        if self.depth is not None and self.depth not in DEPTH_FIXES:
            raise SettingError("fix_depth", f"is {self.depth!r}", f"choose one of {', '.join(DEPTH_FIXES)}")


class _Converted:
    """A recording with poses and depth of its own; ``pose_fix`` and ``depth_fix`` are what was asked for."""

    def __init__(
        self,
        source: Recording,
        poses: FloatArray | None,
        depth_map: _DepthMap | None,
        down_world: FloatArray | None = None,
        pose_fix: str | None = None,
        depth_fix: str | None = None,
    ) -> None:
        self.source, self.pose_fix, self.depth_fix, self._depth_map = source, pose_fix, depth_fix, depth_map
        self.name, self.camera = source.name, source.camera
        self.frame_names, self.timestamps_s = source.frame_names, source.timestamps_s
        self.poses, self.has_depth = poses, source.has_depth
        self.notes: list[str] = getattr(source, "notes", [])
        self.scale_sd, self.down_world = scale_sd_of(source), down_world

    def __len__(self) -> int:
        return len(self.source)

    def color(self, index: int) -> NDArray[np.uint8]:
        return self.source.color(index)

    def depth(self, index: int) -> NDArray[np.float32]:
        depth = self.source.depth(index)
        return depth if self._depth_map is None else self._depth_map(depth)


def with_poses(recording: Recording, poses: FloatArray) -> Recording:
    """The recording with other poses ``T_world_camera``, (N, 4, 4), in the same world."""
    return _Converted(recording, poses, None, recorded_down(recording))


def corrected(recording: Recording, fixes: Fixes) -> Recording:
    """The recording, read as the fixes say; the fix of the depth is applied first.

    Fixes are of what is stored, before images are turned upright. With late or early poses, the frames at one end
    have none and are left out. Where the poses were of another convention, the direction of gravity is not known
    either, and images are not turned upright by it.

    Raises:
        DataError: there is nothing to fix, or too few frames are left.
    """
    if not isinstance(recording, Turned):
        return _as_fixed(recording, fixes)
    fixed = _as_fixed(recording.source, fixes)
    return Turned(fixed, recording.quarter_turns) if fixes.poses is None else fixed


def _as_fixed(recording: Recording, fixes: Fixes) -> Recording:
    if fixes.depth is not None:
        recording = with_depth_fix(recording, fixes.depth)
    if fixes.poses is not None:
        recording = _with_pose_fixes(recording, parse_pose_fixes(fixes.poses), fixes.poses)
    return recording


def without_pose_fix(recording: Recording) -> tuple[str, Recording] | None:
    """The fix of its poses that was asked for, and the recording without it; None if none was."""
    if isinstance(recording, Selection):
        found = without_pose_fix(recording.source)
        return None if found is None else (found[0], Selection(found[1], recording.positions))
    if isinstance(recording, _Converted) and recording.pose_fix is not None:
        return recording.pose_fix, recording.source
    return None


def without_depth_fix(recording: Recording) -> tuple[str, Recording] | None:
    """The fix of its depth that was asked for, and the recording without it; None if none was."""
    if isinstance(recording, _Converted) and recording.depth_fix is not None:
        return recording.depth_fix, recording.source
    if not isinstance(recording, Selection | Turned | _Converted):
        return None
    found = without_depth_fix(recording.source)
    if found is None:
        return None
    if isinstance(recording, Selection):
        return found[0], Selection(found[1], recording.positions)
    if isinstance(recording, Turned):
        return found[0], Turned(found[1], recording.quarter_turns)
    poses, down_world = recording.poses, recording.down_world
    return found[0], _Converted(found[1], poses, None, down_world, pose_fix=recording.pose_fix)


def given_depth_fix(recording: Recording) -> str | None:
    """The fix of its depth that was asked for; None if none was."""
    found = without_depth_fix(recording)
    return None if found is None else found[0]


def _with_pose_fixes(recording: Recording, fixes: PoseFixes, pose_fix: str) -> Recording:
    if recording.poses is None:
        raise DataError(recording.name, "has no poses to fix", "leave out --fix-poses")
    known, poses = _at_their_frames(fixes.convert(recording.poses), recording.timestamps_s, fixes)
    frames = np.flatnonzero(known)
    if len(frames) == 0:
        by = [f"{fixes.late_frames}"] * (fixes.late_frames != 0) + [f"{fixes.late_s:g} s"] * (fixes.late_s != 0.0)
        problem = f"has {len(recording)} frames, and poses off by {' and '.join(by)} leave none"
        fewer = "fewer frames" if fixes.late_s == 0.0 else "less"
        raise DataError(recording.name, problem, f"give {fewer} in --fix-poses")
    return _Converted(Selection(recording, frames), poses[frames], None, pose_fix=pose_fix)


def _at_their_frames(
    poses: FloatArray, times_s: FloatArray, fixes: PoseFixes
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Whether a frame's pose is stored at all, (N,), and the pose (N, 4, 4), of poses that are late or early."""
    known, rows = frames_after(times_s, np.arange(len(poses)), fixes.late_frames)
    if fixes.late_s == 0.0:
        return known, poses[rows]
    between, moved = poses_after(poses, times_s, rows, fixes.late_s)
    return known & between, moved


def with_depth_fix(recording: Recording, name: str) -> Recording:
    """The recording with its depth read as ``name`` of ``DEPTH_FIXES`` says.

    Raises:
        DataError: the recording has no depth, or none that the fix applies to.
    """
    if not recording.has_depth:
        raise DataError(recording.name, "has no depth to fix", "leave out --fix-depth")
    if name == "registered":
        return _as_registered(recording)
    depth_map = _depth_map(name, recording.camera)
    return _Converted(recording, recording.poses, depth_map, recorded_down(recording), depth_fix=name)


def _depth_map(name: str, camera: Camera) -> _DepthMap:
    if name == "kinect":
        size = (camera.width, camera.height)
        return DepthRegistration(seven_scenes.DEPTH_CAMERA.resized(*size), camera, seven_scenes.T_COLOR_DEPTH)
    if name == "range":
        z_per_range = (1.0 / np.linalg.norm(camera.pixel_rays(), axis=-1)).astype(np.float32)
        return lambda depth: depth * z_per_range
    return lambda depth: np.ascontiguousarray(depth[::-1, ::-1])


def is_seven_scenes(recording: Recording) -> bool:
    """Whether the constants of 7-Scenes' Kinect were applied to a recording's depth and poses."""
    if isinstance(recording, Selection):
        return is_seven_scenes(recording.source)
    return (
        isinstance(recording, ImageRecording)
        and recording.registration is not None
        and seven_scenes.recognises(recording.folder)
    )


def _as_registered(recording: Recording) -> Recording:
    """Depth as stored, and the poses as the colour camera's."""
    if isinstance(recording, Selection):
        return Selection(_as_registered(recording.source), recording.positions)
    if not is_seven_scenes(recording) or not isinstance(recording, ImageRecording):
        problem = "is not in the layout of 7-Scenes, so no Kinect's constants are applied to it"
        raise DataError(recording.name, problem, "leave out --fix-depth registered")
    poses = None if recording.poses is None else recording.poses @ seven_scenes.T_COLOR_DEPTH
    return replace(recording, registration=None, poses=poses)
