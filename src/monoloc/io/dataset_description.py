"""The keys of a ``dataset.toml``; each is validated when it is read."""

from __future__ import annotations

import glob
import math
import re
import string
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.camera import Camera
from monoloc.config import read_toml
from monoloc.distortion import COEFFICIENTS, DistortionModel
from monoloc.errors import DataError, MonolocError, SettingError
from monoloc.geometry import FloatArray, is_rigid
from monoloc.io.file_access import brief, finite_number, numbers_of, require_access, require_file
from monoloc.io.reader_options import depth_scale_problem

FILE_NAME = "dataset.toml"
_EXAMPLES = {
    "kind": '"sequence" or "pairs"',
    "color": '"color/{index:06d}.jpg"',
    "depth": '"depth/{index:06d}.png"',
    "confidence": '"confidence/{index:06d}.png"',
    "least_confidence": "2",
    "poses": '"poses.txt" or "pose/{index:06d}.txt"',
    "pose_axes": '"opencv" or "opengl"',
    "pose_direction": '"camera-to-world" or "world-to-camera"',
    "pose_unit_m": "0.001",
    "count": "400",
    "start": "0",
    "stop": "400",
    "step": "1",
    "width": "640",
    "height": "480",
    "fx": "525.0",
    "fy": "525.0",
    "cx": "319.5",
    "cy": "239.5",
    "distortion": "[0, 0, 0, 0, 0]",
    "distortion_model": '"brown", "rational" or "fisheye"',
    "depth_scale": "1000",
    "depth_width": "640",
    "depth_height": "480",
    "depth_fx": "585.0",
    "depth_fy": "585.0",
    "depth_cx": "319.5",
    "depth_cy": "239.5",
    "T_color_depth": "[[1, 0, 0, 0.025], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
    "rate_hz": "30",
    "scale_sd": "0.02",
    "down": "[0, 0, -1]",
}
_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")
_DEPTH_INTRINSICS = tuple(f"depth_{key}" for key in _INTRINSICS)
# Keys that have no meaning without another.
_NEEDS = {
    **dict.fromkeys(("pose_axes", "pose_direction", "pose_unit_m", "scale_sd", "down"), "poses"),
    **dict.fromkeys(("confidence", *_DEPTH_INTRINSICS), "depth"),
    "T_color_depth": "depth_fx",
    "least_confidence": "confidence",
    "distortion_model": "distortion",
}

_MOST_APART_M = 1.0  # of two cameras on one rig
_NEAREST = 3  # keys that an unknown one is compared with: "focal_x" has more letters of "scale_sd" than of "fx"
_MOST_FRAMES = 1_000_000
# Digits padded by zeros: names padded by spaces are a slip, and a width of a hundred and more is no file name.
_INDEX_FORMAT = re.compile(r"(0\d{1,2})?d?")


_FILE_KEYS = ("color", "depth", "confidence", "poses")


def named_in(folder: Path) -> list[Path]:
    """Files that a folder's ``dataset.toml`` names, of a pattern its folder; none where it cannot be read.

    They may lie outside the folder, as where several recordings share poses.
    """
    try:
        description = DatasetDescription(folder / FILE_NAME)
        texts = [description.text(key) for key in _FILE_KEYS if description.has(key)]
    except (MonolocError, OSError):
        return []
    return [(folder / f"{text.partition('{')[0]}_").parent if "{" in text else folder / text for text in texts]


class DatasetDescription:
    """A ``dataset.toml``.

    Raises:
        DataError: the file is missing or not TOML, or a key is unknown or has no meaning without another.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        require_file(path, "write one with kind, color, width, height, fx, fy, cx, cy")
        self._keys = read_toml(path)
        for key in self._keys:
            if key not in _EXAMPLES:
                nearest = ", ".join(get_close_matches(key, _EXAMPLES, n=_NEAREST, cutoff=0.0))
                fix = "correct its name, or leave it out"
                raise DataError(path, f"{key} is unknown, the nearest are {nearest}", fix, "how-to/record-a-room")
            needed = _NEEDS.get(key)
            if needed is not None and needed not in self._keys:
                raise self.error(needed, f"is missing, without which {key} has no meaning")

    def error(self, key: str, problem: str) -> DataError:
        return DataError(self.path, f"{key} {problem}", f"write {key} = {_EXAMPLES[key]}, for example")

    def has(self, key: str) -> bool:
        return key in self._keys

    def text(self, key: str) -> str:
        value = self._value(key)
        if not isinstance(value, str):
            raise self.error(key, f"is {value!r}, not a text")
        return value

    def choice(self, key: str, *choices: str) -> str:
        """One of the choices; the first if the key is absent."""
        value = self.text(key) if self.has(key) else choices[0]
        if value not in choices:
            raise self.error(key, f"is {value!r}")
        return value

    def number(self, key: str) -> float:
        value = self._value(key)
        number = finite_number(value)
        if number is None:
            raise self.error(key, f"is {brief(value)}, not a number")
        if key == "depth_scale" and (problem := depth_scale_problem(value)) is not None:
            raise self.error(key, problem)
        return number

    def positive(self, key: str) -> float:
        value = self.number(key)
        if value <= 0.0:
            raise self.error(key, f"is {value!r}, not positive")
        return value

    def integer(self, key: str) -> int:
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"is {value!r}, not a whole number")
        return value

    @property
    def states_frames(self) -> bool:
        """Whether the frames are stated; otherwise they are those of the colour images that exist."""
        return self.has("count") or self.has("stop")

    def indices(self) -> list[int]:
        """Frame numbers, in ascending order: as stated, or of the colour images that exist."""
        start = self.integer("start") if self.has("start") else 0
        step = self.step()
        if not self.states_frames:
            return self._existing_indices(start, step)
        if self.has("stop") and self.has("count"):
            raise self.error("stop", "is given beside count; remove one of the two")
        stop = self.integer("stop") if self.has("stop") else start + self.integer("count") * step
        if stop <= start:
            raise self.error("stop" if self.has("stop") else "count", "leaves no frames")
        if stop - start > _MOST_FRAMES * step:
            raise self.error("stop" if self.has("stop") else "count", f"makes more than {_MOST_FRAMES} frames")
        return list(range(start, stop, step))

    def _existing_indices(self, start: int, step: int) -> list[int]:
        existing = self._indices_of("color")
        if not existing:
            require_access(self.paths("color", [start])[0].parent)
            raise self.error("color", f"is {self.text('color')!r}, which no file matches")
        found = [index for index in existing if index >= start and (index - start) % step == 0]
        if not found:
            key, value = ("start", start) if existing[-1] < start else ("step", step)
            numbers = f"{existing[0]} to {existing[-1]}"
            raise self.error(key, f"is {value}, by which no frame remains of the colour images {numbers}")
        return found

    def left_out(self, indices: list[int]) -> list[int]:
        """Frame numbers between the first and the last one of ascending ones that are not among them."""
        return sorted(set(range(indices[0], indices[-1], self.step())) - set(indices))

    def step(self) -> int:
        step = self.integer("step") if self.has("step") else 1
        if step < 1:
            raise self.error("step", f"is {step}, not positive")
        return step

    def paths(self, key: str, indices: list[int]) -> list[Path]:
        """Files of a pattern, one per frame, of which some may not exist."""
        pattern = self.text(key)
        self._parts(key)
        names = [pattern.format(index=index) for index in indices]
        if len(set(names)) < len(names):
            raise self.error(key, f"is {pattern!r}, the same file for every index")
        return [self.path.parent / name for name in names]

    def existing_paths(self, key: str, indices: list[int]) -> list[Path]:
        """Files of a pattern, one per frame; raises DataError if one is missing."""
        files = self.paths(key, indices)
        for file in files:
            try:
                require_file(file, f"restore it, or correct {key} or count in {FILE_NAME}")
            except DataError as error:
                raise self._begins_later(key, indices[0], file) or error from None
        return files

    def _begins_later(self, key: str, index: int, file: Path) -> DataError | None:
        """The error of a missing file, if it is that of the first frame and those of a pattern begin later."""
        try:
            first = next(iter(self._indices_of(key)), index)
        except DataError:  # a pattern of several numbers
            return None
        if first <= index or file != self.paths(key, [index])[0]:
            return None
        return DataError(file, "is missing", f"write start = {first} in {FILE_NAME}, where the files begin")

    def camera(self) -> Camera:
        """The colour camera."""
        model: Any = self.choice("distortion_model", *COEFFICIENTS)
        return self._camera(_INTRINSICS, self._distortion(model), model)

    def depth_camera(self) -> Camera | None:
        """The depth camera, or None if depth is registered to colour."""
        if not any(self.has(key) for key in _DEPTH_INTRINSICS):
            return None
        return self._camera(_DEPTH_INTRINSICS, (), "brown")

    def T_color_depth(self) -> FloatArray:
        """Pose of the depth camera in the colour camera's frame, (4, 4); the identity if the key is absent."""
        if not self.has("T_color_depth"):
            return np.eye(4)
        value = self._value("T_color_depth")
        matrix = numbers_of(value)
        if matrix.shape != (4, 4) or not is_rigid(matrix):
            raise self.error("T_color_depth", f"is {brief(value)}, not a rigid 4x4 matrix")
        apart_m = math.hypot(*matrix[:3, 3])
        if apart_m > _MOST_APART_M:
            raise self.error("T_color_depth", f"puts the cameras {apart_m:.3g} m apart; its unit is the metre")
        return matrix

    def down(self) -> FloatArray | None:
        """Direction of gravity in the world of the poses, (3,) unit vector; None if the key is absent."""
        if not self.has("down"):
            return None
        value = self._value("down")
        direction = numbers_of(value)
        length = math.hypot(*direction) if direction.shape == (3,) else 0.0
        if not 1e-6 < length < np.inf:
            raise self.error("down", f"is {brief(value)}, not a direction")
        return direction / length

    def _indices_of(self, key: str) -> list[int]:
        """Frame numbers of the files that match a pattern, in ascending order."""
        parts = self._parts(key)
        if sum(is_index for _, is_index in parts) != 1:
            raise self.error(key, f"is {self.text(key)!r}, not a pattern with one {{index}}")
        wildcards, expression = "", ""
        for text, is_index in parts:
            wildcards += glob.escape(text) + ("*" if is_index else "")
            expression += re.escape(text) + (r"(\d+)" if is_index else "")
        files = glob.glob(wildcards, root_dir=self.path.parent)  # noqa: PTH207 - pathlib rejects ".." in patterns
        numbers = {int(match[1]) for file in files if (match := re.fullmatch(expression, file))}
        return sorted(index for index in numbers if self.paths(key, [index])[0].is_file())

    def _parts(self, key: str) -> list[tuple[str, bool]]:
        """The texts of a pattern, each with whether an index follows it."""
        pattern = self.text(key)
        try:
            parts = list(string.Formatter().parse(pattern))
        except ValueError as error:
            raise self.error(key, f"is {pattern!r}, not a pattern of {{index}}") from error
        for _, name, form, conversion in parts:
            if name is None:
                continue
            if name != "index" or conversion is not None or not _INDEX_FORMAT.fullmatch(form or ""):
                raise self.error(key, f"is {pattern!r}, not a pattern of {{index}}")
        return [(text, name is not None) for text, name, _, _ in parts]

    def _camera(self, keys: tuple[str, ...], distortion: tuple[float, ...], model: DistortionModel) -> Camera:
        width, height = (self.integer(key) for key in keys[:2])
        fx, fy, cx, cy = (self.number(key) for key in keys[2:])
        try:
            return Camera(width, height, fx, fy, cx, cy, distortion, model)
        except SettingError as error:
            field = error.field.replace("camera.", "depth camera ") if keys == _DEPTH_INTRINSICS else error.field
            raise DataError(self.path, f"{field}: {error.problem}", error.fix) from error

    def _distortion(self, model: DistortionModel) -> tuple[float, ...]:
        given, names = self._keys.get("distortion", []), COEFFICIENTS[model]
        counts = (0, len(names), len(names) - 1) if model == "brown" else (0, len(names))
        values = numbers_of(given)
        if values.ndim != 1 or len(values) not in counts or (given != [] and not len(values)):
            problem = f"is {brief(given)}, not the {len(names)} numbers {', '.join(names)} of {model}"
            raise self.error("distortion", problem)
        return tuple(values.tolist())

    def _value(self, key: str) -> Any:
        if key not in self._keys:
            raise self.error(key, "is missing")
        return self._keys[key]
