"""Recordings that contradict themselves: the poses, depth, camera or images of a right one are changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray, invert, make_pose, quaternion_to_rotation, rotation_to_quaternion, so3_exp
from monoloc.io.recording import Recording
from monoloc.recording_check.correspondences import Matches
from monoloc.recording_check.evidence import Evidence
from monoloc.recording_check.pose_check import PoseCheck, check_matches, require_agreement

Image = NDArray[Any]


class Altered:
    """A :class:`monoloc.io.recording.Recording` with parts of its own."""

    def __init__(
        self,
        source: Recording,
        poses: FloatArray | None = None,
        depth: Callable[[Image], Image] | None = None,
        camera: Camera | None = None,
        color: Callable[[Image], Image] | None = None,
        has_depth: bool = True,
    ) -> None:
        self.name, self.frame_names, self.timestamps_s = source.name, source.frame_names, source.timestamps_s
        self.poses = source.poses if poses is None else poses
        self.camera = camera or source.camera
        self.has_depth = has_depth
        self._source, self._depth, self._color = source, depth, color

    def __len__(self) -> int:
        return len(self._source)

    def color(self, index: int) -> NDArray[np.uint8]:
        color = self._source.color(index)
        return color if self._color is None else np.ascontiguousarray(self._color(color))

    def depth(self, index: int) -> NDArray[np.float32]:
        assert self.has_depth
        depth = self._source.depth(index)
        return depth if self._depth is None else np.ascontiguousarray(self._depth(depth), dtype=np.float32)


def with_noise(recording: Recording, noise_m: float) -> Altered:
    """A recording whose positions have independent noise of a standard deviation."""
    assert recording.poses is not None
    poses = recording.poses.copy()
    poses[:, :3, 3] += noise_m * np.random.default_rng(0).normal(size=(len(poses), 3))
    return Altered(recording, poses=poses)


def axes(*rows: tuple[int, int, int]) -> FloatArray:
    return make_pose(np.array(rows, dtype=np.float64), np.zeros(3))


# T_camera_body of other conventions: rows are the camera's right, down and forward in the body's axes.
OPENGL = axes((1, 0, 0), (0, -1, 0), (0, 0, -1))
ROBOT = axes((0, -1, 0), (0, 0, -1), (1, 0, 0))
QUARTER = axes((0, -1, 0), (1, 0, 0), (0, 0, 1))
UP, AWAY = np.diag([1.0, -1.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])


def rolled(poses: FloatArray, places: int) -> FloatArray:
    """Poses as a reader of another order of quaternions gets them."""
    quaternions = np.roll(rotation_to_quaternion(poses[:, :3, :3]), places, axis=1)
    return make_pose(quaternion_to_rotation(quaternions), poses[:, :3, 3])


def with_positions(poses: FloatArray, positions: FloatArray) -> FloatArray:
    return make_pose(poses[:, :3, :3], positions)


def scaled(poses: FloatArray, factor: float) -> FloatArray:
    return with_positions(poses, factor * poses[:, :3, 3])


def late(poses: FloatArray, frames: int) -> FloatArray:
    """Each frame has the pose of so many frames before it."""
    return poses[np.clip(np.arange(len(poses)) - frames, 0, len(poses) - 1)]


def turning_path(count: int, rate_hz: float = 15.0) -> FloatArray:
    """Poses that move and turn about all axes, so that no two conventions agree."""
    return turning_path_at(np.arange(count) / rate_hz)


def turning_path_at(t: FloatArray) -> FloatArray:
    """Poses of that path at times (N,), seconds."""
    positions = np.stack([1.2 * np.sin(0.8 * t), 0.5 * np.sin(1.1 * t), 0.8 * np.cos(0.9 * t) - 0.6], axis=1)
    turns = np.stack([0.2 * np.sin(1.9 * t), 0.4 * np.sin(1.3 * t + 0.3), 0.3 * np.sin(2.3 * t)], axis=1)
    return make_pose(so3_exp(turns), positions)


@dataclass(frozen=True)
class Alteration:
    """A change of the poses, and what the check is to say: words, option."""

    poses: Callable[[FloatArray], FloatArray]
    words: str
    option: str


POSES = {
    "OpenGL": Alteration(lambda T: T @ OPENGL, "camera axes of OpenGL", "--fix-poses opengl"),
    "world-to-camera": Alteration(invert, "world-to-camera", "--fix-poses world-to-camera"),
    "w first": Alteration(lambda T: rolled(T, 1), "quaternions with w first", "--fix-poses w-first"),
    "w last": Alteration(lambda T: rolled(T, -1), "quaternions with w last", "--fix-poses w-last"),
    "COLMAP": Alteration(
        lambda T: rolled(invert(T), 1), "w first and world-to-camera", "--fix-poses w-first,world-to-camera"
    ),
    "three at once": Alteration(
        lambda T: rolled(invert(T @ OPENGL), 1),
        "w first and world-to-camera and camera axes of OpenGL",
        "--fix-poses w-first,world-to-camera,opengl",
    ),
    "robot": Alteration(lambda T: T @ ROBOT, r"a robot's axes \(x forward, z up\)", "--fix-poses robot"),
    "Unity": Alteration(lambda T: UP @ T @ UP, "left-handed world .Unity", "--fix-poses left-handed"),
    "z mirrored": Alteration(lambda T: AWAY @ T @ AWAY, "left-handed world .z", "--fix-poses left-handed-z"),
    "y and z swapped": Alteration(
        lambda T: with_positions(T, T[:, [0, 2, 1], 3]), "positions stored as x, z, y", "--fix-poses positions:xzy"
    ),
    "axes rolled": Alteration(
        lambda T: with_positions(T, T[:, [2, 0, 1], 3] * [1.0, 1.0, -1.0]),
        "positions stored as z, x, -y",
        "--fix-poses positions:zx-y",
    ),
    "z against the others": Alteration(
        lambda T: with_positions(T, T[:, :3, 3] * [1.0, 1.0, -1.0]),
        "positions stored as x, y, -z",
        "--fix-poses positions:xy-z",
    ),
    "millimetres": Alteration(lambda T: scaled(T, 1000.0), "millimetres", "--fix-poses millimetres"),
    "centimetres": Alteration(lambda T: scaled(T, 100.0), "centimetres", "--fix-poses centimetres"),
    "late": Alteration(lambda T: late(T, 4), "poses late by 4 frames", "--fix-poses late:4"),
    "early": Alteration(lambda T: late(T, -3), "poses early by 3 frames", "--fix-poses early:3"),
    "upside down": Alteration(lambda T: T @ QUARTER @ QUARTER, "camera upside down", "--fix-poses turned-180"),
    "turned": Alteration(lambda T: T @ invert(QUARTER), "turned by 90 degrees", "--fix-poses turned-90"),
    "turned back": Alteration(lambda T: T @ QUARTER, "turned by 270 degrees", "--fix-poses turned-270"),
}


def with_focal(camera: Camera, factor: float) -> Camera:
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)


def range_of(recording: Recording) -> Callable[[Image], Image]:
    """Distance from the camera of depth along z."""
    range_per_z = np.linalg.norm(recording.camera.pixel_rays(), axis=-1)
    return lambda depth: depth * range_per_z


def upside_down(image: Image) -> Image:
    return image[::-1, ::-1]


def checked(recording: Recording, matches: Matches) -> PoseCheck:
    """The check of a recording whose corners are matched already."""
    return check_matches(Evidence(recording, matches, None))


def refusal(check: PoseCheck) -> str:
    """The one line that a build refuses the recording with."""
    with pytest.raises(DataError) as raised:
        require_agreement("walk", check, poses_are_refined=False)
    line = str(raised.value)
    assert "\n" not in line, line
    assert line.startswith("walk: poses and images disagree: by poses and depth, corners land "), line
    return line
