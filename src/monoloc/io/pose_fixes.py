"""Conversions of poses of another convention to ``T_world_camera`` with OpenCV's axes, by name.

A name stands for what the poses are, not for what is done to them: ``opengl`` converts poses with OpenGL's axes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from monoloc.errors import SettingError
from monoloc.geometry import FloatArray, invert, make_pose, quaternion_to_rotation, rotation_to_quaternion

PoseFix = Callable[[FloatArray], FloatArray]


def _turned(rotation_to_camera: list[list[float]]) -> PoseFix:
    """Of poses whose body axes are others: rows are the camera's axes in the body's frame."""
    T_body_camera = make_pose(np.array(rotation_to_camera).T, np.zeros(3))

    def convert(poses: FloatArray) -> FloatArray:
        return poses @ T_body_camera

    return convert


def _mirrored(signed_axes: list[list[float]]) -> PoseFix:
    """Of poses in a left-handed world, whose cameras have the same axes: rows are ours in theirs."""
    ours_of_theirs = np.eye(4)
    ours_of_theirs[:3, :3] = signed_axes

    def convert(poses: FloatArray) -> FloatArray:
        return ours_of_theirs @ poses @ ours_of_theirs.T

    return convert


def _rolled_quaternion(places: int) -> PoseFix:
    def convert(poses: FloatArray) -> FloatArray:
        quaternions = np.roll(rotation_to_quaternion(poses[:, :3, :3]), places, axis=1)
        return make_pose(quaternion_to_rotation(quaternions), poses[:, :3, 3])

    return convert


def _scaled(factor: float) -> PoseFix:
    def convert(poses: FloatArray) -> FloatArray:
        return make_pose(poses[:, :3, :3], factor * poses[:, :3, 3])

    return convert


def _with_axes(axes: tuple[int, ...], signs: tuple[float, ...]) -> PoseFix:
    """Of poses whose positions have the axes of another world than their rotations: ours, in the stored order."""

    def convert(poses: FloatArray) -> FloatArray:
        positions = np.empty((len(poses), 3))
        positions[:, axes] = poses[:, :3, 3] * signs
        return make_pose(poses[:, :3, :3], positions)

    return convert


@dataclass(frozen=True)
class Convention:
    """What poses are.

    Attributes:
        what: for messages: "the poses fit as ...".
        convert: (N, 4, 4) of this convention -> ``T_world_camera``.
    """

    what: str
    convert: PoseFix


QUATERNIONS = {
    "w-first": Convention("quaternions with w first", _rolled_quaternion(-1)),
    "w-last": Convention("quaternions with w last", _rolled_quaternion(1)),
}
DIRECTIONS = {"world-to-camera": Convention("world-to-camera", invert)}
AXES = {
    "opengl": Convention("camera axes of OpenGL (y up, z backward)", _turned([[1, 0, 0], [0, -1, 0], [0, 0, -1]])),
    "robot": Convention("a robot's axes (x forward, z up)", _turned([[0, -1, 0], [0, 0, -1], [1, 0, 0]])),
    "left-handed": Convention("a left-handed world (Unity, y up)", _mirrored([[1, 0, 0], [0, -1, 0], [0, 0, 1]])),
    "left-handed-z": Convention("a left-handed world (z mirrored)", _mirrored([[1, 0, 0], [0, 1, 0], [0, 0, -1]])),
    "unreal": Convention("a left-handed world (Unreal, x forward)", _mirrored([[0, 1, 0], [0, 0, -1], [1, 0, 0]])),
    "turned-90": Convention("a camera turned by 90 degrees", _turned([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])),
    "turned-180": Convention("a camera upside down", _turned([[-1, 0, 0], [0, -1, 0], [0, 0, 1]])),
    "turned-270": Convention("a camera turned by 270 degrees", _turned([[0, -1, 0], [1, 0, 0], [0, 0, 1]])),
}
UNITS = {
    "millimetres": Convention("millimetres", _scaled(1e-3)),
    "centimetres": Convention("centimetres", _scaled(1e-2)),
}
CONVENTIONS = QUATERNIONS | DIRECTIONS | AXES | UNITS


def _positions() -> Iterator[tuple[str, Convention]]:
    for axes, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        words = ["-" * (sign < 0.0) + "xyz"[axis] for axis, sign in zip(axes, signs, strict=True)]
        what = f"positions stored as {', '.join(words)}"
        yield f"positions:{''.join(words)}", Convention(what, _with_axes(axes, signs))


_AS_STATED = "positions:xyz"
POSITIONS = {name: convention for name, convention in _positions() if name != _AS_STATED}

_WITH_NUMBER = re.compile(r"(?:(scaled)|(late|early)):(\d+(?:\.\d+)?(?:e-?\d+)?)(s?)")
_FIX = (
    f"names are {', '.join(CONVENTIONS)}, positions:AXES as positions:xz-y, scaled:FACTOR, late:FRAMES and "
    "early:FRAMES, or in seconds as late:0.2s, with commas between them"
)
_MOST_LATE_S = 10.0


@dataclass(frozen=True)
class PoseFixes:
    """What ``--fix-poses`` asks for.

    Attributes:
        convert: (N, 4, 4) as stored -> ``T_world_camera``.
        late_frames: a frame's pose is stored so many frames after it; negative if before it.
        late_s: and so many seconds after it, between the poses of two frames.
    """

    convert: PoseFix
    late_frames: int = 0
    late_s: float = 0.0


def parse_pose_fixes(text: str) -> PoseFixes:
    """Parse names with commas between them, which are applied in their order.

    Raises:
        SettingError: a name is unknown, or its number is not usable.
    """
    steps: list[PoseFix] = []
    late, late_s = 0, 0.0
    for name in map(str.strip, text.split(",")):
        numbered = _WITH_NUMBER.fullmatch(name)
        if (convention := CONVENTIONS.get(name) or POSITIONS.get(name)) is not None:
            steps.append(convention.convert)
        elif name == _AS_STATED:
            raise SettingError("fix_poses", f"is {text!r}, and {name} leaves positions as they are", "leave it out")
        elif numbered is None or not _is_usable(numbered):
            raise SettingError("fix_poses", f"is {text!r}, and {name!r} is no fix", _FIX)
        elif numbered[1]:
            steps.append(_scaled(float(numbered[3])))
        else:
            frames, seconds = _delay(numbered)
            late, late_s = late + frames, late_s + seconds
    if abs(late_s) > _MOST_LATE_S:
        problem = f"is {text!r}, and no poses are {abs(late_s):g} s {'late' if late_s > 0.0 else 'early'}"
        raise SettingError("fix_poses", problem, f"give at most {_MOST_LATE_S:g} s")

    def convert(poses: FloatArray) -> FloatArray:
        for step in steps:
            poses = step(poses)
        return poses

    return PoseFixes(convert, late, late_s)


def _is_usable(numbered: re.Match[str]) -> bool:
    """Whether a number is a positive factor or time, or whole frames."""
    value, is_time = float(numbered[3]), bool(numbered[4])
    if numbered[1]:
        return value > 0.0 and not is_time
    return value > 0.0 if is_time else value.is_integer()


def _delay(numbered: re.Match[str]) -> tuple[int, float]:
    """Frames and seconds by which poses are late; negative if they are early."""
    value = float(numbered[3]) * (1.0 if numbered[2] == "late" else -1.0)
    return (0, value) if numbered[4] else (int(value), 0.0)
