"""Reader of image folders that a ``dataset.toml`` describes: a sequence, or unposed pairs.

::

    kind = "sequence"                 # or "pairs": unrelated images with depth and without poses
    color = "color/{index:06d}.jpg"   # pattern, relative to dataset.toml
    depth = "depth/{index:06d}.png"   # optional for a sequence
    count = 400                       # or stop; defaults: start = 0, step = 1
    width = 640                       # size of the colour images; depth has the same size and camera
    height = 480
    fx = 525.0
    fy = 525.0
    cx = 319.5
    cy = 239.5
    distortion = [0, 0, 0, 0, 0]      # optional: k1, k2, p1, p2, k3 of the stored images
    depth_scale = 1000                # stored value of one metre; required with depth
    poses = "poses.txt"               # for a sequence: one line per frame, t tx ty tz qx qy qz qw (TUM)
    rate_hz = 30                      # frame rate of a sequence without poses
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from monoloc.camera import Camera
from monoloc.errors import DataError, SettingError
from monoloc.io.file_access import read_text, require_file, require_folder
from monoloc.io.images import ImageRecording, names_of
from monoloc.io.pose_files import read_tum
from monoloc.io.reader_options import ReaderOptions, depth_scale_problem

FILE_NAME = "dataset.toml"
_EXAMPLES = {
    "kind": '"sequence" or "pairs"',
    "color": '"color/{index:06d}.jpg"',
    "depth": '"depth/{index:06d}.png"',
    "poses": '"poses.txt"',
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
    "depth_scale": "1000",
    "rate_hz": "30",
}


def recognises(path: Path) -> bool:
    """Whether the path is a ``dataset.toml``, or a folder that contains one."""
    return path.name == FILE_NAME or (path / FILE_NAME).is_file()


def read(path: Path, options: ReaderOptions) -> ImageRecording:
    """Open the recording that a ``dataset.toml`` describes; ``path`` is that file or its folder.

    Pairs have no poses, and their time stamps are frame numbers.

    Raises:
        DataError: a key is missing, unknown, of a wrong type or inconsistent with the files, or a pose is not rigid.
        SettingError: an override does not apply to this format.
    """
    options.allow_only("folder", "camera", "depth_scale")
    folder = path.parent if path.name == FILE_NAME else path
    require_folder(folder)
    description = _Description(folder / FILE_NAME)
    kind = description.text("kind")
    if kind not in ("sequence", "pairs"):
        raise description.error("kind", f"is {kind!r}")
    indices = description.indices()
    color_paths = description.paths("color", indices)
    has_depth = kind == "pairs" or description.has("depth")
    depth_paths = description.paths("depth", indices) if has_depth else None

    timestamps_s, poses = np.arange(len(indices), dtype=np.float64), None
    if kind == "sequence" and not description.has("poses"):
        timestamps_s /= description.rate_hz()
    elif kind == "sequence":
        pose_path = folder / description.text("poses")
        require_file(pose_path, f"write it, or correct poses in {FILE_NAME}")
        timestamps_s, poses = read_tum(pose_path)
        if len(poses) != len(indices):
            raise DataError(
                pose_path,
                f"has {len(poses)} poses for {len(indices)} frames",
                f"write one line for each frame; if some have no pose, renumber the images of the others, or give "
                f"rate_hz instead of poses in {FILE_NAME}, for localisation only",
            )
    return ImageRecording(
        name=folder.resolve().name,
        folder=folder,
        camera=options.camera_or(description.camera()),
        frame_names=names_of(color_paths, folder),
        timestamps_s=timestamps_s,
        poses=poses,
        color_paths=color_paths,
        depth_paths=depth_paths,
        depth_scale=options.depth_scale or (description.number("depth_scale") if has_depth else 1.0),
    )


class _Description:
    """The keys of a ``dataset.toml``; each is validated when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        require_file(path, "write one with kind, color, count, width, height, fx, fy, cx, cy")
        try:
            self._keys: dict[str, Any] = tomllib.loads(read_text(path))
        except (ValueError, RecursionError) as error:
            raise DataError(path, f"is not valid TOML ({error})", "correct that line") from error
        for key in self._keys:
            if key not in _EXAMPLES:
                raise DataError(path, f"{key} is not a known key", f"known are: {', '.join(_EXAMPLES)}")

    def error(self, key: str, problem: str) -> DataError:
        return DataError(self.path, f"{key} {problem}", f"write {key} = {_EXAMPLES[key]}, for example")

    def has(self, key: str) -> bool:
        return key in self._keys

    def text(self, key: str) -> str:
        value = self._value(key)
        if not isinstance(value, str):
            raise self.error(key, f"is {value!r}, not a text")
        return value

    def number(self, key: str) -> float:
        value = self._value(key)
        # TOML's true becomes Python's True, which is an int.
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.error(key, f"is {value!r}, not a number")
        if key == "depth_scale" and (problem := depth_scale_problem(value)) is not None:
            raise self.error(key, problem)
        return float(value)

    def rate_hz(self) -> float:
        """Frame rate of a sequence without poses, whose file would hold the time stamps."""
        if not self.has("rate_hz"):
            raise self.error("poses", "is missing, and so is rate_hz, which takes its place where there are no poses")
        rate_hz = self.number("rate_hz")
        if rate_hz <= 0.0:
            raise self.error("rate_hz", f"is {rate_hz!r}, not positive")
        return rate_hz

    def integer(self, key: str) -> int:
        value = self._value(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f"is {value!r}, not a whole number")
        return value

    def indices(self) -> range:
        """Frame numbers that are inserted into the patterns."""
        start = self.integer("start") if self.has("start") else 0
        step = self.integer("step") if self.has("step") else 1
        if step < 1:
            raise self.error("step", f"is {step}, not positive")
        if self.has("stop") and self.has("count"):
            raise self.error("stop", "is given beside count; remove one of the two")
        stop = self.integer("stop") if self.has("stop") else start + self.integer("count") * step
        if stop <= start:
            raise self.error("stop" if self.has("stop") else "count", "leaves no frames")
        return range(start, stop, step)

    def paths(self, key: str, indices: range) -> list[Path]:
        """Files of a pattern, one per frame; raises DataError if one is missing."""
        pattern = self.text(key)
        try:
            names = [pattern.format(index=index) for index in indices]
        except (KeyError, IndexError, ValueError, AttributeError, OverflowError, MemoryError) as error:
            raise self.error(key, f"is {pattern!r}, not a pattern of {{index}}") from error
        if len(set(names)) < len(names):
            raise self.error(key, f"is {pattern!r}, the same file for every index")
        files = [self.path.parent / name for name in names]
        for file in files:
            require_file(file, f"restore it, or correct {key} or count in {FILE_NAME}")
        return files

    def camera(self) -> Camera:
        fx, fy, cx, cy = (self.number(key) for key in ("fx", "fy", "cx", "cy"))
        try:
            return Camera(
                self.integer("width"), self.integer("height"), fx, fy, cx, cy, distortion=self._distortion()
            )
        except SettingError as error:
            problem, _, fix = str(error).partition("; ")
            raise DataError(self.path, problem, fix) from error

    def _distortion(self) -> tuple[float, float, float, float, float]:
        values = self._keys.get("distortion", [0.0] * 5)
        if not isinstance(values, list) or len(values) != 5:
            raise self.error("distortion", f"is {values!r}, not five numbers k1, k2, p1, p2, k3")
        if any(isinstance(value, bool) or not isinstance(value, int | float) for value in values):
            raise self.error("distortion", f"is {values!r}, not five numbers k1, k2, p1, p2, k3")
        k1, k2, p1, p2, k3 = (float(value) for value in values)
        return (k1, k2, p1, p2, k3)

    def _value(self, key: str) -> Any:
        if key not in self._keys:
            raise self.error(key, "is missing")
        return self._keys[key]
