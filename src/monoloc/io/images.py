"""The recording that most formats share: one image file per frame."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from monoloc.camera import Camera
from monoloc.errors import DataError
from monoloc.geometry import FloatArray
from monoloc.io.image_files import read_color, read_depth
from monoloc.io.image_resampling import Resampler
from monoloc.io.registration import DepthRegistration


def names_of(files: Sequence[Path], folder: Path) -> list[str]:
    """Unique names of files: without suffix, and with the path from the folder if names repeat."""
    stems = [file.stem for file in files]
    if len(set(stems)) == len(stems):
        return stems
    return [os.path.relpath(file, folder).removesuffix(files[0].suffix) for file in files]


def natural_order(name: str) -> list[tuple[int, str]]:
    """Sorting key that orders numbers in names by value: frame_9 before frame_10."""
    parts = re.split(r"(\d+)", name)  # text and digits in turn
    return [(int(part), "") if index % 2 else (0, part) for index, part in enumerate(parts)]


@dataclass(eq=False)
class ImageRecording:
    """A :class:`~monoloc.io.recording.StoredRecording` whose frames are image files.

    The constructor reads the first colour image, so that it detects intrinsics of another image size.

    Attributes:
        folder: location of the recording, for error messages.
        color_paths: one colour image per frame.
        depth_paths: one depth image per frame, or None if the recording has no depth.
        depth_scale: stored depth value of one metre.
        registration: transforms depth to the colour camera; None if the stored depth is registered.
        confidence_paths: image of each depth image's confidence, or None.
        least_confidence: depth of a lower confidence is taken as unknown.
        cameras: camera of each image, where they differ: images are rendered as ``camera`` sees them.
        scale_sd: see :func:`monoloc.io.recording.scale_sd_of`.
        down_world: see :func:`monoloc.io.recording.recorded_down`.
        stands_upright: see :func:`monoloc.io.upright.is_upright`.

    Raises:
        DataError: the recording has no frames, or its first image is unusable.
    """

    name: str
    folder: Path
    camera: Camera
    frame_names: list[str]
    timestamps_s: FloatArray
    poses: FloatArray | None
    color_paths: list[Path]
    depth_paths: list[Path] | None
    depth_scale: float
    registration: DepthRegistration | None = None
    confidence_paths: list[Path] | None = None
    least_confidence: int = 0
    cameras: list[Camera] | None = None
    scale_sd: float | None = None
    down_world: FloatArray | None = None
    stands_upright: bool = False
    notes: list[str] = field(default_factory=list)
    has_depth: bool = field(init=False)

    def __post_init__(self) -> None:
        self.has_depth = self.depth_paths is not None
        self._resampler = None if self.cameras is None else Resampler(self.camera, self.cameras)
        if not self.color_paths:
            raise DataError(self.folder, "has no frames", "give a folder with at least one image")
        self.color(0)

    def __len__(self) -> int:
        return len(self.color_paths)

    def color(self, index: int) -> NDArray[np.uint8]:
        """See :meth:`monoloc.io.recording.Recording.color`."""
        image = read_color(self.color_paths[index], self.camera)
        return image if self._resampler is None else self._resampler.color(index, image)

    def depth(self, index: int) -> NDArray[np.float32]:
        """See :meth:`monoloc.io.recording.Recording.depth`."""
        if self.depth_paths is None:
            raise DataError(self.folder, "has no depth images", "use a recording with depth, or predicted depth")
        confidence_path = None if self.confidence_paths is None else self.confidence_paths[index]
        camera = self.camera if self.registration is None else self.registration.depth_camera
        path = self.depth_paths[index]
        depth_m = read_depth(path, self.depth_scale, camera, confidence_path, self.least_confidence)
        if self.registration is not None:
            return self.registration(depth_m)
        return depth_m if self._resampler is None else self._resampler.depth(index, depth_m)
